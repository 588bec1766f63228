# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Joints of the spanning tree and the bodies that they carry, as rows of the model's arrays.

In the plane a joint is one row, in the user's frames. In space the user's frames lie as drawings
have them; those of the rows lie so that what turns does so about Z, that successive parallel axes
share it, and that as many constants as can be are exactly 0: each of these saves operations. A
joint of several freedoms is several rows there, and bodies that are fixed to one another share
one.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..codegen import plane, space
from ..codegen.space import cleared, snapped
from ..codegen.spatial import X, Y, Z
from ..engine import types as t
from ..mechanism.inertia import inertia_matrix
from ..mechanism.kinematics import steps_of
from ..mechanism.mechanism import (
    FREE, GROUND, HELICAL, JOINT_FREEDOMS, PLANAR, PRISMATIC, REVOLUTE, SPHERICAL)
from ..mechanism.rotations import cross, of_quaternion

UNIT = np.eye(3)
# Rows of joints that move along or about the axes of their frame: type, axis.
_SLIDES = tuple((t.PRISMATIC, axis) for axis in (X, Y, Z))
_BALL = tuple((t.BALL, axis) for axis in (X, Y, Z))
_BY_FRAME = {SPHERICAL: _BALL, FREE: _SLIDES + _BALL,
             PLANAR: (*_SLIDES[:2], (t.REVOLUTE, Z))}
_KINDS = {REVOLUTE: t.REVOLUTE, PRISMATIC: t.PRISMATIC, HELICAL: t.HELICAL}


class Placement(NamedTuple):
    """Where a body's frame is in the frame of its row; in the plane the two are the same."""

    row: int  # 0 for the ground
    axes: np.ndarray  # Shape (3, 3): Columns: the body's axes
    origin: np.ndarray  # Shape (3,): [m]

    def place(self, point):
        """Return a point of the body's frame, of 2 or 3 numbers, in that of the row."""
        size = len(point)
        return self.axes[:size, :size] @ point + self.origin[:size]

    def set_masses(self, constants, mass, center, inertia):
        """
        Add a rigid mass [kg] on the body to ``Model.body``, in place.

        ``center``: its centre of mass in the body's frame [m]; ``inertia``: about that, in the
        body's axes, as ``mechanism.Body`` has it [kg m^2].
        """
        if len(center) == 2:
            plane.set_masses(constants[self.row], mass, self.place(center), inertia)
            return
        space.set_masses(constants[self.row], mass, *_in_row(
            self.axes.tobytes(), self.origin.tobytes(), tuple(center), inertia))


@lru_cache(maxsize=1024)
def _in_row(axes, origin, center, inertia):
    """Return a body's centre of mass and inertia in the frame of its row; they rarely change."""
    axes, origin = np.frombuffer(axes).reshape(3, 3), np.frombuffer(origin)
    return axes @ center + origin, axes @ inertia_matrix(inertia) @ axes.T


class TreeRows:
    """
    Rows of a tree in the plane, joint by joint; in space a subclass overrides them.

    ``tree`` and ``body`` are as ``engine.types.Model`` has them; ``placements`` by body, the
    ground among them; ``rows`` of the tree by joint.
    """

    COLUMNS = t.BODY_COLUMNS

    def __init__(self, mechanism, decomposition):
        joints = mechanism.joints
        self._bodies = {body.name: body for body in mechanism.bodies}
        self._joints = joints
        self.placements = {GROUND: Placement(0, UNIT, np.zeros(3))}
        self.rows = {}
        self._tree = [(0,) * t.TREE_COLUMNS]
        self._constants = [np.zeros(self.COLUMNS)]
        freedoms = [JOINT_FREEDOMS[joint.type] for joint in joints]
        balls = [joint.type in (SPHERICAL, FREE) for joint in joints]
        first = np.cumsum([0] + freedoms)
        coordinate = first + np.cumsum([0] + balls)
        for index in decomposition.joint_order:
            joint = joints[index]
            begin = len(self._tree)
            self.placements[joint.child] = self._add(joint, first[index], coordinate[index])
            self.rows[joint.name] = [*range(begin, len(self._tree))]
        self.tree, self.body = np.array(self._tree, dtype=np.int64), np.array(self._constants)
        for number, names in enumerate(decomposition.subsystems):
            for name in names:
                self.tree[self.rows[name], t.SUBSYSTEM] = number
        set_masses_of_bodies(self.body, self.placements, self._bodies)

    def _add(self, joint, dof, coordinate):
        """Add the rows of a joint; return the placement of the body that it carries."""
        kind = t.PRISMATIC if joint.type == PRISMATIC else t.REVOLUTE
        self._tree.append((self.placements[joint.parent].row, dof, kind, 0, coordinate, 0, 0))
        constant = np.zeros(t.BODY_COLUMNS)
        constant[[t.JOINT_X, t.JOINT_Y, t.ANGLE]] = *joint.position, joint.angle
        self._constants.append(constant)
        return self.placements[GROUND]._replace(row=len(self._tree) - 1)


class SpatialTreeRows(TreeRows):
    """Rows of a tree in space; as for ``TreeRows``."""

    COLUMNS = space.BODY_COLUMNS

    def _add(self, joint, dof, coordinate):
        """Add the rows of a joint, as in the plane."""
        parent = self.placements[joint.parent]
        axes = snapped(parent.axes @ of_quaternion(joint.orientation))
        place, row, begin = parent.place(joint.position), parent.row, len(self._tree)
        for kind, axis, turned in self._freedoms(joint, axes):
            constant = np.zeros(space.BODY_COLUMNS)
            constant[space.PLACE:space.PLACE + 3] = cleared(place)
            constant[space.TURNED:space.TURNED + 9] = turned.ravel()
            # The frame of a ball begins again; what only slides does not turn.
            constant[space.PARALLEL] = np.array_equal(turned, UNIT)
            if kind == t.HELICAL:
                constant[space.LEAD] = joint.lead
            self._tree.append((row, dof, kind, 0, coordinate, axis, 0))
            self._constants.append(constant)
            row, place, axes = len(self._tree) - 1, np.zeros(3), snapped(turned.T @ axes)
            dof, coordinate = dof + 1, coordinate + (kind != t.BALL)
        for last in range(max(begin, len(self._tree) - 3), len(self._tree)):
            if self._tree[last][t.TYPE] == t.BALL:
                self._tree[last] = (*self._tree[last][:t.COORDINATE], coordinate,
                                    *self._tree[last][t.AXIS:])
        return Placement(row, axes, place)

    def _freedoms(self, joint, axes):
        """Yield (type, axis, frame in that of the row before) of each row of a joint."""
        if joint.type in _BY_FRAME:
            turned = axes
            for kind, axis in _BY_FRAME[joint.type]:
                yield kind, axis, turned
                turned = UNIT
            return
        steps = steps_of(joint)
        for n, (kind, axis) in enumerate(steps):
            hint = steps[n + 1][1] if n + 1 < len(steps) else self._direction(joint.child)
            turned = frame_along(axes @ axis, axes @ hint)
            yield _KINDS[kind], Z, turned
            axes = turned.T @ axes

    def _direction(self, name):
        """Return a direction of a body that many of its constants lie along."""
        places = [self._bodies[name].center_of_mass, *(
            joint.position for joint in self._joints if joint.parent == name)]
        return np.array(max(places, key=np.linalg.norm))


def set_masses_of_bodies(constants, placements, bodies, rows=None):
    """
    Write masses into rows of ``Model.body``, in place, where they are zero.

    ``placements`` of all bodies are in the order of the rows: in that they are added up, to the
    last bit; ``bodies`` are by name; ``rows``: those to write, all when None.
    """
    for name, placement in placements.items():
        if name != GROUND and (rows is None or placement.row in rows):
            body = bodies[name]
            placement.set_masses(constants, body.mass, body.center_of_mass, body.inertia)


def frame_along(axis, hint=(0.0, 0.0, 0.0)):
    """Return a frame with an axis as its Z, X towards a hint; the present one where that does."""
    axis = snapped(np.array(axis) / np.linalg.norm(axis))
    if np.array_equal(axis, UNIT[Z]):
        return UNIT
    across = hint - axis * (axis @ hint)
    if np.linalg.norm(across) <= 1e-9 * np.linalg.norm(hint):
        # Perpendicular to the axis and to the present axis that it is the least along.
        across = cross(UNIT[np.argmin(np.abs(axis))], axis)
    across = snapped(across / np.linalg.norm(across))
    return snapped(np.column_stack([across, cross(axis, across), axis]))
