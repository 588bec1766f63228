# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
From the description of a mechanism in space to the arrays that code is generated for.

A user's frames lie as drawings have them. The kernels' frames lie so that what turns does so about
Z, that successive parallel axes share it, and that as many constants as can be are
exactly 0: each of these saves operations.

"""

from typing import NamedTuple

import numpy as np

from .modeling import (
    asks, complete, couple, extent, filled, pass_bodies, relative)
from ..core import types as t
from ..core.codegen import space
from ..core.codegen.expression_graph import ExpressionGraph, LOAD
from ..core.codegen.space import cleared, snapped
from ..core.codegen.spatial import Recursion, X, Y, Z
from ..core.codegen.vectors import is_zero
from ..mechanism.couplings import measured
from ..mechanism.cut_freedoms import cut_freedoms
from ..mechanism.decomposition import decompose
from ..mechanism.mechanism import (
    Coupling, CUT_WITH_ORIENTATION, CYLINDRICAL, DISTANCE, DrivingConstraint, FIXED, FREE, GROUND,
    HELICAL, JOINT_FREEDOMS, MechanismError, PLANAR, POINT_ON_LINE, POINT_ON_PLANE, PRISMATIC,
    REVOLUTE, SPHERICAL, UNIVERSAL)
from ..mechanism.rotations import of_quaternion

# Of the size: errors of equations that no motion changes are rounding below this.
NEVER_CLOSED = 1e-9
_UNIT = np.eye(3)
# Rows of joints that move along or about the axes of their frame: type, axis.
_SLIDES = tuple((t.PRISMATIC, axis) for axis in (X, Y, Z))
_BALL = tuple((t.BALL, axis) for axis in (X, Y, Z))
_BY_FRAME = {SPHERICAL: _BALL, FREE: _SLIDES + _BALL,
             PLANAR: (*_SLIDES[:2], (t.REVOLUTE, Z))}
_ALONG_AXIS = {REVOLUTE: (t.REVOLUTE,), PRISMATIC: (t.PRISMATIC,), HELICAL: (t.HELICAL,),
               CYLINDRICAL: (t.REVOLUTE, t.PRISMATIC)}


class Placement(NamedTuple):
    """
    Where a user's frame is in the frame of a row.

    Attributes
    ----------
    row : int
        0 for the ground.
    axes : ndarray, shape (3, 3)
        Columns: the user's axes.
    origin : ndarray, shape (3,)
        [m].

    """

    row: int
    axes: np.ndarray
    origin: np.ndarray

    def place(self, point):
        """Return a point of the user's frame in that of the row."""
        return self.axes @ point + self.origin


class SpatialModel(NamedTuple):
    """
    Arrays of a mechanism in space, and where the user's frames are in them.

    Attributes
    ----------
    model : core.types.Model
    placements : dict of str to Placement
        By body, the ground among them.
    rows : dict of str to list of int
        Rows of the tree by joint.

    """

    model: t.Model
    placements: dict
    rows: dict


def build_spatial_model(mechanism, gravity=(0.0, 0.0, 0.0), decomposition=None, kept=None):
    """
    Build the constant arrays of a mechanism in space.

    Parameters
    ----------
    mechanism : Mechanism
        What is described; its vectors have three numbers.
    gravity : sequence of 3 floats
        [m/s^2].
    decomposition : Decomposition, optional
        Found here when not given.
    kept : sequence of bool, optional
        Which of the equations that do not always hold the elimination is to work on, in the order
        of the cut joints; all when not given.

    Returns
    -------
    SpatialModel

    Raises
    ------
    MechanismError
        Where a loop cannot close: a cut joint's equation that no motion changes is not met.

    """
    decomposition = decomposition or decompose(mechanism)
    builder = _Tree(mechanism)
    for index in decomposition.joint_order:
        builder.add(index)
    tree, body = builder.arrays(decomposition)
    cut, point, entries = _closures(mechanism, decomposition, tree, builder)
    for k, possible in enumerate(_possible(mechanism, tree, body, cut, point, entries)):
        cut[k, t.POSSIBLE] = sum(1 << n for n in possible)
    return SpatialModel(
        complete(tree, body, gravity, cut, point, entries, decomposition, space, kept),
        builder.placements, builder.rows)


class _Tree:
    """Rows of the tree, joint by joint."""

    def __init__(self, mechanism):
        self.mechanism = mechanism
        self.bodies = {body.name: body for body in mechanism.bodies}
        self.placements = {GROUND: Placement(0, _UNIT, np.zeros(3))}
        self.rows = {}
        self.tree, self.body = [(-1,) + 5 * (0,)], [np.zeros(space.BODY_COLUMNS)]
        freedoms = [JOINT_FREEDOMS[joint.type] for joint in mechanism.joints]
        balls = [joint.type in (SPHERICAL, FREE) for joint in mechanism.joints]
        self.first = np.cumsum([0] + freedoms)
        self.coordinate = self.first + np.cumsum([0] + balls)

    def add(self, index):
        """Add the rows of one joint, and the body that it carries."""
        joint = self.mechanism.joints[index]
        parent, body = self.placements[joint.parent], self.bodies[joint.child]
        axes = snapped(parent.axes @ of_quaternion(joint.orientation))
        place, row, rows = parent.place(joint.position), parent.row, []
        dof, coordinate = self.first[index], self.coordinate[index]
        for kind, axis, turned in self._freedoms(joint, axes):
            constant = np.zeros(space.BODY_COLUMNS)
            constant[space.PLACE:space.PLACE + 3] = cleared(place)
            constant[space.TURNED:space.TURNED + 9] = turned.ravel()
            # The frame of a ball begins again; what only slides does not turn.
            constant[space.PARALLEL] = np.array_equal(turned, _UNIT)
            if kind == t.HELICAL:
                constant[space.LEAD] = joint.lead
            self.tree.append((row, dof, kind, 0, coordinate, axis))
            self.body.append(constant)
            row, place, axes = len(self.tree) - 1, np.zeros(3), snapped(turned.T @ axes)
            rows.append(row)
            dof, coordinate = dof + 1, coordinate + (kind != t.BALL)
        for last in rows[-3:]:
            if self.tree[last][2] == t.BALL:
                self.tree[last] = (*self.tree[last][:4], coordinate, self.tree[last][5])
        self.rows[joint.name] = rows
        self.placements[joint.child] = Placement(row, axes, place)
        weigh(self.body[row], self.placements[joint.child], body)

    def _freedoms(self, joint, axes):
        """Yield (type, axis, frame in that of the row before) of each row of a joint."""
        if joint.type == FIXED:
            return
        if joint.type in _BY_FRAME:
            turned = axes
            for kind, axis in _BY_FRAME[joint.type]:
                yield kind, axis, turned
                turned = _UNIT
            return
        kinds = ((t.REVOLUTE, joint.axis), (t.REVOLUTE, joint.second_axis)) if (
            joint.type == UNIVERSAL) else [(kind, joint.axis) for kind in _ALONG_AXIS[joint.type]]
        for n, (kind, axis) in enumerate(kinds):
            hint = kinds[n + 1][1] if n + 1 < len(kinds) else self._direction(joint.child)
            turned = _frame(axes @ axis, axes @ hint)
            yield kind, Z, turned
            axes = turned.T @ axes

    def _direction(self, name):
        """Return a direction of a body that many of its constants lie along."""
        places = [self.bodies[name].center_of_mass, *(
            joint.position for joint in self.mechanism.joints if joint.parent == name)]
        return np.array(max(places, key=np.linalg.norm))

    def arrays(self, decomposition):
        """Return ``Model.tree`` and ``Model.body``."""
        tree = np.array(self.tree, dtype=np.int64)
        tree[0] = 0
        for number, joints in enumerate(decomposition.subsystems):
            for joint in joints:
                tree[self.rows[joint], t.SUBSYSTEM] = number
        return tree, np.array(self.body)


def weigh(constant, placement, body):
    """Add a body's mass, first moments and inertia to its row of ``Model.body``."""
    _, axes, origin = placement
    space.weigh(constant, body.mass, axes @ body.center_of_mass + origin,
                axes @ space.inertia_matrix(body.inertia) @ axes.T)


def _frame(axis, hint):
    """Return a frame with an axis as its Z, X towards a hint; the present one where that does."""
    axis = snapped(np.array(axis) / np.linalg.norm(axis))
    if np.array_equal(axis, _UNIT[Z]):
        return _UNIT
    across = hint - axis * (axis @ hint)
    if np.linalg.norm(across) <= 1e-9 * np.linalg.norm(hint):
        # Perpendicular to the axis and to the present axis that it is the least along.
        across = np.cross(_UNIT[np.argmin(np.abs(axis))], axis)
    across = snapped(across / np.linalg.norm(across))
    return snapped(np.column_stack([across, np.cross(axis, across), axis]))


def _closures(mechanism, decomposition, tree, builder):
    """Return ``Model.cut``, not yet numbered, ``Model.cut_point`` and ``Model.path_body``."""
    closures = [mechanism.closures[index] for index in decomposition.cut_order]
    cut = np.zeros((len(closures), t.CUT_COLUMNS), dtype=np.int64)
    entries, points = [], []
    for one, index, joint in zip(cut, decomposition.cut_order, closures):
        one[t.CUT_NUMBER] = index
        if isinstance(joint, DrivingConstraint):
            points.append(_prescribed(mechanism, joint, one, tree, builder, entries))
            continue
        if isinstance(joint, Coupling) and measured(mechanism, joint):
            cut_joint, factors, offset = relative(mechanism, joint)
            freedom = cut_freedoms(mechanism)[cut_joint.name]
            numbers = _between(freedom, one, builder)
            one[t.CUT_TYPE] = t.COUPLED_PLACE if freedom.slides else t.COUPLED_TURN
            points.append(np.concatenate([numbers, couple(one, tree, {
                builder.rows[name][0]: factor for name, factor in factors.items()
            }, offset, entries, one[[t.BODY_A, t.BODY_B]].tolist())]))
            continue
        if isinstance(joint, Coupling):
            one[t.CUT_TYPE] = space.COUPLING
            points.append(couple(one, tree, {
                builder.rows[name][0]: factor for name, factor in joint.joints.items()
            }, joint.offset, entries))
            continue
        a, b = builder.placements[joint.body_a], builder.placements[joint.body_b]
        frame_a, frame_b = _cut_frames(joint, a, b)
        one[[t.CUT_TYPE, t.BODY_A, t.BODY_B]] = (
            space.CUT_TYPES.index(joint.type), a.row, b.row)
        points.append(np.concatenate([
            cleared(a.place(joint.point_a)), cleared(b.place(joint.point_b)),
            frame_a.ravel(), frame_b.ravel(), [joint.length or joint.lead or 0.0]]))
        pass_bodies(one, tree, entries)
    return (cut, filled(points, space.CUT_POINT_COLUMNS, asks(mechanism)),
            np.array(entries, dtype=np.int64))


def _prescribed(mechanism, motion, one, tree, builder, entries):
    """Add the entries of a prescribed motion; return its row of ``Model.cut_point``."""
    if motion.freedom in mechanism.cut_coordinates.index:
        freedom = cut_freedoms(mechanism)[motion.freedom]
        numbers = _between(freedom, one, builder)
        one[t.CUT_TYPE] = t.PRESCRIBED_PLACE if freedom.slides else t.PRESCRIBED_TURN
        pass_bodies(one, tree, entries)
        return numbers
    if motion.freedom is not None:
        dof = mechanism.coordinates.index[motion.freedom]
        one[t.CUT_TYPE] = t.PRESCRIBED_JOINT
        return couple(one, tree, {int(np.flatnonzero(tree[1:, t.DOF] == dof)[0]) + 1: 1.0}, 0.0,
                      entries)
    point = mechanism.point(motion.point)
    placed = builder.placements[point.body]
    one[[t.CUT_TYPE, t.BODY_A]] = t.PRESCRIBED_PLACE, placed.row
    pass_bodies(one, tree, entries)
    return np.concatenate([
        cleared(placed.place(point.position)), np.zeros(3), _UNIT.ravel(),
        _frame(np.array(motion.direction), np.zeros(3)).ravel()])


def _between(freedom, one, builder):
    """
    Put the bodies of a freedom of a cut joint that is prescribed or coupled into its row.

    Returns the first columns of its row of ``Model.cut_point``: the frame on body B has the axis
    as its Z; of what turns, both frames agree at zero.

    """
    (a, b), (point_a, point_b) = (
        [builder.placements[body] for body in freedom.bodies], freedom.points)
    one[[t.BODY_A, t.BODY_B]] = a.row, b.row
    if freedom.slides:
        frame_a, frame_b = _UNIT, np.array(_frame(freedom.axis, np.zeros(3)))
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


def _cut_frames(joint, a, b):
    """Return the joint's axes in the frames of both rows."""
    if joint.type in CUT_WITH_ORIENTATION:
        own = _UNIT if joint.axis_b is None else _frame(np.array(joint.axis_b), np.zeros(3))
        held = of_quaternion(joint.orientation).T
        return snapped(a.axes @ held @ own), snapped(b.axes @ own)
    if joint.type in (SPHERICAL, DISTANCE):
        return _UNIT, _UNIT
    along_b = _frame(b.axes @ joint.axis_b, np.zeros(3))
    if joint.type in (POINT_ON_LINE, POINT_ON_PLANE):
        return _UNIT, along_b
    along_a = _frame(a.axes @ joint.axis_a, np.zeros(3))
    if joint.type == UNIVERSAL:
        # The axis on body A is its X.
        along_a = along_a[:, [Z, X, Y]]
    return along_a, along_b


_always_held = {}


def _outward(model, bodies, cuts, q, qd):
    """Return the recursion at coordinates and rates, symbols or numbers."""
    recursion = Recursion(space.bodies(model, bodies), space.cuts(model, cuts), (0.0, 0.0, 0.0))
    recursion.outward(model, q, qd, None)
    return recursion


def _is_held(model):
    """Return for each equation of each cut joint whether no motion changes it."""
    nv, nq = len(model.tree) - 1, t.number_of_coordinates(model)
    graph = ExpressionGraph()

    def symbols(source, shape):
        found = np.empty(shape, dtype=object)
        found.flat = [graph.put(LOAD, source, place) for place in range(found.size)]
        return found

    symbolic = _outward(model, symbols(0, model.body.shape), symbols(1, model.cut_point.shape),
                        symbols(2, (nq,)), symbols(3, (nv,)))
    return [[isinstance(equation.value, float) or is_zero((equation.rate,))
             for equation in symbolic.equations(model, a)] for a in range(len(model.cut))]


def _possible(mechanism, tree, body, cut, point, entries):
    """Return the numbers of each cut joint's equations that do not hold anyway."""
    model = t.Model(
        tree, body, np.zeros(3), cut.copy(), point, entries, *(6 * (None,)), None)
    # Lengths and masses may differ: the symbols stand for any.
    shape = tuple((array.shape, array.tobytes())
                  for array in (*space.structure(model), tree, model.cut, entries))
    if shape not in _always_held:
        _always_held[shape] = _is_held(model)
    held, somewhere = _always_held[shape], None
    size = extent(mechanism)
    for a, one in enumerate(model.cut):
        # Bodies that are fixed to one another are one row of the tree.
        joined = one[t.CUT_TYPE] not in (t.CUT_COUPLING, t.PRESCRIBED_JOINT) and (
            one[t.BODY_A] == one[t.BODY_B])
        fixed = [joined or always for always in held[a]]
        if any(fixed) and somewhere is None:
            somewhere = _outward(
                model, body.astype(object), point.astype(object),
                mechanism.coordinates.start().tolist(), [0.0] * (len(tree) - 1))
        for always, equation in zip(fixed, somewhere.equations(model, a) if any(fixed) else ()):
            if always and not abs(equation.value) <= NEVER_CLOSED * size:
                name = mechanism.closures[one[t.CUT_NUMBER]].name
                raise MechanismError(
                    f'cut_joints.{name}: expected axes and points that the joints of the tree '
                    'can bring together, got an equation that no motion changes and that is not '
                    f'met: {equation.value:.3g} instead of 0')
        yield [n for n, always in enumerate(fixed) if not always]
