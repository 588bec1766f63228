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

"""Geometry and forces of a mechanism in space: loops, places, energies, wrenches."""

from contextlib import suppress

import numpy as np

from .assembly import Assembler, RANK_TOLERANCE
from .errors import AssemblyError
from .spatial_modeling import build_spatial_model
from ..core import types as t
from ..core.codegen import space
from ..core.equations import Equations
from ..mechanism.decomposition import decompose
from ..mechanism.mechanism import FIXED

# Relative rounding errors of a Jacobian, and what closure errors make of entries that are zero in
# a closed position, are below this.
ROUNDING = 1e-10


class SpatialGeometry:
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
    model : core.types.Model
    equations : core.equations.Equations
        Of ``model``.
    placements : dict of str to spatial_modeling.Placement
        Where the bodies' frames are in those of their rows.
    rows : dict of str to int
        Row of each body in the model's arrays.

    """

    def __init__(self, mechanism, decomposition=None):
        """Build the model of all equations."""
        self.mechanism = mechanism
        self._decomposition = decomposition or decompose(mechanism)
        self.model = self._first = None
        self._build(None)
        self.rows = {name: one.row for name, one in self.placements.items()}
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

    def _build(self, kept):
        """Build the model, and its equations."""
        built = build_spatial_model(
            self.mechanism, decomposition=self._decomposition, kept=kept)
        model = built.model
        if self.model is not None:
            # Effects have changed these since.
            model = model._replace(
                tree=self.model.tree, body=self.model.body, gravity=self.model.gravity,
                cut_point=self.model.cut_point)
        self.model, self.placements = model, built.placements
        self.equations = Equations(self.model)

    def leave_out_repeated(self, q):
        """
        Let the elimination work on equations that do not repeat one another.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Near a position that closes the loops.

        """
        assembler = Assembler(self.mechanism, self.equations)
        with suppress(AssemblyError):
            kept = independent(
                assembler.jacobian_of_largest_rank(assembler.positions(q)), self.equations.groups)
            if not kept.all():
                self._first = kept
                self._build(kept)

    def as_at_first(self):
        """Go back to the equations that were chosen first; return the model."""
        self._build(self._first)
        return self.model

    def closed_anew(self, q, better):
        """
        Choose the equations that the elimination works on anew, where the present ones serve ill.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Nearly closing the loops.
        better : float
            How much further from dependent another choice must be.

        Returns
        -------
        Model or None
            Of the new choice, of as many equations; None where the present one is as good.

        """
        assembler = Assembler(self.mechanism, self.equations)
        jac = assembler.jacobian_of_largest_rank(q)
        kept, present = independent(jac, self.equations.groups), self.equations.kept
        if kept.sum() != present.sum() or not (
                _distinct(jac, self.equations.groups, kept)
                > better * _distinct(jac, self.equations.groups, present)):
            return None
        self._build(kept)
        return self.model

    @property
    def leaves_out(self):
        """Whether the elimination leaves out equations that repeat others."""
        return not self.equations.kept.all()

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

    def poses(self, q):
        """
        Return the poses of the bodies at a position.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Joint coordinates.

        Returns
        -------
        ndarray, shape (nb, 7)
            As ``poses_among`` does.

        """
        return self.poses_among(self.equations.move(q).work.body)

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

    def points_among(self, body):
        """
        Return the places of all named points where the rows of the tree are.

        Parameters
        ----------
        body : ndarray, shape (nb + 1, WORK_COLUMNS)
            As for ``poses_among``.

        Returns
        -------
        ndarray, shape (number of points, 3)
            In the world [m].

        """
        rows, positions, _ = self._points
        return _placed(body, rows, positions)[0]

    def joint_wrenches_among(self, body, wrenches):
        """
        Return the wrenches in the joints at the origins of the bodies that they carry.

        Parameters
        ----------
        body : ndarray, shape (nb + 1, WORK_COLUMNS)
            As for ``poses_among``.
        wrenches : ndarray, shape (nv, 6)
            At the origins of the rows, in the order of the rates.

        Returns
        -------
        ndarray, shape (number of joints, 6)
            Moment, then force; NaN in a fixed joint, of which the kernels know nothing.

        """
        rows, origins, _ = self._carried
        arms = _placed(body, rows, origins)[0] - body[rows, space.ORIGIN:space.ORIGIN + 3]
        # A fixed joint has no row of its own.
        found = np.vstack([np.full(6, np.nan), wrenches])[
            np.where(rows > 0, self.model.tree[rows, t.DOF] + 1, 0)]
        found[:, :3] -= np.cross(arms, found[:, 3:])
        found[self._fixed] = np.nan
        return found


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
    # q q^T, of which the column with the largest diagonal entry tells q best.
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(matrices, 0, -1)
    outer = 0.25 * np.array([
        [1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
        [xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx],
        [xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy],
        [zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz]])
    best = np.argmax(np.einsum('iin->in', outer), axis=0)
    columns = outer[:, best, np.arange(len(best))].T
    return columns / np.copysign(
        np.linalg.norm(columns, axis=1), columns[:, 3])[:, np.newaxis]


def scaled(jac, groups):
    """
    Scale a Jacobian so that neither units of coordinates nor those of equations decide.

    Parameters
    ----------
    jac : ndarray, shape (nc, nv)
        Of all equations. Rounding errors of entries that are zero are not scaled up.
    groups : ndarray of int, shape (nc,)
        Equations of one kind, which are scaled alike: one that hardly changes stays small.

    Returns
    -------
    ndarray, shape (nc, nv)

    """
    columns = np.abs(jac).max(axis=0, initial=0.0)
    moves = columns > ROUNDING * columns.max(initial=0.0)
    found = np.where(moves, jac / np.where(moves, columns, 1.0), 0.0)
    rows = np.zeros(groups.max(initial=-1) + 1)
    np.maximum.at(rows, groups, np.linalg.norm(found, axis=1))
    rows = rows[groups][:, np.newaxis]
    return np.where(rows > ROUNDING, found / np.maximum(rows, ROUNDING), 0.0)


def independent(jac, groups):
    """
    Choose rows of a Jacobian that do not depend on one another, by pivoting.

    Parameters
    ----------
    jac : ndarray, shape (nc, nv)
        Of all equations.
    groups : ndarray of int, shape (nc,)
        As for ``scaled``.

    Returns
    -------
    ndarray of bool, shape (nc,)

    """
    kept, left = np.zeros(len(jac), dtype=bool), scaled(jac, groups)
    while not kept.all():
        length = np.where(kept, 0.0, np.linalg.norm(left, axis=1))
        best = int(np.argmax(length))
        if length[best] <= RANK_TOLERANCE:
            break
        kept[best] = True
        direction = left[best] / length[best]
        left = left - np.outer(left @ direction, direction)
    return kept


def _distinct(jac, groups, kept):
    """Return the smallest singular value of some equations, scaled."""
    return np.linalg.svd(scaled(jac, groups)[kept], compute_uv=False).min(initial=1.0)


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
