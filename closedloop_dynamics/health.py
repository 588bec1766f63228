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

"""How well posed the equations of motion are where a simulation stands."""

from dataclasses import dataclass
import math

import numpy as np

from .core import kinematics
from .core.jacobian import constraint_jacobian, generalized_inertia_matrix
from .core.types import (
    CLOSURE, CUT_ROW, EVALUATIONS, PROJECTION_ITERATIONS, RANK, RANK_REVEALING_COUNT, ROW, ROWS,
    SINGULAR_COUNT, SMALLEST_PIVOT, SMALLEST_PIVOT_EVER)

# Smallest pivots below this (about 2 degrees from a singular configuration) are worth a
# warning: forces grow with the inverse distance, errors of the input with them.
WARN_BELOW = 1e-3
# Largest number of closure equations whose condition is worth its cost, that of a dense matrix.
MOST_FOR_CONDITION = 40
# Singular value with locked drives below which it is worth mentioning.
LOOSE = 0.02
# Condition beyond which no digit is left.
SINGULAR = 1e15


@dataclass(frozen=True)
class Health:
    """
    Condition of the latest evaluation, and of all since the last reset.

    Attributes
    ----------
    smallest_pivot : float
        Of the block elimination, relative to the largest diagonal entry of its cut point: about
        the squared sine of the angle between one closure equation and the others. 1: as
        independent as can be; 0: dependent, or a link without inertia.
    smallest_pivot_ever : float
        Since the last reset.
    condition : float
        Largest condition number of the pivots of the block elimination, one block a cut joint: by
        what errors grow at most in it. Infinite where one is singular; NaN for more than 40
        closure equations.
    rank : int
        Closure equations that took part.
    equations : int
        All closure equations.
    rank_revealing_count : int
        Evaluations since the last reset that took the rank-revealing path.
    singular_count : int
        Those among them that were next to a singular configuration, not only on dependent closure
        equations or massless bodies.
    evaluations : int
        All evaluations since the last reset.
    projection_iterations : int
        Corrections of the positions after the latest step.
    closure : float
        Closure error that projection left after the latest step [m or rad].
    drive_singular_value : float
        Smallest singular value of the closure equations with the actuated joints locked, each
        scaled by its largest entry, with the sign of their determinant. 0: a parallel ("type-2")
        singularity, where locked drives would not hold the mechanism; the sign changes where it
        is passed. NaN where the drives are not as many as the freedoms, and for more than
        40 closure equations.

    """

    smallest_pivot: float
    smallest_pivot_ever: float
    condition: float
    rank: int
    equations: int
    rank_revealing_count: int
    singular_count: int
    evaluations: int
    projection_iterations: int
    closure: float
    drive_singular_value: float = math.nan

    @property
    def unique_forces(self):
        """Whether the constraint forces are the only ones possible, not just the least."""
        return self.rank == self.equations

    @property
    def near_singular(self):
        """Whether constraint forces deserve a warning: they are about to lose their meaning."""
        return not self.smallest_pivot >= WARN_BELOW

    def __str__(self):
        """Return the record in words, one line for each thing worth knowing."""
        lines = [
            f'smallest pivot {self.smallest_pivot:.2g} (worst {self.smallest_pivot_ever:.2g}), '
            f'condition {self.condition:.2g}, closure {self.closure:.2g} after '
            f'{self.projection_iterations} corrections, {self.rank_revealing_count} of '
            f'{self.evaluations} evaluations rank-revealing']
        if abs(self.drive_singular_value) < LOOSE:
            lines.append('a parallel (type-2) singularity is near: held drives would hardly hold '
                         f'the mechanism (singular value {self.drive_singular_value:.2g})')
        if not self.unique_forces:
            lines.append(
                f'the constraint forces are not unique: {self.equations - self.rank} of '
                f'{self.equations} closure equations depend on the others; the least forces '
                'that give the motion are shown')
        elif self.near_singular:
            lines.append('a singular configuration is near: constraint forces may be very large, '
                         'and small errors of the state show in them')
        return '\n'.join(lines)


def health_of(model, work, q, qd, passive=()):
    """
    Return the record of a workspace.

    Parameters
    ----------
    model : core.types.Model
        Of the mechanism.
    work : core.types.Workspace
        After an evaluation.
    q, qd : ndarray, shape (nv,)
        The state.
    passive : sequence of int
        Coordinates of the joints that are not actuated.

    Returns
    -------
    Health

    """
    values = work.health
    nc, nv = len(work.right), len(model.tree) - 1
    condition, loose = math.nan if nc else 1.0, math.nan
    if 0 < nc <= MOST_FOR_CONDITION:
        jac = np.zeros((nc, nv))
        kinematics.outward(model, q, qd, work)
        constraint_jacobian(model, work, jac)
        condition = block_condition(model, work, jac)
        loose = drive_singular_value(jac, passive)
    return Health(
        smallest_pivot=float(values[SMALLEST_PIVOT]),
        smallest_pivot_ever=float(values[SMALLEST_PIVOT_EVER]),
        condition=condition,
        rank=int(values[RANK]), equations=len(work.right),
        rank_revealing_count=int(values[RANK_REVEALING_COUNT]),
        singular_count=int(values[SINGULAR_COUNT]),
        evaluations=int(values[EVALUATIONS]),
        projection_iterations=int(values[PROJECTION_ITERATIONS]),
        closure=float(values[CLOSURE]),
        drive_singular_value=loose)


def drive_singular_value(jac, passive):
    """
    Return how far locked drives are from leaving the mechanism loose, as in ``Health``.

    Parameters
    ----------
    jac : ndarray, shape (nc, nv)
        Constraint Jacobian, of one equation or more.
    passive : sequence of int
        Coordinates of the joints that are not actuated.

    Returns
    -------
    float

    """
    if len(passive) != len(jac):
        return math.nan
    levers = np.abs(jac).max(axis=1, keepdims=True)
    # An equation that no motion can change has no lever, and cannot be held.
    square = jac[:, passive] / np.where(levers > 0.0, levers, 1.0)
    smallest = np.linalg.svd(square, compute_uv=False)[-1]
    return float(np.copysign(smallest, np.linalg.det(square)))


def block_condition(model, work, jac):
    """
    Return the largest condition number of the block pivots of J I^-1 J^T.

    Parameters
    ----------
    model : core.types.Model
        Of the mechanism.
    work : core.types.Workspace
        With the kinematics of the state.
    jac : ndarray, shape (nc, nv)
        Constraint Jacobian, of one equation or more.

    Returns
    -------
    float

    Notes
    -----
    Eliminates anew, blocks in the order of the method, so that evaluations need not keep
    anything for it. Each equation is scaled by its entry on the diagonal: a fixed cut
    joint has equations of forces and of a torque.

    """
    inertia = np.zeros((jac.shape[1], jac.shape[1]))
    generalized_inertia_matrix(model, work, inertia)
    worst = 1.0
    try:
        half = np.linalg.solve(np.linalg.cholesky(inertia), jac.T)
        lengths = np.linalg.norm(half, axis=0)
        half /= np.where(lengths > 0.0, lengths, 1.0)
        matrix = half.T @ half
        for cut in model.cut[np.argsort(model.cut[:, ROW])]:
            rows = slice(cut[CUT_ROW], cut[CUT_ROW] + cut[ROWS])
            pivot = matrix[rows, rows].copy()
            condition = float(np.linalg.cond(pivot))
            # Written so that a NaN (0/0: an equation no motion can change) counts as singular.
            if not condition < SINGULAR:
                return math.inf
            worst = max(worst, condition)
            matrix -= matrix[:, rows] @ np.linalg.solve(pivot, matrix[rows, :])
    except np.linalg.LinAlgError:
        return math.inf
    return worst
