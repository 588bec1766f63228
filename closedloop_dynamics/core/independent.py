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

"""Independent coordinates: the dependent ones follow from the loop closures by Newton's method."""

from typing import NamedTuple

import numpy as np

from . import kinematics, loop_closure, lu
from .compiled import compiled
from .forward_dynamics import to_user_order
from .jacobian import constraint_jacobian
from .manifold import move
from .types import NO_RESPONSES

# Partition.record: the pivot ratio when the set was chosen (0: none chosen yet), the latest
# one, how often the set was changed.
CHOSEN_RATIO, RATIO, SWITCHES = range(3)
# A set whose pivots have shrunk to this share of what they were is exchanged for a better one:
# the error of a step grows fast while the independent coordinates turn singular (3-RRR, 1 s
# of RK4 at 1 ms: 8e-3 rad at 0.2, 5e-6 at 0.5, 1.5e-6 at 0.8), a change costs one factorization.
WORN = 0.8
MOST_ITERATIONS = 12


class Partition(NamedTuple):
    """
    Which coordinates are independent, and the scratch to solve for the others.

    Attributes
    ----------
    order : ndarray of int, shape (nv,)
        The nc dependent coordinates, then the independent ones.
    jac, scaled : ndarray, shape (nc, nv)
    matrix : ndarray, shape (nc, nc)
        Factors of the dependent columns.
    pivots : ndarray of int, shape (nc,)
    right : ndarray, shape (nc,)
    change : ndarray, shape (nv,)
        Of the coordinates; zero for the independent ones.
    record : ndarray, shape (3,)

    """

    order: np.ndarray
    jac: np.ndarray
    scaled: np.ndarray
    matrix: np.ndarray
    pivots: np.ndarray
    right: np.ndarray
    change: np.ndarray
    record: np.ndarray


def allocate_partition(model, used=True):
    """
    Allocate a partition, no set chosen yet.

    Parameters
    ----------
    model : Model
        Of the mechanism.
    used : bool
        Where not, arrays have no length.

    Returns
    -------
    Partition

    """
    nv, nc = (len(model.tree) - 1, len(model.column) - 1) if used else (0, 0)
    return Partition(
        order=np.arange(nv), jac=np.zeros((nc, nv)), scaled=np.zeros((nc, nv)),
        matrix=np.zeros((nc, nc)), pivots=np.zeros(nc, dtype=np.int64), right=np.zeros(nc),
        change=np.zeros(nv), record=np.zeros(3 if used else 0))


def forget(partition):
    """
    Make a partition one that has not been chosen yet.

    Parameters
    ----------
    partition : Partition
        Changed in place.

    """
    partition.order[:] = np.arange(len(partition.order))
    partition.record[:] = 0.0


@compiled
def choose(partition):
    """
    Choose the dependent coordinates by elimination with complete pivoting.

    Parameters
    ----------
    partition : Partition
        ``jac`` is read, ``order`` and ``record`` are written.

    """
    nc, nv = partition.jac.shape
    order, work = partition.order, partition.scaled
    for k in range(nc):
        for j in range(nv):
            work[k, j] = partition.jac[k, j]
    for j in range(nv):
        order[j] = j
    first = 0.0
    for k in range(nc):
        row, column = k, k
        for i in range(k, nc):
            for j in range(k, nv):
                if abs(work[i, order[j]]) > abs(work[row, order[column]]):
                    row, column = i, j
        order[k], order[column] = order[column], order[k]
        for j in range(nv):
            value = work[k, j]
            work[k, j] = work[row, j]
            work[row, j] = value
        pivot = work[k, order[k]]
        if k == 0:
            first = abs(pivot)
        partition.record[CHOSEN_RATIO] = abs(pivot) / first
        for i in range(k + 1, nc):
            scale = work[i, order[k]] / pivot
            for j in range(k, nv):
                work[i, order[j]] -= scale * work[k, order[j]]
    partition.record[SWITCHES] += 1.0


@compiled
def close(model, work, partition, manifold, q, qd, tolerance):
    """
    Move the dependent coordinates and rates so that the loops are closed.

    Parameters
    ----------
    model : Model
        Of the mechanism.
    work : Workspace
        Scratch.
    partition : Partition
        With a chosen set, or none yet: then it is chosen here.
    manifold : Manifold or None
        Of the mechanism.
    q, qd : ndarray, shape (nq,), (nv,)
        Corrected in place; the independent ones stay.
    tolerance : float
        Closure error to reach [m, rad].

    Returns
    -------
    bool
        Whether the loops are closed.

    """
    nc, nv = partition.jac.shape
    right, order, matrix = partition.right, partition.order, partition.matrix
    closed = False
    for _ in range(MOST_ITERATIONS):
        kinematics.outward(model, q, qd, work)
        loop_closure.update(model, work, NO_RESPONSES)
        to_user_order(model, work.closure, right)
        constraint_jacobian(model, work, partition.jac)
        if partition.record[CHOSEN_RATIO] == 0.0:
            choose(partition)
        for k in range(nc):
            for j in range(nc):
                matrix[k, j] = partition.jac[k, order[j]]
        partition.record[RATIO] = lu.factorize(matrix, partition.pivots)
        error = 0.0
        for k in range(nc):
            if not abs(right[k]) <= error:
                error = abs(right[k])
        if error <= tolerance:
            closed = True
            break
        lu.solve(matrix, partition.pivots, right)
        for j in range(nv):
            partition.change[j] = 0.0
        for k in range(nc):
            partition.change[order[k]] = -right[k]
        move(manifold, q, partition.change, 1.0, 1)
    for k in range(nc):
        total = 0.0
        for j in range(nc, nv):
            total -= partition.jac[k, order[j]] * qd[order[j]]
        right[k] = total
    lu.solve(matrix, partition.pivots, right)
    for k in range(nc):
        qd[order[k]] = right[k]
    return closed


@compiled
def close_and_choose(model, work, partition, manifold, q, qd, tolerance, anew):
    """
    Close the loops, and if asked choose another set where the present one is worn.

    Parameters
    ----------
    model, work, partition, manifold, q, qd, tolerance
        As for ``close``.
    anew : bool
        Whether another set may be chosen: between steps.

    Returns
    -------
    bool
        Whether the loops are closed.

    """
    closed = close(model, work, partition, manifold, q, qd, tolerance)
    record = partition.record
    if anew and not record[RATIO] >= WORN * record[CHOSEN_RATIO]:
        choose(partition)
        closed = close(model, work, partition, manifold, q, qd, tolerance)
    return closed
