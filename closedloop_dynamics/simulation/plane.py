# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Geometry of a planar mechanism, as ``space`` has it of one in space."""

import numpy as np

from .loop_model import LoopModel
from .modeling import body_rows, build_model, weigh
from ..core import types as t


class PlanarGeometry(LoopModel):
    """
    A planar model, on numbers and by name; see ``LoopModel`` and ``space.SpatialGeometry``.

    Parameters
    ----------
    mechanism : Mechanism
        In the plane.
    decomposition : Decomposition, optional
        Found here when not given.

    """

    def __init__(self, mechanism, decomposition=None):
        """Look up the rows of bodies and points."""
        super().__init__(mechanism, decomposition)
        self._poses = np.ix_(
            [self.rows[body.name] for body in mechanism.bodies], (t.PX, t.PY, t.ALPHA))
        self._points = np.array([self.rows[point.body] for point in mechanism.points], dtype=int)
        self._places = np.array([point.position for point in mechanism.points]).reshape(-1, 2)

    def _built(self, kept):
        """Return the model, the rows of the bodies, whose frames are those of the rows."""
        return (build_model(self.mechanism, decomposition=self._decomposition, kept=kept),
                body_rows(self.mechanism, self._decomposition), None)

    def weigh(self, constants, bodies, changed):
        """
        Write the masses of some bodies into rows of ``Model.body``.

        Parameters
        ----------
        constants : ndarray
            As ``Model.body``, without what effects add; changed in place.
        bodies : sequence of Body
            All of the mechanism's.
        changed : set of str
            Names of those that have other masses, centres of mass or inertias.

        """
        for body in bodies:
            if body.name in changed:
                weigh(constants[self.rows[body.name]], body)

    def point(self, q, body, position):
        """Return the place of a point of a body in a position of the joints, shape (2,) [m]."""
        return _placed(self.equations.move(q).work.body, [self.rows[body]],
                       np.array([position], dtype=float))[0]

    def poses_among(self, body):
        """Return x, y [m] and angle [rad] of the bodies where the rows are, shape (nb, 3)."""
        return body[self._poses]

    @property
    def named_points(self):
        """Return rows and places in them of the named points."""
        return self._points, self._places

    @property
    def joint_places(self):
        """Return the row whose wrench is each joint's, and no places: frames are the rows'."""
        return (np.argsort(self.model.tree[1:, t.DOF]) + 1, np.zeros((0, 3)),
                np.zeros((0, 3, 3)))


def _placed(body, rows, places):
    """Return places in the frames of rows in the world, shape (len(rows), 2)."""
    (px, py, cos, sin), (x, y) = body[rows][:, [t.PX, t.PY, t.COS, t.SIN]].T, places.T
    return np.stack((px + cos * x - sin * y, py + sin * x + cos * y), axis=-1)
