# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The arrays of a mechanism in space.

Frames are chosen so that what turns does so about its Z axis. Numbers that are exactly 0, and of
rotations 0, 1 and -1, belong to the structure that code is generated for, like the topology: with
them go the terms that they multiply.
"""

import numpy as np

from . import coupling_law, rows
from .spatial import Body, Cut, X, Y, Z
from .vectors import IDENTITY, is_zero, ZERO
from ..engine.types import (
    AXIS, BALL, BODY_A, BODY_B, COUPLED_PLACE, COUPLED_TURN, CUT_NUMBER, CUT_ROW, CUT_TYPE,
    FACTORS, HELD_SUM, HELICAL, KEPT, LENGTHS, MOTION_COLUMNS, PARENT, PATH_A, PATH_COMMON,
    PATH_END, PRESCRIBED_JOINT, PRESCRIBED_PLACE, PRESCRIBED_TURN, PRISMATIC, REVOLUTE, ROW, ROWS,
    TYPE, VARIES)

# Columns of Model.body, one row a body: mass; first moments; moments of inertia about the body's
# origin, xx, yy, zz, xy, xz, yz; the joint's place in the parent's frame; its axes there, row by
# row; whether it shares the parent's Z axis; rotor inertia as seen at the joint; lead of a screw
# [m/rad]; angular momentum of rotors on the parent, in its frame, for a unit of the joint's rate.
MASS, MOMENT, INERTIA, PLACE, TURNED, PARALLEL, ARMATURE, LEAD, ROTOR = (
    0, 1, 4, 10, 13, 22, 23, 24, 25)
BODY_COLUMNS = 28
# Columns of Model.cut_point, one row a cut joint: its place and its axes in both bodies' frames,
# the length of a rod [m] or the lead of a thread [m/rad].
POINT_A, POINT_B, TURNED_A, TURNED_B, LENGTH = 0, 3, 6, 15, 24
CUT_POINT_COLUMNS = 25
# Columns of Workspace.body, one row a body, after those that the plane has, too: origin, axes row
# by row, angular velocity, velocity of the origin; the force that the body's acceleration takes,
# moment first; from the parent's origin; what q, qd and gravity leave of the accelerations; the
# joint's axis; its inertia, U = IA S and the acceleration beyond; the joint's coordinate and rate.
ORIGIN, FRAME, SPIN, VELOCITY, FORCE, OFFSET, SPIN_RATE, ACCELERATION, JOINT_AXIS = (
    3, 6, 15, 18, 21, 27, 30, 33, 36)
WORK_INERTIA, SHARE, CHANGE, JOINT_POSITION, JOINT_RATE = 42, 63, 69, 75, 76
# Angular momentum of rotors on the parent, and what turning with that takes in the joint.
WORK_ROTOR, ROTOR_BIAS, WORK_COLUMNS = 77, 80, 81
# Where the components of a wrench, of a motion and of an inertia are, as in ``plane``.
FORCES, SHARES, CHANGES = (
    {n: first + n for n in range(6)} for first in (FORCE, SHARE, CHANGE))
# Where the components of each part of a body's motion are, None where one is not kept.
MOTION = {part: tuple(range(first, first + size)) for part, first, size in (
    ('origin', ORIGIN, 3), ('frame', FRAME, 9), ('spin', SPIN, 3), ('velocity', VELOCITY, 3),
    ('offset', OFFSET, 3), ('spin_rate', SPIN_RATE, 3), ('acceleration', ACCELERATION, 3),
    ('axis', JOINT_AXIS, 6))}
INERTIAS = {pair: WORK_INERTIA + n for n, pair in enumerate(
    (m, n) for m in range(6) for n in range(m, 6))}

# Cut joints by CUT_TYPE, after the planar ones: along which axes of body B they hold, and which
# axes of A and B stay perpendicular. Joints that turn do so about Z of B; a universal joint's
# second axis is X of A.
_POINT, _TURNING = (X, Y, Z), ((Z, X), (Z, Y))
HELD = (
    ('revolute', _POINT, _TURNING),
    ('prismatic', (X, Y), (*_TURNING, (X, Y))),
    ('fixed', _POINT, (*_TURNING, (X, Y))),
    ('cylindrical', (X, Y), _TURNING),
    ('universal', _POINT, ((X, Z),)),
    ('spherical', _POINT, ()),
    ('planar', (Z,), _TURNING),
    ('helical', (X, Y), _TURNING),
    ('distance', (), ()),
    ('point_on_line', (X, Y), ()),
    ('point_on_plane', (Z,), ()),
    ('coupling', (), ()),
    ('prescribed_joint', (), ()),
    ('prescribed_place', (Z,), ()),
    ('prescribed_turn', (), ()),
    ('coupled_place', (Z,), ()),
    ('coupled_turn', (), ()),
)
CUT_TYPES = tuple(name for name, _, _ in HELD)
HELICAL_CUT, DISTANCE, COUPLING = map(CUT_TYPES.index, ('helical', 'distance', 'coupling'))


# Numbers this small beside the largest of their kind are rounding.
ROUNDING = 1e-14


def cleared(values):
    """Return numbers, zero where they are next to nothing beside the largest."""
    return np.where(np.abs(values) < ROUNDING * np.abs(values).max(), 0.0, values)


def vary(model, row, columns):
    """
    Make constants of a body loads, so that they may change at runtime and be zero now.

    ``row`` of the body, ``columns`` of ``Model.body``.
    """
    for column in columns:
        model.tree[row, VARIES] |= 1 << int(column)


# Rows and columns of the moments of inertia, as ``INERTIA`` has them.
_MOMENTS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)


def _cleared(values):
    """Return a list as ``cleared`` returns an array."""
    least = ROUNDING * max(map(abs, values))
    return [value if abs(value) >= least else 0.0 for value in values]


def snapped(values):
    """Return directions with components that are nearly 0, 1 or -1 made exactly so."""
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < ROUNDING, nearest, values) + 0.0


def set_masses(constant, mass, center, about):
    """
    Add a rigid mass [kg] to a row of ``Model.body``, in place.

    ``center``, shape (3,): its centre of mass in the row's frame [m]; ``about``, shape (3, 3):
    inertia about that, in the axes of the row's frame [kg m^2].
    """
    # Numbers rather than arrays: of so few they are faster.
    place, square = center.tolist(), float(center @ center)
    found = _cleared([
        own + mass * (square * (m == n) - place[m] * place[n])
        for own, m, n in zip(_cleared(about[_MOMENTS].tolist()), *_MOMENTS)])
    for m, n in ((0, 1), (0, 2), (1, 2)):
        # Principal moments that differ by rounding are equal.
        if abs(found[m] - found[n]) < ROUNDING * found[m]:
            found[n] = found[m]
    constant[MASS] += mass
    constant[MOMENT:MOMENT + 3] += _cleared([mass * part for part in place])
    constant[INERTIA:INERTIA + 6] += found


_TURNS = {(Z, X): 'turning about y', (Z, Y): 'turning about x', (X, Y): 'turning about z',
          (X, Z): 'angle of the axes'}


def equation_names(kind, held):
    """
    Name the equations of a cut type.

    x, y and z are the world's; its own where it slides or ``is_carried``.

    ``held``: components that cut joints hold, by type: ``HELD``, here or of ``plane``.
    """
    name, along, perpendicular = held[kind]
    return [*(f'place along {"xyz"[axis]}' for axis in along),
            *(_TURNS[pair] for pair in perpendicular),
            *{'helical': ['thread'], 'distance': ['distance'], 'coupling': ['sum'],
              'prescribed_joint': ['motion'], 'prescribed_turn': ['motion'],
              'coupled_turn': ['sum']}.get(name, [])]


def group_of(kind, number):
    """Return which kind of equations of a cut type one is: of places, of angles, another one."""
    _, along, perpendicular = HELD[kind]
    return (number >= len(along)) + (number >= len(along) + len(perpendicular))


def is_spatial(model):
    return len(model.gravity) == 3


def structure(model):
    """Return the structural data of code for a mechanism in space, beside its topology."""
    return (body_structure(model), _cut_structure(model), _rolling(model),
            *coupling_law.structure(model))


def _rolling(model):
    """
    Return the rows of spherical joints that turn the places of cut joints on their bodies least.

    Shape (number of cuts, 2), of both bodies of each; 0 where one is on no spherical joint.
    """
    found = np.zeros((len(model.cut), 2), dtype=int)
    for n, (body, place) in enumerate(((BODY_A, POINT_A), (BODY_B, POINT_B))):
        rows = model.cut[:, body]
        ball = model.tree[rows, TYPE] == BALL
        axis = np.abs(model.cut_point[:, place:place + 3]).argmax(axis=1)
        found[ball, n] = (rows - Z + axis)[ball]
    return found


def _cut_structure(model):
    """Return the structural numbers of cut joints."""
    found = _structure(model.cut_point, slice(TURNED_A, LENGTH))
    kind = model.cut[:, CUT_TYPE]
    couplings = (kind == COUPLING) | (kind == PRESCRIBED_JOINT)
    found[couplings] = _structure(model.cut_point[couplings], slice(None))
    # A sum may be zero now and another one later; so may a prescribed value.
    found[kind == COUPLING, HELD_SUM] = np.nan
    found[kind >= PRESCRIBED_JOINT, -MOTION_COLUMNS:] = np.nan
    coupled = kind >= COUPLED_PLACE
    if coupled.any():
        found[coupled, CUT_POINT_COLUMNS + HELD_SUM] = np.nan
    return found


def alike_cuts(model, rows):
    """Yield rows of cut joints of one type between ``rows`` of one kind, for alike operations."""
    kinds, cut = np.zeros(len(model.tree), dtype=int), model.cut
    for some in rows:
        kinds[some] = some[0]
    shapes = np.column_stack([cut[:, [CUT_TYPE, KEPT]], kinds[cut[:, [BODY_A, BODY_B]]]])
    for shape in np.unique(shapes, axis=0):
        yield np.flatnonzero((shapes == shape).all(axis=1))


def _structure(values, rotations):
    """Return the structural numbers of an array; NaN where there is none."""
    fixed = values == 0.0
    fixed[:, rotations] |= np.abs(values[:, rotations]) == 1.0
    return np.where(fixed, values, np.nan)


def body_structure(model):
    """Return the structural numbers of bodies, and which of their moments of inertia agree."""
    body = model.body
    found = _structure(body, slice(TURNED, PARALLEL))
    found[:, PARALLEL] = body[:, PARALLEL]
    varying = varies(model)
    found[varying] = np.nan
    # Where nothing has mass a joint's pivot is zero, and is to be divided by like any other:
    # refinement takes it from there.
    bare = body[:, MASS] == 0.0
    for row, parent in reversed(list(enumerate(model.tree[:, PARENT]))[1:]):
        bare[parent] &= bare[row]
    if bare.any():
        found[np.ix_(bare, (MASS, INERTIA, INERTIA + 1, INERTIA + 2))] = np.nan
    return np.column_stack([found, *_equal_moments(body, varying)])


def kinds_of_bodies(model):
    """Return the inputs of ``body_structure`` that change with masses and rotors."""
    body, about = model.body, model.body[:, INERTIA:INERTIA + 3]
    if model.tree[:, VARIES].any():
        varying = varies(model)
        return (body == 0.0) & ~varying, body[:, TURNED:PARALLEL], *_equal_moments(body, varying)
    # As above, for the samples of a rollout.
    return body == 0.0, body[:, TURNED:PARALLEL], about == about[:, (1, 2, 0)]


def varies(model):
    """Return which constants of bodies may change while code runs."""
    return (model.tree[:, VARIES, np.newaxis] >> np.arange(model.body.shape[1]) & 1).astype(bool)


def _equal_moments(body, varying):
    """Return which of the moments of inertia of bodies agree, and stay so."""
    return [(body[:, INERTIA + m] == body[:, INERTIA + n]) & ~varying[:, INERTIA]
            for m, n in ((0, 1), (0, 2), (1, 2))]


def sisters(model):
    """Yield rows of the tree of one kind behind ones of one kind: their operations are alike."""
    kinds, rows = [0], {}
    for row, one in list(enumerate(model.tree))[1:]:
        key = kinds[one[PARENT]], *one[[TYPE, AXIS]], is_spatial(model) and model.body[
            row, PARALLEL]
        kinds.append(row)
        rows.setdefault(key, []).append(row)
        kinds[row] = rows[key][0]
    yield from rows.values()


def _known(structural, symbols):
    """Return symbols, and numbers where they are structural."""
    return np.where(np.isnan(structural), symbols, structural.astype(object))


def bodies(model, symbols, arms=False):
    """
    Describe the rows of a tree in space by symbols, shape (nb + 1, BODY_COLUMNS).

    ``arms``: whether equal arms are to take equal operations, with numbers where one has zeros.
    """
    pattern = body_structure(model)
    for alike in sisters(model) if arms else ():
        rows = pattern[alike]
        pattern[alike] = np.where((rows == rows[0]).all(axis=0), rows, np.nan)
        pattern[alike, BODY_COLUMNS:] = rows[:, BODY_COLUMNS:].all(axis=0)
    found = []
    for kind, axis, fixed, row in zip(model.tree[:, TYPE], model.tree[:, AXIS], pattern, symbols):
        row = _known(fixed[:BODY_COLUMNS], row)
        xx, yy, zz, xy, xz, yz = row[INERTIA:INERTIA + 6]
        # One symbol for numbers that are equal.
        same_xy, same_xz, same_yz = fixed[BODY_COLUMNS:]
        yy = xx if same_xy else yy
        zz = xx if same_xz else yy if same_yz else zz
        found.append(Body(
            turns=float(kind != PRISMATIC),
            slides=1.0 if kind == PRISMATIC else row[LEAD] if kind == HELICAL else 0.0,
            axis=int(axis), ball=kind == BALL, place=tuple(row[PLACE:PLACE + 3]),
            turned=None if row[PARALLEL] else _matrix(row[TURNED:]), angle=0.0,
            mass=row[MASS], moment=tuple(row[MOMENT:MOMENT + 3]),
            inertia=((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)),
            armature=None if is_zero((row[ARMATURE],)) else row[ARMATURE],
            rotor=tuple(row[ROTOR:ROTOR + 3])))
    return found


def hinges(model, some, cuts):
    """
    Return rows of three hinges through one place, without mass in between.

    ``some`` and ``cuts`` are as ``bodies`` and ``cuts`` return them: no loop is closed on a body
    in between, no equation holds one of the three.
    """
    parents = model.tree[:, PARENT].tolist()
    held = set(model.cut[:, [BODY_A, BODY_B]].ravel().tolist())
    alone = {row for cut in cuts if cut.coupling is not None for row, _ in (
        *cut.coupling[1], *([] if cut.law is None else [cut.law]))}

    def plain(i):
        body = some[i]
        return (i not in alone and model.tree[i, TYPE] == REVOLUTE and body.armature is None
                and is_zero(body.rotor))

    def between(i):
        body = some[i]
        return (i > 0 and plain(i) and parents.count(i) == 1 and i not in held
                and is_zero((body.mass, *body.moment, *sum(body.inertia, ()))))

    found, taken = [], set()
    for last in range(len(some) - 1, 0, -1):
        second = parents[last]
        first = parents[second]
        rows = first, second, last
        if (between(first) and between(second) and plain(last) and taken.isdisjoint(rows)
                and is_zero((*some[second].place, *some[last].place))
                and some[second].turned is not None and some[last].turned is not None):
            found.append(rows)
            taken.update(rows)
    return found


def cuts(model, symbols):
    """Describe the cut joints of a mechanism in space by symbols, as of ``Model.cut_point``."""
    pattern, found = _cut_structure(model), []
    for alike in alike_cuts(model, list(sisters(model))):
        points = pattern[alike, :TURNED_A]
        pattern[alike, :TURNED_A] = np.where(np.isnan(points).any(axis=0), np.nan, points)
    for cut, values, fixed, row, rolling in zip(
            model.cut, model.cut_point, pattern, symbols, _rolling(model).tolist()):
        row = _known(fixed, row)
        _, along, perpendicular = HELD[cut[CUT_TYPE]]
        found.append(Cut(
            along, perpendicular, tuple(row[POINT_A:POINT_A + 3]),
            tuple(row[POINT_B:POINT_B + 3]), _matrix(row[TURNED_A:]), _matrix(row[TURNED_B:]),
            0.0, kept(cut),
            length=row[LENGTH] if cut[CUT_TYPE] == DISTANCE else None,
            lead=row[LENGTH] if cut[CUT_TYPE] == HELICAL_CUT else None,
            coupling=coupling(model, cut, row) if cut[CUT_TYPE] in (COUPLING, PRESCRIBED_JOINT)
            else coupling(model, cut, row[CUT_POINT_COLUMNS:])
            if cut[CUT_TYPE] >= COUPLED_PLACE else None,
            law=coupling_law.law_of(cut, values, row),
            motion=prescribed(cut, row), between=cut[CUT_TYPE] >= PRESCRIBED_PLACE,
            turns=cut[CUT_TYPE] in (PRESCRIBED_TURN, COUPLED_TURN),
            carried=is_carried(model, cut), rolling=tuple(filter(None, rolling))))
    return found


def is_carried(model, cut):
    """
    Return whether a cut joint, a row of ``Model.cut``, holds places along axes of body B.

    Joints with an axis do, in loops that a moving body carries: what holds there anyway, such as
    the places across a planar loop, or repeats another loop does so along axes that move with it.
    Where all axes are parallel the world's serve.
    """
    _, along, perpendicular = HELD[cut[CUT_TYPE]]
    return bool(
        len(along) == 3 and len(perpendicular) > 1 and cut[PATH_COMMON] < cut[PATH_END]
        and not (model.body[1:, PARALLEL].all() and (model.tree[1:, TYPE] != BALL).all()))


def kept(cut):
    """Return ``Cut.kept`` of a row of ``Model.cut``."""
    return tuple(n for n in range(6) if cut[KEPT] >> n & 1)


def prescribed(cut, row):
    """Return ``Cut.motion``; as for ``coupling``."""
    return tuple(row[-MOTION_COLUMNS:]) if cut[CUT_TYPE] >= PRESCRIBED_JOINT else None


def coupling(model, cut, row):
    """
    Return ``Cut.coupling`` of a row of ``Model.cut``.

    ``row`` is that of ``Model.cut_point``: symbols, and the number 0 for factors that there are
    not.
    """
    entries = model.path_body[cut[PATH_A]:cut[PATH_END]].tolist()
    return row[HELD_SUM], tuple(
        (i, factor) for i, factor in zip(entries, row[FACTORS:]) if not is_zero((factor,)))


def _matrix(row):
    """Return the first nine numbers of a row as a matrix."""
    return tuple(tuple(row[first:first + 3]) for first in (0, 3, 6))


def motion_of(row, body, ground):
    """Return the kinematics in a row of symbols of ``Workspace.body``."""
    motion = rows.motion_of(row, MOTION, ground)
    return motion._replace(base=motion.frame, axis=_axis(body, motion.axis))


def with_written(motion, row):
    """Return kinematics with the parts that routines write into a row of ``Workspace.body``."""
    origin, spin, velocity = (
        tuple(row[first:first + 3]) for first in (ORIGIN, SPIN, VELOCITY))
    return motion._replace(frame=_matrix(row[FRAME:]), origin=origin, spin=spin, velocity=velocity)


def _axis(body, symbols):
    """Return the axis of a joint, zeros where a kind of joint has them."""
    turn, slide = (symbols[first:first + 3] if not is_zero((rate,)) else ZERO
                   for first, rate in ((0, body.turns), (3, body.slides)))
    return IDENTITY[body.axis] + ZERO if body.ball else (*turn, *slide)


def number_equations(cut):
    """
    Fill in the numbers of the equations that the elimination works on.

    Parameters
    ----------
    cut : ndarray of int, shape (number of cuts, CUT_COLUMNS)
        Of ``Model``; CUT_TYPE, CUT_NUMBER and KEPT are read, ROWS, LENGTHS, CUT_ROW and ROW
        written.

    """
    number_rows(cut, [(1 << len(HELD[kind][1])) - 1 for kind in cut[:, CUT_TYPE]])
    cut[:, LENGTHS] = np.maximum(1, cut[:, LENGTHS])


def number_rows(cut, lengths):
    """
    Fill in the numbers of the equations that are kept, given which of these hold places.

    Parameters
    ----------
    cut : ndarray of int, shape (number of cuts, CUT_COLUMNS)
        As for ``number_equations``.
    lengths : sequence of int
        Of each cut joint, the bits of its equations that hold places.

    """
    cut[:, ROWS] = [bin(kept).count('1') for kept in cut[:, KEPT].tolist()]
    cut[:, LENGTHS] = [bin(kept & bits).count('1')
                       for kept, bits in zip(cut[:, KEPT].tolist(), lengths)]
    by_user = np.zeros(len(cut) + 1, dtype=np.int64)
    by_user[cut[:, CUT_NUMBER] + 1] = cut[:, ROWS]
    cut[:, CUT_ROW] = np.cumsum(by_user)[cut[:, CUT_NUMBER]]
    cut[:, ROW] = np.cumsum([0, *cut[:, ROWS]])[:-1]
