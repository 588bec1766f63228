# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Generated derivatives of what is seen of a motion: by instruments on bodies, and in joints.

Of points fixed in bodies the place, the axes of the body, its angular velocity, and the specific
force: the acceleration less gravity, as an accelerometer has it; of joints the wrenches. All
follow from q, qd, tau and parameters, accelerations and multipliers by the equations of motion.
"""

from .function_table import QDD
from .scene_routines import POINT
from .sensitivities import SensitivityTrace
from .vectors import add, cross, in_space, times
from ..engine.types import DOF, PARENT

# Numbers of a point: place, axes of the body in rows, angular velocity, specific force; and where
# they begin.
PLACE, AXES, SPIN, FORCE, POINT_NUMBERS = 0, 3, 12, 15, 18


class MotionTrace(SensitivityTrace):
    """
    A mechanism with its effects, traced for derivatives of what is seen of its motion.

    ``bodies``: rows of the bodies that the first points are fixed in, whose places in the frames
    of the rows are the numbers POINT; the points after them are the origins of the joints, as of
    ``rows`` of ``SensitivityTrace``. Wrenches are those of its ``rows`` and ``cuts``.
    """

    def __init__(self, model, act, values, entries, bodies, rows, cuts):
        super().__init__(model, act, values, entries, rows, cuts)
        self._bodies = bodies

    def motion(self):
        """
        Return the routine: changes of accelerations, then all numbers, then their changes.

        Numbers: those of each point, then moment and force of each wrench.
        """
        own, wrenches, closed = self._balanced()
        points = self.symbols(POINT, (len(self._bodies) + len(self._rows), 3))
        rates = self._accelerations()
        found = []
        for row, point in zip(self._bodies, points):
            found += self._seen(row, in_space(point), rates[row])
        found += self._in_world(wrenches, points[len(self._bodies):])
        solved, changes = self._changes_in_motion(found, [*own, *closed])
        return self.returned('motion', [*solved[:self.nv], *found, *changes])

    def _accelerations(self):
        """Return angular acceleration and specific force of the origins of all bodies."""
        one, tree, qdd = self.recursion, self.constant.tree, list(self.symbols(QDD, (self.nv,)))
        for frame, turns in one.balls(self.constant):
            qdd[turns] = times(frame, qdd[turns])
        moved = [6 * (0.0,)]
        for i in range(1, len(tree)):
            moved.append(one.propagate_acceleration(i, moved[tree[i, PARENT]], qdd[tree[i, DOF]]))
        return [(add(change[:3], motion.spin_rate), add(change[3:], motion.acceleration))
                for change, motion in zip(moved, one.motion)]

    def _seen(self, row, point, rates):
        """Return the numbers of a point."""
        motion, (turning, force) = self.recursion.motion[row], rates
        offset = times(motion.frame, point)
        force = add(force, add(cross(turning, offset),
                               cross(motion.spin, cross(motion.spin, offset))))
        axes = [entry for line in motion.frame for entry in line]
        return [*add(motion.origin, offset), *axes, *motion.spin, *force]
