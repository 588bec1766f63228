# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A planar mechanism as one in space: positions in the x-y plane, axes along z."""

import numpy as np

from . import coupling_law, rows, space
from .space import coupling, CUT_TYPES, prescribed
from .spatial import Body, Cut, X, Y, Z
from .vectors import IDENTITY, ZERO
from ..engine.types import (
    A_X, A_Y, ALPHA, ANGLE, ARMATURE, AX, AY, B_X, B_Y, COS, COUPLED_PLACE, CUT_ANGLE,
    CUT_COUPLING, CUT_DISTANCE, CUT_FIXED, CUT_LENGTH, CUT_POINT_COLUMNS, CUT_POINT_ON_LINE,
    CUT_PRISMATIC, CUT_REVOLUTE, CUT_TYPE, DX, DY, DZ, FACTORS, FX, FY, FZ, HX, HY, INERTIA, IZZ,
    JOINT_X, JOINT_Y, LENGTHS, MASS, MASS_X, MASS_Y, MOTION_COLUMNS, MXX, MXY, MYY, OMEGA, PATH_A,
    PRESCRIBED_JOINT, PRESCRIBED_PLACE, PRESCRIBED_TURN, PRISMATIC, PX, PY, REVOLUTE_ARMATURE,
    ROWS, RX, RY, SIN, SX, SY, TYPE, UX, UY, UZ, VARIES, VX, VY)

# Where the components of a wrench, of a motion and of an inertia are in Workspace.body, angular
# ones first: of the bias force, of U = IA S, of the acceleration, of the inertia.
FORCES = {2: FZ, 3: FX, 4: FY}
SHARES = {2: UZ, 3: UX, 4: UY}
CHANGES = {2: DZ, 3: DX, 4: DY}
INERTIAS = {(2, 2): IZZ, (2, 3): HX, (2, 4): HY, (3, 3): MXX, (3, 4): MXY, (4, 4): MYY}
# Constants that are often zero.
ZEROS, ZEROS_OF_CUTS = (MASS_X, MASS_Y, JOINT_X, JOINT_Y), (A_X, A_Y, B_X, B_Y)
# Where a body's motion is, as ``space.MOTION``.
MOTION = {'angle': (ALPHA,), 'frame': (COS, None, None, SIN), 'origin': (PX, PY),
          'offset': (RX, RY), 'spin': (None, None, OMEGA), 'velocity': (VX, VY),
          'acceleration': (AX, AY), 'axis': (None, None, None, SX, SY)}
# Where the factors of a coupling begin that has columns of its own before them.
_COUPLED = CUT_POINT_COLUMNS + FACTORS
# What the cut joints hold, as ``space.HELD``: axes of body B, and pairs of axes that stay
# perpendicular.
_TURNING = (Z, X), (Z, Y)
HELD = {kind: (CUT_TYPES[kind], *held) for kind, held in {
    CUT_REVOLUTE: ((X, Y, Z), _TURNING), CUT_PRISMATIC: ((Y, Z), (*_TURNING, (X, Y))),
    CUT_FIXED: ((X, Y, Z), (*_TURNING, (X, Y))), CUT_DISTANCE: ((), ()),
    CUT_POINT_ON_LINE: ((Y, Z), ()), CUT_COUPLING: ((), ()), PRESCRIBED_JOINT: ((), ()),
    PRESCRIBED_PLACE: ((X,), ()), PRESCRIBED_TURN: ((), ((X, Y),)),
    COUPLED_PLACE: ((X,), ())}.items()}


def set_masses(constant, mass, center, about):
    """
    Add a rigid mass [kg] to a row of ``Model.body``, in place.

    ``center``, shape (2,): its centre of mass in the body's frame [m]; ``about``: inertia about
    that [kg m^2].
    """
    x, y = center.tolist()
    for column, value in (
            (MASS, mass), (MASS_X, mass * x), (MASS_Y, mass * y),
            (INERTIA, about + mass * (x * x + y * y))):
        constant[column] += value


def possible(kind):
    """Return the bits of a cut type's equations that do not always hold in the plane."""
    _, along, perpendicular = HELD[kind]
    # Others have one equation of their own.
    open_ones = [axis != Z for axis in along] + [Z not in pair for pair in perpendicular] or [True]
    return sum(1 << n for n, one in enumerate(open_ones) if one)


def group_of(kind, number):
    """Return which equations of a cut type are of one kind, by number: of places 0, others 1."""
    return int(kind != CUT_DISTANCE and number >= len(HELD[kind][1]))


def number_equations(cut):
    """Fill in the numbers of the equations that the elimination works on; see ``space``."""
    space.number_rows(cut, [
        sum(1 << n for n in range(6) if group_of(kind, n) == 0)
        for kind in cut[:, CUT_TYPE].tolist()])
    # Where nothing is left of a cut joint it counts as one of places: it has no lever.
    cut[cut[:, ROWS] == 0, LENGTHS] = 1


def structure(model):
    """
    Return the structural data of code for a planar mechanism, beside its topology.

    Which places and first moments are zero, and which joints its couplings read.
    """
    zeros = zeros_of_bodies(model), _zeros_of_cuts(model)
    couplings = model.cut[:, CUT_TYPE] == CUT_COUPLING
    found = (*zeros, model.cut_point[couplings, FACTORS:] != 0.0,
             *coupling_law.structure(model)) if couplings.any() else zeros
    places = model.cut[:, CUT_TYPE] == COUPLED_PLACE
    return (*found, model.cut_point[places, _COUPLED:-MOTION_COLUMNS] != 0.0) if (
        places.any()) else found


def zeros_of_bodies(model):
    """Return which of ``ZEROS`` are zero and stay so, with the terms they multiply, by body."""
    found = model.body[:, ZEROS] == 0.0
    return found & ~space.varies(model)[:, ZEROS] if model.tree[:, VARIES].any() else found


def _zeros_of_cuts(model):
    """Return the same of ``ZEROS_OF_CUTS``, by cut joint."""
    kind = model.cut[:, [CUT_TYPE]]
    # Others have other numbers there.
    return (model.cut_point[:, ZEROS_OF_CUTS] == 0.0) & (kind != CUT_COUPLING) & (
        kind != PRESCRIBED_JOINT)


def _without(symbols, columns, zeros, groups):
    """Return symbols, 0 where all of a group of rows are: equal arms take equal operations."""
    symbols = symbols.copy()
    for alike in groups:
        symbols[np.ix_(alike, np.array(columns)[zeros[alike].all(axis=0)])] = 0.0
    return symbols


def without_zeros(model):
    """Return a model with the same structure but for these zeros: all of them are loads."""
    tree, cut_point = model.tree.copy(), model.cut_point.copy()
    tree[:, VARIES] = -1
    rows, columns = np.nonzero(_zeros_of_cuts(model))
    cut_point[rows, np.array(ZEROS_OF_CUTS)[columns]] = 1.0
    return model.replaced(tree=tree, cut_point=cut_point)


def bodies(model, symbols):
    """
    Describe the rows of a planar tree by symbols, shape (nb + 1, BODY_COLUMNS).

    Quantities without meaning in the plane, such as inertias about axes in it, are zero.
    """
    found = []
    symbols = _without(symbols, ZEROS, zeros_of_bodies(model), space.sisters(model))
    for row, kind in zip(symbols, model.tree[:, TYPE]):
        slides = float(kind == PRISMATIC)
        found.append(Body(
            turns=1.0 - slides, slides=slides, axis=X if slides else Z, ball=False,
            place=(row[JOINT_X], row[JOINT_Y], 0.0), turned=None, angle=row[ANGLE],
            mass=row[MASS], moment=(row[MASS_X], row[MASS_Y], 0.0),
            inertia=(ZERO, ZERO, (0.0, 0.0, row[INERTIA])),
            armature=None if kind not in (PRISMATIC, REVOLUTE_ARMATURE) else row[ARMATURE]))
    return found


def cuts(model, symbols):
    """Describe the cut joints of a planar mechanism by symbols, as of ``Model.cut_point``."""
    symbols = _without(symbols, ZEROS_OF_CUTS, _zeros_of_cuts(model), space.alike_cuts(
        model, list(space.sisters(model))))
    return [_coupling(model, one, values, row)
            if one[CUT_TYPE] in (CUT_COUPLING, PRESCRIBED_JOINT) else
            Cut(*HELD[one[CUT_TYPE]][1:], (row[A_X], row[A_Y], 0.0), (row[B_X], row[B_Y], 0.0),
                None, None, row[CUT_ANGLE], space.kept(one),
                length=row[CUT_LENGTH] if one[CUT_TYPE] == CUT_DISTANCE else None,
                coupling=_sum(model, one, values[CUT_POINT_COLUMNS:], row[CUT_POINT_COLUMNS:])
                if one[CUT_TYPE] == COUPLED_PLACE else None,
                motion=prescribed(one, row), between=one[CUT_TYPE] == COUPLED_PLACE)
            for one, values, row in zip(model.cut, model.cut_point, symbols)]


def _coupling(model, one, values, row):
    """Return a coupling of joints, or the prescribed motion of one."""
    if one[CUT_TYPE] == PRESCRIBED_JOINT:
        alone = 0.0, ((int(model.path_body[one[PATH_A]]), 1.0),)
        return Cut((), (), ZERO, ZERO, None, None, 0.0, space.kept(one), coupling=alone,
                   motion=prescribed(one, row))
    return Cut((), (), ZERO, ZERO, None, None, 0.0, space.kept(one),
               coupling=_sum(model, one, values, row), law=coupling_law.law_of(one, values, row))


def _sum(model, one, values, row):
    """Return ``Cut.coupling``, from numbers and symbols of the held value and the factors."""
    read = np.where(values[FACTORS:] == 0.0, 0.0, row[FACTORS:])
    return coupling(model, one, np.concatenate([row[:FACTORS], read]))


def motion_of(row, body, ground):
    """Return the kinematics in a row of ``Workspace.body``, as ``space.motion_of``."""
    cos, sin = row[COS], row[SIN]
    motion = rows.motion_of(row, MOTION, ground)
    return motion._replace(
        frame=((cos, 0.0 - sin, 0.0), (sin, cos, 0.0), IDENTITY[2]),
        axis=(0.0, 0.0, body.turns) + (ZERO if body.turns else motion.axis[3:]))
