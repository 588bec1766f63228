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

"""What the bindings promise: shapes, types, lifetimes; and the least squares of the engine."""

import gc
import sys

from closedloop_dynamics.engine import native
import numpy as np
import pytest


def solve(matrix, right, tolerance=1e-12):
    """Return solution and rank by the engine."""
    solution = np.full(matrix.shape[1], np.nan)
    rank = native.LeastSquares(matrix, right, solution, tolerance).solve()
    return solution, rank


@pytest.mark.parametrize('rows, columns, rank', [
    (1, 1, 1), (5, 5, 5), (7, 3, 3), (3, 7, 3), (6, 6, 2), (9, 4, 1), (4, 9, 2), (40, 30, 17),
    (3, 3, 0)])
def test_least_squares_are_those_of_numpy(rows, columns, rank):
    random = np.random.default_rng(rows + 10 * columns)
    matrix = random.normal(size=(rows, rank)) @ random.normal(size=(rank, columns))
    right = random.normal(size=rows)
    solution, found = solve(matrix, right)
    expected, _, expected_rank, _ = np.linalg.lstsq(matrix, right, rcond=1e-12)
    assert found == expected_rank == rank
    np.testing.assert_allclose(solution, expected, rtol=1e-11, atol=1e-13)


def test_bound_arrays_are_read_and_written_at_each_call():
    matrix, right, solution = np.eye(2), np.ones(2), np.empty(2)
    problem = native.LeastSquares(matrix, right, solution, 1e-12)
    for scale in (1.0, 2.0, 0.5):
        matrix[:] = scale * np.eye(2)
        assert problem.solve() == 2
        assert solution.tolist() == [1 / scale, 1 / scale]


def test_arrays_live_as_long_as_what_they_are_bound_to():
    right = np.ones(300)
    before = sys.getrefcount(right)
    problem = native.LeastSquares(np.eye(300), right, np.empty(300), 1e-12)
    with pytest.raises(ValueError, match='resize'):
        right.resize(5, refcheck=True)
    gc.collect()
    assert problem.solve() == 300
    del problem
    assert sys.getrefcount(right) == before
    # Nothing keeps it either where only some of the arrays were bound.
    with pytest.raises(ValueError):
        native.LeastSquares(np.eye(300), right, np.empty((3, 3)), 1e-12)
    assert sys.getrefcount(right) == before


def unwritable(array):
    array.flags.writeable = False
    return array


@pytest.mark.parametrize('changed, error, words', [
    ({'matrix': np.eye(3)[:, ::2]}, ValueError, 'contiguous'),
    ({'matrix': np.eye(3, order='F')[:2]}, ValueError, 'contiguous'),
    ({'matrix': np.eye(3, dtype=np.float32)}, TypeError, "matrix: .* format 'f'"),
    ({'matrix': np.eye(3, dtype='>f8')}, TypeError, "matrix: .* format '>d'"),
    ({'matrix': np.eye(3, dtype=int)}, TypeError, "matrix: .* format 'l'"),
    ({'matrix': np.eye(3).astype(complex)}, TypeError, "matrix: .* format 'Zd'"),
    ({'matrix': np.eye(3).astype(object)}, TypeError, "matrix: .* format 'O'"),
    ({'matrix': np.ones(9)}, ValueError, 'matrix: expected 2 dimensions, got 1'),
    ({'matrix': np.ones((4, 3))}, ValueError, r'got \(4, 3\), \(3,\), \(3,\)'),
    ({'matrix': np.ones((0, 3)), 'right': np.ones(0)}, ValueError, 'm, n > 0'),
    ({'matrix': bytes(72)}, TypeError, "matrix: .* format 'B'"),
    ({'matrix': [[1.0]]}, TypeError, 'list'),
    ({'right': None}, TypeError, 'NoneType'),
    ({'right': np.frombuffer(bytearray(25), offset=1)}, TypeError, 'right: expected aligned'),
    ({'solution': unwritable(np.ones(3))}, ValueError, 'read-only'),
    ({'solution': np.ones(4)}, ValueError, r'\(4,\)'),
    ({'tolerance': 'small'}, TypeError, 'real number')])
def test_what_does_not_fit_is_refused(changed, error, words):
    arguments = {'matrix': np.eye(3), 'right': np.ones(3), 'solution': np.ones(3),
                 'tolerance': 1e-12, **changed}
    with pytest.raises(error, match=words):
        native.LeastSquares(*arguments.values())


@pytest.mark.parametrize('number', [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(number):
    with pytest.raises(ValueError, match='finite'):
        solve(np.full((2, 2), number), np.ones(2))
    with pytest.raises(ValueError, match='finite'):
        solve(np.ones((2, 2)), np.full(2, number))
