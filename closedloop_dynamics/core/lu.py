# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Dense LU factorization with partial pivoting, factors kept for many right-hand sides."""

from .compiled import compiled


@compiled
def factorize(matrix, pivots):
    """
    Factor a square matrix in place, rows exchanged.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Replaced by L (below its unit diagonal) and U.
    pivots : ndarray of int, shape (n,)
        Written: the row exchanged with each row.

    Returns
    -------
    float
        Smallest pivot over the largest; 0 or NaN for a singular matrix.

    """
    n = matrix.shape[0]
    smallest, most = 0.0, 0.0
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        pivots[k] = pivot
        if pivot != k:
            for j in range(n):
                value = matrix[k, j]
                matrix[k, j] = matrix[pivot, j]
                matrix[pivot, j] = value
        size = abs(matrix[k, k])
        if k == 0 or not size >= smallest:
            smallest = size
        most = max(most, size)
        inverse = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            scale = matrix[i, k] * inverse
            matrix[i, k] = scale
            if scale != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= scale * matrix[k, j]
    return smallest / most if n > 0 else 1.0


@compiled
def solve(matrix, pivots, right):
    """
    Solve with the factors, in place.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        After ``factorize``.
    pivots : ndarray of int, shape (n,)
        Row exchanges of ``factorize``.
    right : ndarray, shape (n,)
        Replaced by the solution.

    """
    n = matrix.shape[0]
    for k in range(n):
        value = right[pivots[k]]
        right[pivots[k]] = right[k]
        right[k] = value
    for k in range(n):
        value = right[k]
        if value != 0.0:
            for i in range(k + 1, n):
                right[i] -= matrix[i, k] * value
    for i in range(n - 1, -1, -1):
        total = right[i]
        for j in range(i + 1, n):
            total -= matrix[i, j] * right[j]
        right[i] = total / matrix[i, i]
