# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Cut joints that have coordinates: these as arrays, and their readings."""

import numpy as np

from ..codegen.space import FRAME
from ..effects.effect_table import EffectTable
from ..effects.element import (
    ACROSS_B, AXIS, CUT_INDEX_COLUMNS, CUT_VALUE_COLUMNS, IN_PLANE, POINT_A, POINT_B, SCALE,
    SIDE_A, SIDE_B, SLIDES, ZERO)
from ..engine import types as t
from ..mechanism.cut_freedoms import cut_freedoms
from ..mechanism.mechanism import CYLINDRICAL, GROUND, HELICAL, PLANAR, REVOLUTE, SPHERICAL
from ..mechanism.rotations import in_three, of_quaternion, quaternions_of


def acted_in(mechanism, effects):
    """Return the names of the freedoms of cut joints that anything acts along, in their order."""
    known = mechanism.cut_coordinates
    named = {getattr(record, 'joint', None) for record in effects.values()}
    return tuple(name for place, name in enumerate(known.names)
                 if name in named or place in known.actuated)


def coordinate_arrays(mechanism, model, placements, names, followed):
    """
    Return the coordinates of some cut joints as arrays.

    ``placements``: where the bodies' frames are in those of their rows; ``names`` of freedoms of
    cut joints; ``followed``: whether angles in space are followed, in the place of a number within
    half a turn. Index and values, a row each, are as ``EffectTable.of`` takes them.
    """
    index = np.zeros((len(names), CUT_INDEX_COLUMNS), dtype=np.int64)
    values = np.zeros((len(names), CUT_VALUE_COLUMNS))
    numbers = {cut.name: k for k, cut in enumerate(mechanism.cut_joints)}
    known = cut_freedoms(mechanism) if len(names) else {}
    for one, line, name in zip(index, values, names):
        freedom = known[name]
        cut = freedom.cut
        a, b = (placements[body] for body in freedom.bodies)
        turns = not (freedom.slides or mechanism.planar)
        point_a, point_b = map(in_three, freedom.points)
        one[:] = (freedom.slides, mechanism.planar, a.row, b.row,
                  0 if turns and followed else -1,
                  np.flatnonzero(model.cut[:, t.CUT_NUMBER] == numbers[cut.name])[0],
                  cut.type == SPHERICAL,
                  cut.type == CYLINDRICAL or freedom.slides and cut.type != PLANAR)
        line[POINT_A:POINT_A + 3] = a.place(point_a)
        line[POINT_B:POINT_B + 3] = b.place(point_b)
        line[AXIS:AXIS + 3] = b.axes @ freedom.axis
        line[SCALE] = 1.0 / cut.lead if cut.type == HELICAL else 1.0
        line[ZERO] = cut.angle
        if freedom.turn is not None:
            _, side, there = freedom.turn
            line[SIDE_A:SIDE_A + 3] = a.axes @ side
            line[SIDE_B:SIDE_B + 3] = b.axes @ there
            line[ACROSS_B:ACROSS_B + 3] = b.axes @ np.cross(freedom.axis, there)
    return index, values


def coupling_moments(mechanism):
    """
    Return the moments of couplings at revolute cut joints in the plane.

    Their equations are in the coordinates of the tree, where their torques act in each joint on
    the way to the ground; they are handed over at the cut joint. Moments there, for a unit of the
    coupling's force, shape (cut joints, couplings), and what that leaves in the joints of the
    tree, beside the torques of the equations, shape (joints, couplings).
    """
    places = {joint.child: place for place, joint in enumerate(mechanism.joints)}
    at_cuts, in_joints = (np.zeros((len(joints), len(mechanism.couplings)))
                          for joints in (mechanism.cut_joints, mechanism.joints))
    for n, coupling in enumerate(mechanism.couplings if mechanism.planar else ()):
        for k, cut in enumerate(mechanism.cut_joints):
            if cut.type != REVOLUTE or cut.name not in coupling.joints:
                continue
            at_cuts[k, n] = coupling.joints[cut.name]
            for body, sign in ((cut.body_a, -1.0), (cut.body_b, 1.0)):
                while body != GROUND:
                    in_joints[places[body], n] += sign * at_cuts[k, n]
                    body = mechanism.joints[places[body]].parent
    return at_cuts, in_joints


class CutJoints:
    """
    The coordinates of all cut joints that have some.

    ``model`` and ``placements`` are as for ``coordinate_arrays``. ``names`` are those of all
    freedoms; ``acted``, given by name, are the places among them of those that anything acts
    along.
    """

    def __init__(self, mechanism, model, placements, acted):
        self._coordinates = mechanism.cut_coordinates
        self.names = self._coordinates.names
        self.acted = np.array([self.names.index(name) for name in acted], dtype=int)
        self._index, self._values = coordinate_arrays(
            mechanism, model, placements, self.names, False)
        self.count, numbers = len(self.names), [cut.name for cut in mechanism.cut_joints]
        known = cut_freedoms(mechanism) if self.count else {}
        self._numbers = [numbers.index(one.cut.name) for one in known.values()]
        # Efforts act on the freedom's own body A.
        self._signs = [-1.0 if one.exchanged else 1.0 for one in known.values()]
        self._table = EffectTable.of(model, model, cuts=(self._index, self._values))
        # Spherical joints: the rows of bodies B, then of A; the joints' axes in their frames.
        balls = [cut for cut in mechanism.cut_joints
                 if cut.name in self._coordinates.with_orientation]
        ends = [(placements[cut.body_b], of_quaternion(cut.orientation)) for cut in balls]
        ends += [(placements[cut.body_a], np.eye(3)) for cut in balls]
        self._rows = np.array([placed.row for placed, _ in ends], dtype=int)
        self._axes = np.array([placed.axes @ axes for placed, axes in ends])
        self._quaternions = self._coordinates.balls[:, :1] + np.arange(4)
        self._singles = self._coordinates.place[self._coordinates.single]

    def measure(self, body):
        """
        Return positions and velocities, given ``Workspace.body`` after the outward recursion.

        Angles in space from -pi to pi, zero in the place of a spherical joint's [rad; m], [rad/s;
        m/s].
        """
        position, velocity = np.zeros(self.count), np.zeros(self.count)
        self._table.measure_cut_coordinates(body, position, velocity)
        return position, velocity

    def whole(self, body, position):
        """
        Return all coordinates, shape (nq of ``Mechanism.cut_coordinates``,).

        ``body`` and ``position``, of what has one number, are those of ``measure``.
        """
        if not len(self._rows):
            return position
        found = np.empty(self._coordinates.nq)
        found[self._singles] = position[self._coordinates.single]
        frames = body[self._rows, FRAME:FRAME + 9].reshape(-1, 3, 3) @ self._axes
        count = len(frames) // 2
        found[self._quaternions] = quaternions_of(frames[:count].swapaxes(1, 2) @ frames[count:])
        return found

    def accelerations(self, equations, qdd):
        """Return accelerations [rad/s^2; m/s^2], given those of the tree in a state."""
        out = self._table.cuts.qdd
        self._table.cut_accelerations(equations.model, equations.work, qdd, True, out)
        return out[len(qdd):].copy()

    def place(self, name):
        """Return the place of a freedom among the names; None where it is not one of them."""
        return self.names.index(name) if name in self.names else None

    def add_efforts(self, body, efforts, wrenches):
        """
        Add the efforts along the coordinates to the wrenches at cut joints, in place.

        ``body`` is as for ``measure``; efforts in N m or N; wrenches, shape (number of cuts, 3 or
        6), in the mechanism's order.
        """
        for place, effort in enumerate(efforts):
            if effort == 0.0:
                continue
            one, line = self._index[place], self._values[place]
            wrench = wrenches[self._numbers[place]]
            axis = np.array(self._table.cut_axis(body, place))
            along = self._signs[place] * line[SCALE] * effort * axis
            if one[IN_PLANE]:
                wrench[:] += (0.0, *along[:2]) if one[SLIDES] else (along[2], 0.0, 0.0)
            else:
                wrench[3 * one[SLIDES]:3 * one[SLIDES] + 3] += along

    def jacobian(self, model, work, names):
        """
        Return the derivatives of coordinates by those of the tree, after the outward recursion.

        Shape (number of names, nv), of freedoms by name.
        """
        nv, out = len(model.tree) - 1, self._table.cuts.qdd
        columns = []
        for unit in np.eye(nv):
            self._table.cut_accelerations(model, work, unit, False, out)
            columns.append(out[[nv + self.names.index(name) for name in names]])
        return np.array(columns).reshape(nv, len(names)).T
