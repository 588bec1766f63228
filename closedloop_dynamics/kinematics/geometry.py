# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Geometry and masses of a model: places and poses of bodies, by name."""

import numpy as np

from .loop_model import LoopModel
from .tree_rows import set_masses_of_bodies
from ..codegen import space
from ..engine import types as t
from ..mechanism.mechanism import FIXED
from ..mechanism.rotations import quaternions_of


class Geometry(LoopModel):
    """A model, on numbers and by name; see ``LoopModel``."""

    def __init__(self, mechanism, decomposition=None):
        super().__init__(mechanism, decomposition)
        self._size = 2 if mechanism.planar else 3
        #: Rows and places in them of the named points.
        self.named_points = self._placed_points(
            [(point.body, point.position) for point in mechanism.points])
        bodies = [body.name for body in mechanism.bodies]
        self._origins = self._placed_points([(name, np.zeros(self._size)) for name in bodies])
        self._axes = np.array([self.placements[name].axes for name in bodies])

    def _placed_points(self, points):
        """Return the rows of bodies' points, pairs of name and position, and the places there."""
        placed = [self.placements[body] for body, _ in points]
        return np.array([one.row for one in placed], dtype=int), np.array(
            [one.place(place) for one, (_, place) in zip(placed, points)]).reshape(-1, self._size)

    def set_masses(self, constants, bodies, changed):
        """
        Write the masses of some bodies into rows of ``Model.body``, in place.

        ``constants`` are without what effects add; ``bodies`` are all of the mechanism's;
        ``changed``: names of those that have other masses, centres of mass or inertias.
        """
        # A row has the masses of all bodies that are fixed to one another.
        rows = {self.placements[name].row for name in changed}
        end = t.INERTIA + 1 if self.mechanism.planar else space.INERTIA + 6
        for row in rows:
            constants[row, :end] = 0.0
        set_masses_of_bodies(
            constants, self.placements, {body.name: body for body in bodies}, rows)

    def point(self, q, body, position):
        """Return where a point in a body's frame is in the world [m], at coordinates q."""
        return self._in_world(self.equations.move(q).work,
                              *self._placed_points([(body, position)]))[0]

    def _in_world(self, work, rows, places):
        """Return places in the frames of rows in the world."""
        found = np.empty(places.shape)
        work.place_points(rows, places, found)
        return found

    def poses_among(self, work):
        """
        Return the poses of the bodies, in the mechanism's order, where the rows of the tree are.

        ``work``: a workspace, after the outward recursion. x, y [m] and angle [rad], shape (nb,
        3); in space x, y, z of the frame's origin and its unit quaternion x, y, z, w, shape (nb,
        7).
        """
        rows, origins = self._origins
        places, body = self._in_world(work, rows, origins), work.body
        if self.mechanism.planar:
            return np.column_stack([places, body[rows, t.ALPHA]])
        frames = body[rows, space.FRAME:space.FRAME + 9].reshape(-1, 3, 3)
        return np.hstack([places, quaternions_of(frames @ self._axes)])

    @property
    def joint_places(self):
        """
        Return where the wrenches in the joints act: at the origins of the bodies they carry.

        Rows of the bodies, 0 of fixed joints, of which the kernels know nothing; and the origins
        [m], shape (number of joints, 3), and axes, (number of joints, 3, 3), in the frames of the
        rows.
        """
        joints = self.mechanism.joints
        carried = [self.placements[joint.child] for joint in joints]
        row = np.array([one.row for one in carried], dtype=int)
        row[[joint.type == FIXED for joint in joints]] = 0
        return row, np.array([one.origin for one in carried]), np.array(
            [one.axes for one in carried])
