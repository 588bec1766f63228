# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Kinematics of a mechanism that is driven in all its degrees of freedom.

The values of joints, and of points along directions, are given (driving equations beside the
closure equations); positions, rates and accelerations of all joints follow. From value to value
the branch is followed, and never left: engine/driven.cpp. Where it ends, a singular position is
the reason, and it is said which one.
"""

from dataclasses import replace
import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from .assemblies import driven_names, drives_needed, moving_joints, too_few
from .assembly import Assembler, TOLERANCE
from .geometry import Geometry
from .loop_model import independent, scaled
from .modeling import extent
from ..engine import types as t
from ..engine.manifold import manifold_of
from ..mechanism.errors import SimulationError
from ..mechanism.mechanism import DrivingConstraint, GROUND
from ..mechanism.named_array import reals

LIMIT, CHANGE_POINT, UNCLEAR = 'limit', 'change point', 'unclear'
# Closure error that is taken for zero, of the size or 1.
OPEN = 10.0 * TOLERANCE
# Where a branch ends, its scaled Jacobian has a singular value below this; and the driving
# equations have at least such a share in what contradicts itself there, unless loops alone do.
SINGULAR, DRIVEN = 1e-3, 1e-4


class BranchEnd(NamedTuple):
    """
    Where a branch ends, and why.

    Attributes
    ----------
    values : ndarray, shape (m,)
        Driven values there [rad or m].
    position : ndarray, shape (nq,)
        The last position of the branch.
    kind : str
        ``'limit'``: what is driven can go no further; ``'change point'``: closure equations
        depend on one another, and branches meet; ``'unclear'``.
    reason : str
        In words.

    """

    values: np.ndarray
    position: np.ndarray
    kind: str
    reason: str


class BranchEndError(SimulationError):
    """
    Driven values that the branch does not reach.

    Attributes
    ----------
    end : BranchEnd
    reached : int
        How many of the driven poses lie before the end.

    """

    def __init__(self, end: BranchEnd, reached: int, of_several: bool = False) -> None:
        """Say why, and before which pose of several."""
        super().__init__(f'pose {reached}: {end.reason}' if of_several else end.reason)
        self.end, self.reached = end, reached


class DrivenMotion(NamedTuple):
    """
    The motion of a driven mechanism.

    Attributes
    ----------
    position : ndarray, shape (n, nq)
        Joint coordinates [rad or m].
    velocity, acceleration : ndarray, shape (n, nv)
        [rad/s or m/s], [rad/s^2 or m/s^2].
    end : BranchEnd or None
        Where the branch ends before the last pose asked for; n are those before it.

    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    end: Optional[BranchEnd]


class DrivenKinematics:
    """
    Follows one branch of a mechanism by driven values.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Its ``motions`` are what is driven: joints, and points along directions.
    position : ndarray, shape (nq,)
        Closing the loops, on the branch to follow [rad or m].

    Attributes
    ----------
    position : ndarray, shape (nq,)
        Where the branch was followed to.
    values : ndarray, shape (m,)
        Driven values there.

    Raises
    ------
    BranchEndError
        Where the position is singular: it is on no single branch.
    ValueError
        Where more, or less, is driven than there are degrees of freedom.

    """

    def __init__(self, mechanism, position):
        """Choose the equations to solve."""
        self._mechanism, self.coordinates = mechanism, mechanism.coordinates
        self._geometry = Geometry(mechanism)
        self._equations, self._size = self._geometry.equations, extent(mechanism)
        # The model of all equations.
        self._model = self._equations.model
        numbers = self._model.cut[:, t.CUT_NUMBER].tolist()
        count = len(mechanism.motions)
        self._drives = np.array(
            [numbers.index(number) for number in range(len(numbers) - count, len(numbers))],
            dtype=np.int64)
        self._unit = np.where(self.coordinates.lengths, self._size, 1.0)
        self._manifold = manifold_of(self._model)
        self.position = np.array(position, dtype=float)
        self.values = self.values_at(self.position)
        # The equations to solve, none yet; directions of displacements without effect.
        self._kept = np.zeros(0, dtype=np.int64)
        self._anchors = np.zeros((0, len(self._unit)))
        self._require_determined()

    def start_at(self, position):
        """Go on from another position, shape (nq,), which closes the loops."""
        self.position = np.array(position, dtype=float)
        self.values = self.values_at(self.position)

    @property
    def names(self) -> Tuple[str, ...]:
        """Names of the driven joints and points."""
        return driven_names(self._mechanism)

    def values_at(self, position):
        """Return the driven values of a position, shape (m,) [rad or m]."""
        column = self._model.cut_point.shape[1] - t.MOTION_COLUMNS
        self._model.cut_point[self._drives, column:] = 0.0
        psi = self._equations.move(position).closures()[0]
        return psi[len(psi) - len(self._drives):].copy()

    def follow(self, values):
        """
        Move through driven values, one pose after the other; ``position`` is the last one.

        Values [rad or m] have the shape (n, m) or (n, m, 3), with their rates and accelerations,
        which are zero when not given. Returns a DrivenMotion.
        """
        wanted = np.array(values, dtype=float)
        if wanted.ndim == 2:
            wanted = np.concatenate([wanted[..., np.newaxis], np.zeros((*wanted.shape, 2))], -1)
        count = len(wanted)
        position = np.empty((count, len(self.position)))
        velocity, acceleration = np.empty((2, count, len(self._unit)))
        done, end, stuck = 0, None, False
        while done < count:
            reached, share = self._model.follow_drives(
                self._equations.work, self._manifold, self._drives, self._kept, self._unit,
                self._anchors, OPEN * max(1.0, self._size), self.values, wanted[done:].copy(),
                self.position, position[done:], velocity[done:], acceleration[done:])
            done += int(reached)
            self.values = wanted[done - 1, :, 0].copy() if reached else self.values
            if done == count:
                break
            self.values += share * (wanted[done, :, 0] - self.values)
            # Other equations of those that repeat one another may serve from here on.
            if stuck and not (reached or share > 1e-9) or not self._choose():
                end = self._end_here()
                break
            stuck = True
        return DrivenMotion(position[:done], velocity[:done], acceleration[:done], end)

    def go_to(self, values):
        """Move to driven values; return the position there, shape (nq,); raise BranchEndError."""
        motion = self.follow(np.array(values, dtype=float).reshape(1, -1))
        if motion.end is not None:
            raise BranchEndError(motion.end, 0)
        return motion.position[0]

    def reach(self, grid, seeds, values, actuated, reached, position, rates):
        """
        Reach nodes of a grid of driven values from others; no other thread may use this meanwhile.

        Parameters
        ----------
        grid : ndarray of int, shape (3, number of axes)
            Nodes along each axis; the first, and the one behind the last, that may be written.
        seeds : ndarray of int
            Nodes whose positions are known.
        values : ndarray, shape (n, m)
            Driven values of all nodes [rad or m].
        actuated : ndarray of int
            Places of coordinates among the rates.
        reached : ndarray of int, shape (n,)
            Not zero where a node was reached; written.
        position : ndarray, shape (n, nq)
            Likewise [rad or m].
        rates : ndarray, shape (n, number of actuated * m)
            Derivatives of the actuated coordinates by the driven values; likewise.

        Returns
        -------
        int
            How many nodes were reached.

        """
        return self._model.reach_poses(
            self._equations.work, self._manifold, self._drives, self._kept, self._unit,
            self._anchors, OPEN * max(1.0, self._size), grid, seeds, values, actuated, reached,
            position, rates)

    def linearised(self, position):
        """
        Return the equations near a closed position, with derivatives by scaled displacements.

        Closure errors of the equations of the loops that are solved, (nl,); their Jacobian, (nl,
        nv); driven values, (m,); and theirs, (m, nv).
        """
        values = self.values_at(position)
        jac, count = self._equations.jacobian() * self._unit, len(values)
        kept = self._kept[self._kept < len(jac) - count]
        return self._equations.closures()[0][kept], jac[kept], values, jac[len(jac) - count:]

    @property
    def idle(self):
        """Return how many freedoms only turn rods about themselves."""
        return len(self._anchors)

    @property
    def unit(self):
        """Return the units of the scaled displacements, shape (nv,) [rad or m]."""
        return self._unit

    @property
    def size(self):
        """Return the extent of the mechanism [m]."""
        return self._size

    def rates_at(self, position, actuated):
        """Return derivatives of coordinates by driven values, shape (number of actuated, m)."""
        _, loops, _, drives = self.linearised(position)
        right = np.zeros((len(self._unit), len(drives)))
        right[len(loops):len(loops) + len(drives)] = np.eye(len(drives))
        found = np.linalg.solve(np.concatenate((loops, drives, self._anchors)), right)
        return self._unit[actuated, np.newaxis] * found[actuated]

    def closed_from(self, values, position):
        """Return a position with driven values from any other, None where none is found."""
        column = self._model.cut_point.shape[1] - t.MOTION_COLUMNS
        self._model.cut_point[self._drives, column] = values
        return Assembler(self._mechanism, self._equations).closed_from(position)

    def _jacobian(self):
        """Return J of all equations, without units, and of the loops and drives alone."""
        jac = self._equations.move(self.position).dimensionless(self._unit)
        loops = len(jac) - len(self._drives)
        return jac, jac[:loops], jac[loops:]

    def _choose(self):
        """Choose independent equations in the present position; return whether they are others."""
        _, loops, drives = self._jacobian()
        # Those of the loops beside the driving equations, which are always kept.
        left = loops - loops @ np.linalg.pinv(drives) @ drives
        chosen, _ = independent(left, self._equations.groups[:len(loops)])
        kept = np.concatenate((np.flatnonzero(chosen), np.arange(
            len(loops), len(loops) + len(drives)))).astype(np.int64)
        if len(kept) + len(self._anchors) != len(self._unit) or np.array_equal(kept, self._kept):
            return False
        self._kept = kept
        return True

    def _require_determined(self):
        """Refuse drives that are too many, too few or contradictory."""
        jac, loops, drives = self._jacobian()
        if not len(drives):
            raise ValueError(
                'drives: expected a joint, or a point along a direction, that is driven, got '
                'none')
        needed, null, self._anchors = drives_needed(
            self._mechanism, jac, self._unit, self.position)
        if len(drives) != needed:
            raise ValueError(too_few(self._mechanism, needed, null * self._unit)
                             if len(drives) < needed else
                             f'drives: expected as many driven values as there are degrees of '
                             f'freedom ({needed}), got {len(drives)}: '
                             f'{", ".join(self.names)}, which follow from one another')
        if len(null) or not self._choose():
            raise BranchEndError(self._end_here('The start'), 0)

    def _end_here(self, where=None):
        """Say why the branch ends in the present position."""
        jac, loops, drives = self._jacobian()
        columns = np.abs(jac).max(axis=0)
        left, motion = self._lost(
            scaled(jac, self._equations.groups), np.where(columns > 0.0, columns, 1.0))
        if motion is None:
            # Equations that vanish as a whole are scaled out of sight.
            left, motion = self._lost(self._equations.jacobian() * self._unit)
        values = self.values.copy()
        place = ', '.join(
            f'{name} = {self._shown(motion, value)}' for name, motion, value in zip(
                self.names, self._mechanism.motions, values))
        where = f'{where}, at {place},' if where else f'The branch ends at {place}: this'
        if motion is None:
            return BranchEnd(values, self.position.copy(), UNCLEAR, (
                f'{where} is not a singular position, but no position that closes the loops was '
                'found next to it.'))
        names = moving_joints(self.coordinates, motion)
        share = np.abs(left[len(loops):]).max()
        if share < DRIVEN:
            return BranchEnd(values, self.position.copy(), CHANGE_POINT, (
                f'{where} is a change point: closure equations depend on one another there, and '
                f'branches meet; {names} can move on in more than one way.'))
        points = [motion.point for motion in self._mechanism.motions if motion.point]
        kind = ('the edge of what can be reached (a type-1, or serial, singularity)' if points
                else 'a dead centre (a type-2, or parallel, singularity of these drives)')
        return BranchEnd(values, self.position.copy(), LIMIT, (
            f'{where} is {kind}: with {", ".join(dict.fromkeys(self.names))} at rest, {names} '
            'can still move, and what is driven can go no further on this branch.'))

    def _lost(self, jacobian, columns=1.0):
        """Return the dependent equations, and the free motion; None where regular."""
        left, singular, right = np.linalg.svd(jacobian)
        last = min(len(singular), jacobian.shape[1] - len(self._anchors)) - 1
        lost = singular[last] <= SINGULAR * singular[0]
        return left[:, last], right[last] / columns if lost else None

    def _shown(self, motion, value):
        """Return a driven value with its unit."""
        if motion.point is not None:
            return f'{value:.9g} m'
        for coordinates in (self.coordinates, self._mechanism.cut_coordinates):
            if motion.freedom in coordinates.names and coordinates.lengths[
                    coordinates.names.index(motion.freedom)]:
                return f'{value:.9g} m'
        return f'{value:.9g} rad ({math.degrees(value):.6g} deg)'


def driven_mechanism(mechanism, drives=None, points=None):
    """
    Return a mechanism with driven joints and points, and their values.

    ``drives`` and ``points`` are as for ``Model.solve``. The number of poses, None where a single
    one is given; the mechanism; and values, shape (n, m). ValueError.
    """
    if mechanism.motions:
        raise ValueError(
            'drives: expected a scene that prescribes no motions, got '
            f'{", ".join(motion.name for motion in mechanism.motions)}, which it prescribes')
    axes = len(mechanism.joints[0].position) if mechanism.joints else 2
    motions, columns, counts = [], [], {}
    freedoms = [coordinates.names[k] for coordinates in (
        mechanism.coordinates, mechanism.cut_coordinates) for k in coordinates.single]
    for name, value in (drives or {}).items():
        if name not in freedoms:
            raise ValueError(f'drives: expected joints ({", ".join(freedoms)}), got {name!r}')
        motions.append(DrivingConstraint(f'drive {name}', freedom=name))
        columns.append(_numbers(f'drives: {name}', value, 0, counts))
    for name, value in (points or {}).items():
        names = [point.name for point in mechanism.points if point.body != GROUND]
        if name not in names:
            raise ValueError(f'points: expected named points of bodies that move '
                             f'({", ".join(names) or "none"}), got {name!r}')
        places = _numbers(f'points: {name}', value, 1, counts)
        if places.shape[-1] != axes:
            raise ValueError(f'points: {name}: expected {axes} coordinates, got '
                             f'{places.shape[-1]}')
        free = np.isnan(places)
        if (free != free.reshape(-1, axes)[0]).any():
            raise ValueError(f'points: {name}: expected the same coordinates to be NaN in all '
                             'poses')
        for axis in np.flatnonzero(~free.reshape(-1, axes)[0]):
            direction = tuple(float(axis == other) for other in range(axes))
            motions.append(
                DrivingConstraint(f'drive {name} {axis}', point=name, direction=direction))
            columns.append(places[..., axis])
    if len(set(counts.values())) > 1:
        raise ValueError('expected the same number of poses everywhere, got ' + ', '.join(
            f'{count} in {what}' for what, count in counts.items()))
    for motion, column in zip(motions, columns):
        if not np.isfinite(column).all():
            raise ValueError(f'{motion.name}: expected finite numbers, got {column!r}')
    count = next(iter(counts.values()), None)
    values = np.array([np.broadcast_to(column, count or 1) for column in columns]).T
    return count, replace(mechanism, motions=tuple(motions)), values.reshape(
        count if count is not None else 1, len(motions)).copy()


def _numbers(what, value, axes, counts):
    """Return numbers of one pose, of so many axes, or of several; note how many poses."""
    found = reals(what, value)
    if found.ndim not in (axes, axes + 1):
        raise ValueError(f'{what}: expected {axes} or {axes + 1} axes, got shape {found.shape}')
    if found.ndim > axes:
        if not len(found):
            raise ValueError(f'{what}: expected one pose or more, got none')
        counts[what] = len(found)
    return found
