# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Cut joints, couplings and prescribed motions, as rows of the model's arrays.

Which of these a closure is, the bodies that its forces pass and the factors of what it couples are
found alike in the plane and in space; what its row says of places and axes is not.
"""

import math

import numpy as np

from .tree_rows import frame_along, UNIT
from ..codegen import space
from ..codegen.coupling_law import numbers_of
from ..codegen.expression_graph import chosen
from ..codegen.space import cleared, snapped
from ..codegen.spatial import X, Y, Z
from ..effects.law import ON_SYMBOLS
from ..engine import types as t
from ..mechanism.coupling_law import law_value
from ..mechanism.couplings import in_tree, measured, relative
from ..mechanism.cut_freedoms import cut_freedoms
from ..mechanism.mechanism import (
    Coupling, CUT_WITH_ORIENTATION, DISTANCE, DrivingConstraint, GROUND, HELICAL, POINT_ON_LINE,
    POINT_ON_PLANE, REVOLUTE, SPHERICAL, UNIVERSAL)
from ..mechanism.rotations import of_quaternion


class CutRows:
    """
    Rows of the loop closures, one by one, in the order of elimination.

    Which joints couplings read is noted in ``tree``, in the plane. ``cut``, ``cut_point`` and
    ``path_body`` are as ``Model`` has them, but for the equations, which are neither chosen nor
    numbered.
    """

    def __init__(self, mechanism, decomposition, tree):
        self._mechanism, self._tree = mechanism, tree
        self._numbers = _PlanarNumbers if mechanism.planar else _SpatialNumbers
        self.cut = np.zeros((len(mechanism.closures), t.CUT_COLUMNS), dtype=np.int64)
        self._entries, points = [], []
        for one, index in zip(self.cut, decomposition.cut_order):
            one[t.CUT_NUMBER] = index
            points.append(self._fill(mechanism.closures[index], one))
        self.path_body = np.array(self._entries, dtype=np.int64)
        width = max([self._numbers.COLUMNS, *map(len, points)])
        # Motions, and what is coupled to a place or an angle, are given their right-hand sides.
        asked = mechanism.motions or any(measured(mechanism, one) for one in mechanism.couplings)
        self.cut_point = np.zeros((len(points), width + (t.MOTION_COLUMNS if asked else 0)))
        for row, values in zip(self.cut_point, points):
            row[:len(values)] = values

    def _fill(self, closure, one):
        """Fill in a row of ``cut``; return that of ``cut_point``."""
        mechanism = self._mechanism
        if isinstance(closure, Coupling):
            if not measured(mechanism, closure):
                one[t.CUT_TYPE] = t.CUT_COUPLING
                return self._couple(one, *in_tree(mechanism, closure), law=closure.law)
            cut, *coupled = relative(mechanism, closure)
            numbers = self._between(cut_freedoms(mechanism)[cut.name], one, t.COUPLED_PLACE)
            return np.concatenate([numbers, self._couple(
                one, *coupled, bodies=one[[t.BODY_A, t.BODY_B]].tolist())])
        if isinstance(closure, DrivingConstraint):
            if closure.freedom in mechanism.coordinates.index:
                one[t.CUT_TYPE] = t.PRESCRIBED_JOINT
                return self._couple(one, {closure.freedom: 1.0}, 0.0)
            if closure.freedom is not None:
                numbers = self._between(
                    cut_freedoms(mechanism)[closure.freedom], one, t.PRESCRIBED_PLACE)
            else:
                one[t.CUT_TYPE] = t.PRESCRIBED_PLACE
                point = mechanism.point(closure.point)
                numbers = self._numbers.of_point(
                    *self._placed(one, point.body, GROUND), point.position, closure.direction)
        else:
            one[t.CUT_TYPE] = space.CUT_TYPES.index(closure.type)
            numbers = self._numbers.of_joint(
                closure, *self._placed(one, closure.body_a, closure.body_b))
        self._pass_bodies(one)
        return numbers

    def _placed(self, one, body_a, body_b):
        """Store the rows of both bodies; return their placements."""
        a, b = self._tree.placements[body_a], self._tree.placements[body_b]
        one[[t.BODY_A, t.BODY_B]] = a.row, b.row
        return a, b

    def _between(self, freedom, one, place):
        """
        Store a prescribed or coupled freedom of a cut joint; return its numbers.

        ``place``: the type of a freedom that slides, before that of one that turns.
        """
        one[t.CUT_TYPE] = place if freedom.slides else place + 1
        return self._numbers.of_freedom(freedom, *self._placed(one, *freedom.bodies))

    def _couple(self, one, factors, offset, bodies=(), law=None):
        """
        Store the path of a coupling of joints' coordinates through the tree.

        Parameters
        ----------
        one : ndarray of int, shape (CUT_COLUMNS,)
            Its entries of ``path_body`` are written.
        factors : dict of str to float
            Of freedoms of the tree.
        offset : float
            What the sum of the coordinates times their factors is held at.
        bodies : sequence of int
            Rows of bodies that it acts on, too.
        law : CouplingLaw or None
            What is added to that sum.

        Returns
        -------
        ndarray
            The sum, the factor of each entry, and the numbers of the law.

        """
        tree, index = self._tree.tree, self._mechanism.coordinates.index
        row_of = {dof: row for row, dof in enumerate(tree[:, t.DOF].tolist()) if row}
        factors = {row_of[index[name]]: factor for name, factor in factors.items()}
        if law is not None:
            one[t.BODY_A] = row_of[index[law.joint]]
            bodies = one[[t.BODY_A]].tolist()
        if self._mechanism.planar:
            tree[[*factors, *(bodies if law is not None else ())], t.READ] = 1
        own = sorted({row for joint in (*factors, *bodies) for row in path(tree, joint)},
                     reverse=True)
        start, end = len(self._entries), len(self._entries) + len(own)
        one[[t.PATH_A, t.PATH_B, t.PATH_COMMON, t.PATH_END]] = start, end, end, end
        self._entries += own
        numbers = [] if law is None else numbers_of(
            lambda x: law_value(law, x, ON_SYMBOLS, chosen))
        return np.array([offset, *(factors.get(row, 0.0) for row in own), *numbers])

    def _pass_bodies(self, one):
        """Store the bodies on the path of a cut joint's forces."""
        path_a, path_b = (path(self._tree.tree, one[body]) for body in (t.BODY_A, t.BODY_B))
        shared = set(path_b)
        common = [row for row in path_a if row in shared]
        own_a = path_a[:len(path_a) - len(common)]
        own_b = path_b[:len(path_b) - len(common)]
        start, middle = len(self._entries), len(self._entries) + len(own_a)
        self._entries += own_a + own_b + common
        one[[t.PATH_A, t.PATH_B, t.PATH_COMMON, t.PATH_END]] = (
            start, middle, middle + len(own_b), len(self._entries))


def path(tree, row):
    """Return the rows from ``row`` inward, the ground left out."""
    found = []
    while row > 0:
        found.append(row)
        row = int(tree[row, t.PARENT])
    return found


class _PlanarNumbers:
    """The first columns of ``Model.cut_point``: both places, and an angle or a length."""

    COLUMNS = t.CUT_POINT_COLUMNS

    @staticmethod
    def of_joint(cut, a, b):
        """Return those of a cut joint, given the placements of its bodies."""
        return [*cut.point_a, *cut.point_b, cut.length if cut.type == DISTANCE else
                0.0 if cut.type == REVOLUTE else cut.angle]

    @staticmethod
    def of_freedom(freedom, a, b):
        """Return those of a freedom of a cut joint that is prescribed or coupled."""
        return [*freedom.cut.point_a, *freedom.cut.point_b, freedom.cut.angle]

    @staticmethod
    def of_point(a, b, position, direction):
        """Return those of a point of A that is moved along a direction of the ground."""
        return [*position, 0.0, 0.0, math.atan2(direction[1], direction[0])]


class _SpatialNumbers:
    """The same in space: both places, both frames, and a length or a lead."""

    COLUMNS = space.CUT_POINT_COLUMNS

    @staticmethod
    def of_joint(cut, a, b):
        """Return those of a cut joint, as in the plane."""
        frame_a, frame_b = _cut_frames(cut, a, b)
        return np.concatenate([
            cleared(a.place(cut.point_a)), cleared(b.place(cut.point_b)),
            frame_a.ravel(), frame_b.ravel(), [cut.length or cut.lead or 0.0]])

    @staticmethod
    def of_freedom(freedom, a, b):
        """
        Return those of a freedom of a cut joint that is prescribed or coupled.

        The frame on body B has the axis as its Z; of what turns, both frames agree at zero.
        """
        point_a, point_b = freedom.points
        if freedom.slides:
            frame_a, frame_b = UNIT, np.array(frame_along(freedom.axis))
            if freedom.cut.type == HELICAL:
                # The coordinate is the angle: the place over the lead.
                frame_b[:, Z] /= freedom.cut.lead
        else:
            axis, side, there = freedom.turn
            frame_a = np.column_stack([side, np.cross(axis, side), axis])
            frame_b = np.column_stack([there, np.cross(freedom.axis, there), freedom.axis])
        return np.concatenate([
            cleared(a.place(point_a)), cleared(b.place(point_b)),
            snapped(a.axes @ frame_a).ravel(), snapped(b.axes @ frame_b).ravel(), [0.0]])

    @staticmethod
    def of_point(a, b, position, direction):
        """Return those of a point of A that is moved along a direction of the ground."""
        return np.concatenate([
            cleared(a.place(position)), np.zeros(3), UNIT.ravel(),
            frame_along(np.array(direction)).ravel()])


def _cut_frames(joint, a, b):
    """Return the joint's axes in the frames of both rows."""
    if joint.type in CUT_WITH_ORIENTATION:
        own = UNIT if joint.axis_b is None else frame_along(np.array(joint.axis_b))
        held = of_quaternion(joint.orientation).T
        return snapped(a.axes @ held @ own), snapped(b.axes @ own)
    if joint.type in (SPHERICAL, DISTANCE):
        return UNIT, UNIT
    along_b = frame_along(b.axes @ joint.axis_b)
    if joint.type in (POINT_ON_LINE, POINT_ON_PLANE):
        return UNIT, along_b
    along_a = frame_along(a.axes @ joint.axis_a)
    if joint.type == UNIVERSAL:
        # The axis on body A is its X.
        along_a = along_a[:, [Z, X, Y]]
    return along_a, along_b
