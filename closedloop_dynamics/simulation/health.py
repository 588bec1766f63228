# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Condition of the equations of motion in the present state of a simulation."""

from dataclasses import dataclass
import math
from typing import Sequence, Union

import numpy as np

from ..codegen.equations import Equations
from ..engine.types import (
    CLOSURE, CUT_ROW, DOF, EVALUATIONS, Handle, Model, PARENT, PRISMATIC, PROJECTION_ITERATIONS,
    RANK, RANK_REVEALING_COUNT, ROW, ROWS, SINGULAR_COUNT, SMALLEST_PIVOT, SMALLEST_PIVOT_EVER,
    TYPE)
from ..kinematics.loop_model import largest_of_group

# Smallest pivots below this (about 2 degrees from a singular configuration) are worth a
# warning: forces grow with the inverse distance, errors of the input with them.
WARN_BELOW = 1e-3
# Largest number of closure equations whose condition is worth its cost, that of a dense matrix.
MOST_FOR_CONDITION = 40
# Sine of the angle to a parallel singularity below which it is worth mentioning: a degree.
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
        independent as can be; 0: dependent. Below 1e-3 without masses, so that light links
        play no part. Where arms are eliminated before multipliers (``codegen/arms.py``),
        the least squared sine between the columns of an arm, above 0.01.
    smallest_pivot_ever : float
        Since the last reset.
    condition : float
        Largest condition number of the pivots of the block elimination, one block a cut joint: by
        what errors grow at most in it. Infinite where one is singular; NaN for more than 40
        closure equations.
    rank : int
        Closure equations that took part.
    equations : int
        All closure equations; in space those that do not hold whatever moves.
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
    drive_sine : float
        Sine of the smallest angle between one of the closure equations and locked drives, and
        all others, with the sign of their determinant. 0: a parallel ("type-2")
        singularity, where locked drives would not hold the mechanism; the sign changes where it
        is passed. NaN where the drives are not as many as the freedoms, and for more than 40
        closure equations.

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
    drive_sine: float = math.nan

    @property
    def unique_forces(self) -> bool:
        """Whether the constraint forces are the only ones possible, not just the least."""
        return self.rank == self.equations

    @property
    def near_singular(self) -> bool:
        """Whether constraint forces deserve a warning: they are about to lose their meaning."""
        return not self.smallest_pivot >= WARN_BELOW

    def __str__(self) -> str:
        """Return the record in words, one line for each thing worth knowing."""
        lines = [
            f'smallest pivot {self.smallest_pivot:.2g} (worst {self.smallest_pivot_ever:.2g}), '
            f'condition {self.condition:.2g}, closure {self.closure:.2g} after '
            f'{self.projection_iterations} corrections, {self.rank_revealing_count} of '
            f'{self.evaluations} evaluations rank-revealing']
        if abs(self.drive_sine) < LOOSE:
            lines.append('a parallel (type-2) singularity is near: held drives would hardly hold '
                         f'the mechanism (an angle of {abs(self.drive_sine):.2g} rad)')
        if not self.unique_forces:
            lines.append(
                f'the constraint forces are not unique: {self.equations - self.rank} of '
                f'{self.equations} closure equations depend on the others; the least forces '
                'that give the motion are shown')
        elif self.near_singular:
            lines.append('a singular configuration is near: constraint forces may be very large, '
                         'and small errors of the state show in them')
        return '\n'.join(lines)


def health_of(
        model: Model, work: Handle, equations: Equations,
        passive: Union[Sequence[int], np.ndarray] = ()) -> Health:
    """
    Return the record of a workspace after an evaluation, of equations in the same state.

    ``passive``: coordinates of the joints that are not actuated.
    """
    values = work.health
    nc = len(work.right)
    condition, loose = math.nan if nc else 1.0, math.nan
    if 0 < nc <= MOST_FOR_CONDITION:
        jac = equations.jacobian()
        condition = block_condition(model, equations.inertia(), jac[equations.kept])
        loose = drive_sine(model, equations, jac, passive)
    return Health(
        smallest_pivot=float(values[SMALLEST_PIVOT]),
        smallest_pivot_ever=float(values[SMALLEST_PIVOT_EVER]),
        condition=condition,
        rank=int(values[RANK]), equations=equations.nc,
        rank_revealing_count=int(values[RANK_REVEALING_COUNT]),
        singular_count=int(values[SINGULAR_COUNT]),
        evaluations=int(values[EVALUATIONS]),
        projection_iterations=int(values[PROJECTION_ITERATIONS]),
        closure=float(values[CLOSURE]),
        drive_sine=loose)


def drive_sine(
        model: Model, equations: Equations, jac: np.ndarray,
        passive: Union[Sequence[int], np.ndarray]) -> float:
    """
    Return how far locked drives are from leaving the mechanism loose, as in ``Health``.

    Parameters
    ----------
    model : engine.types.Model
        Of the mechanism.
    equations : codegen.equations.Equations
        Of the mechanism.
    jac : ndarray, shape (nc, nv)
        Constraint Jacobian of all equations, one or more.
    passive : sequence of int
        Coordinates of the joints that are not actuated.

    Notes
    -----
    Angles are those between rows of the rates of the bodies' angles, in space of the joints',
    times the longest lever of any, and of the slides: no unit plays a part, nor, in the plane,
    where the trees begin. The equations of places of a cut joint share their scale, and with it
    the direction of the world's axes plays none.

    """
    kept, nv = equations.kept, jac.shape[1]
    if len(passive) != np.count_nonzero(kept):
        return math.nan
    tree, joints, turning = model.tree, np.eye(nv), np.zeros(nv, dtype=bool)
    for i in range(1, nv + 1):
        parent = tree[i, PARENT]
        while parent > 0 and tree[parent, TYPE] == PRISMATIC:
            parent = tree[parent, PARENT]
        turning[tree[i, DOF]] = tree[i, TYPE] != PRISMATIC
        if turning[tree[i, DOF]] and parent > 0 and len(model.gravity) == 2:
            joints[tree[i, DOF], tree[parent, DOF]] = -1.0
    by_angles, groups = jac[kept] @ joints, equations.groups[kept]
    lever = np.abs(by_angles[equations.places[kept] == 1][:, turning]).max(initial=0.0)
    weight = np.where(turning, 1.0 / lever if lever > 0.0 else 1.0, 1.0)
    drives = np.setdiff1d(np.arange(nv), passive)
    rows = np.vstack([by_angles, joints[drives]]) * weight
    lengths = np.linalg.norm(rows, axis=1)
    lengths[:len(groups)] = largest_of_group(lengths[:len(groups)], groups)
    # An equation that no motion can change has no length, and cannot be held.
    rows /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    try:
        # Column k of the inverse is as long as one over row k's distance from the others.
        distance = 1.0 / np.linalg.norm(np.linalg.inv(rows), axis=0).max()
    except np.linalg.LinAlgError:
        return 0.0
    return float(np.copysign(distance, np.linalg.det(rows)))


def block_condition(model: Model, inertia: np.ndarray, jac: np.ndarray) -> float:
    """
    Return the largest condition number of the block pivots of J I^-1 J^T.

    ``inertia``: shape (nv, nv); of the spanning tree. ``jac``: shape (nc, nv); constraint
    Jacobian, of one equation or more.

    Notes
    -----
    Eliminates again, blocks in the order of the method, so that evaluations need not keep
    anything for it. Each equation is scaled by its entry on the diagonal: a fixed cut
    joint has equations of forces and of a torque.

    """
    worst = 1.0
    try:
        half = np.linalg.solve(np.linalg.cholesky(inertia), jac.T)
        lengths = np.linalg.norm(half, axis=0)
        half /= np.where(lengths > 0.0, lengths, 1.0)
        matrix: np.ndarray = half.T @ half
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
