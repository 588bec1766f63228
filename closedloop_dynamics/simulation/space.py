# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Geometry and forces of a mechanism in space: loops, places, energies, wrenches."""

import numpy as np

from .loop_model import LoopModel
from .spatial_modeling import build_spatial_model, weigh
from ..core.codegen import space
from ..core.equations import Equations
from ..engine import native
from ..mechanism.mechanism import FIXED, GROUND


class SpatialGeometry(LoopModel):
    """
    A model in space, on numbers and by name.

    Parameters
    ----------
    mechanism : Mechanism
        In space.
    decomposition : Decomposition, optional
        Found here when not given.

    Attributes
    ----------
    model, equations, placements, rows
        As ``LoopModel`` has them.

    """

    def __init__(self, mechanism, decomposition=None):
        """Look up the frames of bodies and points."""
        super().__init__(mechanism, decomposition)
        self._bodies = self._frames([body.name for body in mechanism.bodies])
        self._carried = self._frames([joint.child for joint in mechanism.joints])
        self._fixed = np.array([joint.type == FIXED for joint in mechanism.joints])
        self._points = self._frames(
            [point.body for point in mechanism.points],
            [point.position for point in mechanism.points])

    def _frames(self, names, positions=None):
        """Return rows, places of origins or other positions in them, and axes, of bodies."""
        placed = [self.placements[name] for name in names]
        places = [one.origin for one in placed] if positions is None else [
            one.place(position) for one, position in zip(placed, positions)]
        return (np.array([one.row for one in placed], dtype=int),
                np.array(places).reshape(-1, 3), np.array([one.axes for one in placed]))

    def _built(self, kept):
        """Return the model, the rows of the bodies and their placements."""
        built = build_spatial_model(
            self.mechanism, decomposition=self._decomposition, kept=kept)
        return built.model, {name: one.row for name, one in built.placements.items()}, (
            built.placements)

    def weigh(self, constants, bodies, changed):
        """As in the plane; a row has the masses of all bodies that are fixed to one another."""
        rows = {self.placements[name].row for name in changed}
        by_name = {body.name: body for body in bodies}
        for row in rows:
            constants[row, space.MASS:space.INERTIA + 6] = 0.0
        # In the order in which they were added up at first, to the last bit.
        for name, placement in self.placements.items():
            if placement.row in rows and name != GROUND:
                weigh(constants[placement.row], placement, by_name[name])

    def point(self, q, body, position):
        """
        Return the place of a point of a body.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Joint coordinates.
        body : str
            Its name.
        position : tuple of 3 floats
            In the body's frame [m].

        Returns
        -------
        ndarray, shape (3,)
            In the world [m].

        """
        placement = self.placements[body]
        return _placed(self.equations.move(q).work.body, [placement.row],
                       placement.place(position)[np.newaxis])[0][0]

    def poses_among(self, body):
        """
        Return the poses of the bodies where the rows of the tree are.

        Parameters
        ----------
        body : ndarray, shape (nb + 1, WORK_COLUMNS)
            Of ``Workspace``, after the outward recursion.

        Returns
        -------
        ndarray, shape (nb, 7)
            x, y, z of the frame's origin [m] and its unit quaternion x, y, z, w, in the
            mechanism's order of bodies.

        """
        rows, origins, axes = self._bodies
        places, frames = _placed(body, rows, origins)
        return np.hstack([places, quaternions(frames @ axes)])

    @property
    def named_points(self):
        """Return rows and places in them of the named points."""
        return self._points[:2]

    @property
    def joint_places(self):
        """
        Return where the wrenches in the joints act: at the origins of the bodies they carry.

        Returns
        -------
        row : ndarray of int, shape (number of joints,)
            Of the bodies; 0 of fixed joints, of which the kernels know nothing.
        point : ndarray, shape (number of joints, 3)
            In the frame of the row [m].
        axes : ndarray, shape (number of joints, 3, 3)
            Of these bodies there.

        """
        row, origins, axes = self._carried
        return np.where(self._fixed, 0, row), origins, axes


def _placed(body, rows, places):
    """Return places in the frames of rows in the world, and these frames."""
    frames = body[rows, space.FRAME:space.FRAME + 9].reshape(-1, 3, 3)
    offsets = (frames @ places[:, :, np.newaxis])[:, :, 0]
    return body[rows, space.ORIGIN:space.ORIGIN + 3] + offsets, frames


def quaternions(matrices):
    """
    Return the unit quaternions x, y, z, w of rotation matrices, w not negative.

    ``matrices``: shape (n, 3, 3).

    """
    found = np.empty((len(matrices), 4))
    native.fill_quaternions(np.ascontiguousarray(matrices), found)
    return found


def equations_left(mechanism):
    """
    Count the equations of each cut joint, without those that always hold.

    Parameters
    ----------
    mechanism : Mechanism
        In space.

    Returns
    -------
    list of int
        In the order of the cut joints.

    """
    return Equations(build_spatial_model(mechanism).model).counts
