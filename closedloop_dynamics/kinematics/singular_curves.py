# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Curves of singular positions of a platform that moves in a plane, followed from point to point.

Type 1 (serial): with the platform at rest, a leg can still move: the closure equations with the
platform's coordinates have a singular Jacobian. Type 2 (parallel): with the actuated joints at
rest, the platform can still move; the same with the actuated coordinates. Each is one equation
beside the closure equations: that the last unknown of a bordered system is zero. Together they
hold on a curve of joint coordinates, which is followed by tangent steps and Newton's corrections.
Every point of it is singular to rounding. After C. Gosselin and J. Angeles, "Singularity analysis
of closed-loop kinematic chains", IEEE Trans. Robotics and Automation 6 (1990) 281-290; A. Griewank
and G. W. Reddien, "Characterization and computation of generalized turning points", SIAM J.
Numerical Analysis 21 (1984) 176-184.
"""

from typing import NamedTuple

import numpy as np

TYPE_1, TYPE_2 = 'type 1', 'type 2'
# Newton's corrections of a point, and their scaled length that will do; of a derivative by
# differences [of scaled displacements]; the shortest step, of the longest.
CORRECTIONS, EXACT, DIFFERENCE, SHORTEST = 25, 1e-11, 1e-6, 1e-3
# Scaled: residuals of what counts as singular, and a second singular value where the curve ends.
SINGULAR, CORNER = 1e-8, 1e-5
# Points of a curve, and how far a point may be from one found before, of the step [1].
MOST_POINTS, SAME = 4000, 1.0
# The least cosine between the directions of two steps.
STRAIGHT = 0.7


class SingularCurve(NamedTuple):
    """Singular positions one after the other."""

    kind: str  # ``TYPE_1`` or ``TYPE_2``
    places: np.ndarray  # Shape (n, 2): Of the platform's point, along both axes of the grid [m]
    position: np.ndarray  # Shape (n, nq): Joint coordinates [rad or m]
    closed: bool  # Whether the last point is the first again


class SingularCurves:
    """
    Continuation of singular curves of one kind, ``TYPE_1`` or ``TYPE_2``, of a platform.

    ``moved``, shape (m, 2): driven values by both coordinates of the grid; ``held``, (m,): where
    both are zero [rad or m]; ``actuated``: places of the actuated coordinates among the rates;
    ``box``, (2, 2): least and largest coordinates of the grid [m]: curves end beyond; ``step``:
    from point to point, at most [m].
    """

    def __init__(self, kinematics, moved, held, kind, actuated, coordinates, box, step):
        self._kinematics, self._coordinates, self.kind = kinematics, coordinates, kind
        self._actuated, self._box, self._step = actuated, box, step
        self._held, self._inverse = held, np.linalg.pinv(moved)
        # Combinations of driven values that both coordinates leave alone.
        self._left = np.linalg.svd(moved)[0][:, 2:].T
        self._border = None

    def place(self, position):
        """Return both coordinates of the point, shape (2,) [m]."""
        return self._inverse @ (self._kinematics.values_at(position) - self._held)

    def _matrix(self, position):
        """Return residuals, their Jacobian, and the matrix that is to be singular."""
        loops, loops_jac, values, values_jac = self._kinematics.linearised(position)
        size = self._kinematics.size
        if self.kind == TYPE_1:
            below = values_jac / size
        else:
            below = np.zeros((len(self._actuated), loops_jac.shape[1]))
            below[range(len(self._actuated)), self._actuated] = 1.0
        residuals = np.concatenate((loops, self._left @ (values - self._held))) / size
        jac = np.concatenate((loops_jac, self._left @ values_jac)) / size
        return residuals, jac, np.concatenate((loops_jac / size, below))

    def _smallest(self, matrix):
        """Return the last unknown of the bordered system: zero where the matrix is singular."""
        left, right = self._border
        whole = np.zeros((len(matrix) + 1, len(matrix) + 1))
        whole[:-1, :-1], whole[:-1, -1], whole[-1, :-1] = matrix, left, right
        return np.linalg.solve(whole, np.eye(len(whole))[-1])[-1]

    def _take_border(self, position):
        """Border the matrix by its own singular vectors; return its two smallest values."""
        left, values, right = np.linalg.svd(self._matrix(position)[2])
        self._border = left[:, -1], right[-1]
        return values[-1], values[-2] if len(values) > 1 else np.inf

    def _side(self, position):
        """
        Return on which side of type-1 singular positions one is, by a sign.

        Beyond them a curve of type 2 belongs to another branch.
        """
        if self.kind == TYPE_1:
            return 1.0
        _, loops_jac, _, values_jac = self._kinematics.linearised(position)
        return np.linalg.slogdet(np.concatenate((loops_jac, values_jac)))[0]

    def _moved(self, position, change):
        return self._coordinates.moved(position, self._kinematics.unit * change)

    def _whole(self, position):
        """Return residuals, the singular one last."""
        residuals, _, matrix = self._matrix(position)
        return np.append(residuals, self._smallest(matrix))

    def _derivatives(self, position):
        """Return the Jacobian of all residuals, that of the last one by differences."""
        _, jac, matrix = self._matrix(position)
        here, count = self._smallest(matrix), jac.shape[1]
        last = np.empty(count)
        for k, one in enumerate(np.eye(count)):
            there = self._matrix(self._moved(position, DIFFERENCE * one))[2]
            last[k] = (self._smallest(there) - here) / DIFFERENCE
        return np.vstack((jac, last))

    def _corrected(self, position, tangent=None):
        """
        Return the singular position next to one, None where there is none.

        With a tangent, that in the plane across it.
        """
        for count in range(CORRECTIONS):
            if count % 4 == 0:
                jac = self._derivatives(position)
                if tangent is not None:
                    jac = np.vstack((jac, tangent))
            residuals = self._whole(position)
            if tangent is not None:
                residuals = np.append(residuals, 0.0)
            change = -np.linalg.lstsq(jac, residuals, rcond=1e-12)[0]
            length = np.abs(change).max()
            if not length < 0.3:
                return None
            position = self._moved(position, change)
            if length < EXACT:
                return position
        return None

    def onto(self, position):
        """Return a singular position near another one, shape (nq,); None where none is found."""
        try:
            self._take_border(position)
            found = self._corrected(position)
            if found is None:
                return None
            smallest, second = self._take_border(found)
            residuals = np.abs(self._matrix(found)[0]).max(initial=0.0)
        except np.linalg.LinAlgError:
            return None
        if smallest > SINGULAR or second < CORNER or residuals > SINGULAR:
            return None
        return found

    def follow(self, position):
        """
        Return the curve through a singular position as of ``onto``, a ``SingularCurve``.

        It ends beyond the grid, where it comes back to its first point, where two legs are
        singular at once, and, of type 2, where it meets a curve of type 1 and goes on as that of
        another branch.
        """
        forth, closed = self._one_way(position, 1.0)
        back = [] if closed else self._one_way(position, -1.0)[0]
        positions = np.array([*reversed(back), position, *forth, *([position] if closed else [])])
        places = np.array([self.place(one) for one in positions])
        return SingularCurve(self.kind, places, positions, closed)

    def _tangent(self, position, before):
        """Return the unit tangent of the curve, in scaled displacements."""
        tangent = np.linalg.svd(self._derivatives(position))[2][-1]
        return -tangent if before is not None and tangent @ before < 0.0 else tangent

    def _one_way(self, position, sign):
        """Return the positions that follow, and whether they come back to the first one."""
        found, first, length = [], self.place(position), self._step
        side = self._side(position)
        here, way = first, None
        self._take_border(position)
        tangent = sign * self._tangent(position, None)
        while len(found) < MOST_POINTS:
            speed = self._speed(position, tangent)
            share = min(length / max(speed, 1e-9 * self._step), 0.2)
            try:
                there = self._corrected(self._moved(position, share * tangent), tangent)
                values = None if there is None else self._take_border(there)
            except np.linalg.LinAlgError:
                there = None
            if there is not None:
                place = self.place(there)
                step = place - here
                size = np.linalg.norm(step)
                turned = way is not None and size > 0.0 and (
                    step @ way < STRAIGHT * size * np.linalg.norm(way))
                good = (size < 1.5 * self._step and values[0] < SINGULAR
                        and values[1] > CORNER and not turned and self._side(there) == side)
            if there is None or not good:
                self._take_border(position)
                length *= 0.5
                if length < SHORTEST * self._step:
                    return found, False
                continue
            found.append(there)
            tangent = self._tangent(there, tangent)
            position, here, way = there, place, step
            length = min(self._step, 1.5 * length)
            if not (self._box[0] <= here).all() or not (here <= self._box[1]).all():
                return found, False
            if len(found) > 3 and np.linalg.norm(here - first) < 0.7 * self._step:
                return found, True
        return found, False

    def _speed(self, position, tangent):
        """Return how far the point moves, of a step along the tangent [m]."""
        values_jac = self._kinematics.linearised(position)[3]
        return float(np.linalg.norm(self._inverse @ (values_jac @ tangent)))


def all_curves(curves, seeds):
    """
    Yield the curves next to many positions, singular ones or not, each once.

    ``curves`` are of one kind.
    """
    known = np.zeros((0, 2))
    for seed in seeds:
        place = curves.place(seed)
        near = SAME * curves._step
        if len(known) and np.linalg.norm(known - place, axis=1).min() < near:
            continue
        found = curves.onto(seed)
        if found is None:
            continue
        place = curves.place(found)
        if len(known) and np.linalg.norm(known - place, axis=1).min() < near:
            continue
        curve = curves.follow(found)
        known = np.concatenate((known, curve.places))
        yield curve
