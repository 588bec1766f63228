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

"""
The augmented and the system-level formulation, to compare the method against.

Both work on dense matrices of the whole mechanism and cost O((n + m)^3) and
O(n^3 + m^3); they see neither subsystems nor the cut-joint graph.

"""

from typing import NamedTuple

import numpy as np

from . import lu
from .compiled import compiled
from .elimination import note, POOR_PIVOT
from .forward_dynamics import constraint_right_side, to_user_order
from .jacobian import constraint_jacobian, generalized_inertia_matrix
from .joint_wrenches import tree_torque
from .loop_closure import update
from .types import EVALUATIONS, NO_RESPONSES

# Which formulation an evaluation uses.
SUBSYSTEM, SYSTEM, AUGMENTED = range(3)


class DenseWorkspace(NamedTuple):
    """
    Matrices of the dense formulations.

    Attributes
    ----------
    gim : ndarray, shape (nv, nv)
    jac : ndarray, shape (nc, nv)
    free : ndarray, shape (nv,)
        phi, then I^-1 phi.
    right : ndarray, shape (nc,)
    schur : ndarray, shape (nc, nc)
        J I^-1 J^T.
    kkt : ndarray, shape (nv + nc, nv + nc)
    pivots : ndarray of int, shape (nv + nc,)
        Of ``lu.factorize``.
    solution : ndarray, shape (nv + nc,)

    """

    gim: np.ndarray
    jac: np.ndarray
    free: np.ndarray
    right: np.ndarray
    schur: np.ndarray
    kkt: np.ndarray
    pivots: np.ndarray
    solution: np.ndarray


def allocate_dense(model, formulation):
    """
    Allocate what one dense formulation needs.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    formulation : int
        ``SYSTEM`` or ``AUGMENTED``; for ``SUBSYSTEM`` arrays have no length.

    Returns
    -------
    DenseWorkspace

    """
    nv, nc = (0, 0) if formulation == SUBSYSTEM else (len(model.tree) - 1, len(model.column) - 1)
    both = nv + nc if formulation == AUGMENTED else 0
    schur = nc if formulation == SYSTEM else 0
    return DenseWorkspace(
        gim=np.zeros((nv, nv)), jac=np.zeros((nc, nv)), free=np.zeros(nv), right=np.zeros(nc),
        schur=np.zeros((schur, schur)), kkt=np.zeros((both, both)),
        pivots=np.zeros(both, dtype=np.int64), solution=np.zeros(both))


@compiled
def cholesky(matrix):
    """
    Factor a symmetric positive definite matrix as L L^T in place (lower part).

    Returns its smallest pivot relative to its largest; a matrix that is not positive definite
    leaves NaN behind, and zero is returned.

    """
    n = matrix.shape[0]
    smallest, largest = np.inf, 0.0
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(total) if i == j else total / matrix[j, j]
        pivot = matrix[i, i] * matrix[i, i]
        # Written so that a NaN counts as no pivot at all.
        smallest = min(smallest, pivot) if pivot > 0.0 else 0.0
        largest = max(largest, pivot)
    return smallest / largest if n > 0 else 1.0


@compiled
def lower_solve(factor, right):
    """Solve L x = ``right`` in place for lower triangular L."""
    for i in range(factor.shape[0]):
        total = right[i]
        for k in range(i):
            total -= factor[i, k] * right[k]
        right[i] = total / factor[i, i]


@compiled
def lower_transposed_solve(factor, right):
    """Solve L^T x = ``right`` in place for lower triangular L."""
    for i in range(factor.shape[0] - 1, -1, -1):
        value = right[i] / factor[i, i]
        right[i] = value
        for k in range(i):
            right[k] -= factor[i, k] * value


@compiled
def _ratio_of_pivots(matrix, first):
    """
    Return the smallest pivot from number ``first`` on relative to the largest one.

    Zero where any is zero. ``matrix``: after ``lu.factorize``.

    """
    n = matrix.shape[0]
    smallest, largest = np.inf, 0.0
    for k in range(n):
        size = abs(matrix[k, k])
        # Written so that a NaN counts as no pivot at all.
        if not size > 0.0:
            smallest = 0.0
        elif k >= first:
            smallest, largest = min(smallest, size), max(largest, size)
    return smallest / largest if first < n else 1.0


@compiled
def accelerate_dense(model, work, dense, formulation, tau, baumgarte, qdd, lam):
    """
    Compute joint accelerations and multipliers by a dense formulation.

    Parameters
    ----------
    model, work, tau, baumgarte, qdd, lam
        As for ``forward_dynamics.accelerate``.
    dense : DenseWorkspace
        Scratch of the dense formulations.
    formulation : int
        ``SYSTEM`` (appendix A.3, eq. 1-2) or ``AUGMENTED`` (A.5, eq. 7).

    Returns
    -------
    bool
        Whether every pivot was good, as of ``forward_dynamics.accelerate``; if not,
        ``refinement.accelerate`` must be asked.

    Notes
    -----
    Pivots of the multipliers are compared with one another: the smallest over the largest is
    what ``health`` tells.

    """
    nv, nc = dense.free.shape[0], dense.right.shape[0]
    constraint_jacobian(model, work, dense.jac)
    update(model, work, NO_RESPONSES)
    work.right[:] = 0.0
    constraint_right_side(work, baumgarte, work.right)
    to_user_order(model, work.right, dense.right)
    qdd[:] = 0.0
    tree_torque(model, work, qdd, dense.free)
    for i in range(nv):
        dense.free[i] = tau[i] - dense.free[i]
    generalized_inertia_matrix(model, work, dense.gim)
    if formulation == SYSTEM:
        ratio = _system_level(dense, lam)
        for i in range(nv):
            qdd[i] = dense.free[i]
    else:
        for i in range(nv):
            dense.solution[i] = dense.free[i]
            for j in range(nv):
                dense.kkt[i, j] = dense.gim[i, j]
        for k in range(nc):
            dense.solution[nv + k] = dense.right[k]
            for i in range(nv):
                dense.kkt[nv + k, i] = dense.jac[k, i]
                dense.kkt[i, nv + k] = dense.jac[k, i]
            for j in range(nc):
                dense.kkt[nv + k, nv + j] = 0.0
        lu.factorize(dense.kkt, dense.pivots)
        lu.solve(dense.kkt, dense.pivots, dense.solution)
        ratio = _ratio_of_pivots(dense.kkt, nv)
        for i in range(nv):
            qdd[i] = dense.solution[i]
        for k in range(nc):
            lam[k] = -dense.solution[nv + k]
    work.health[EVALUATIONS] += 1.0
    fine = ratio >= POOR_PIVOT
    note(model, work, ratio if fine else 1.0)
    return fine


@compiled
def _system_level(dense, lam):
    """Solve for lambda, then leave qdd in ``dense.free``; return the ratio of the pivots."""
    nv, nc = dense.free.shape[0], dense.right.shape[0]
    inertia_ratio = cholesky(dense.gim)
    lower_solve(dense.gim, dense.free)
    for k in range(nc):
        lower_solve(dense.gim, dense.jac[k])
    for k in range(nc):
        total = dense.right[k]
        for i in range(nv):
            total -= dense.jac[k, i] * dense.free[i]
        lam[k] = total
        for j in range(k + 1):
            total = 0.0
            for i in range(nv):
                total += dense.jac[k, i] * dense.jac[j, i]
            dense.schur[k, j] = total
    ratio = cholesky(dense.schur)
    lower_solve(dense.schur, lam)
    lower_transposed_solve(dense.schur, lam)
    for k in range(nc):
        for i in range(nv):
            dense.free[i] += dense.jac[k, i] * lam[k]
    lower_transposed_solve(dense.gim, dense.free)
    return ratio if inertia_ratio > 0.0 else 0.0
