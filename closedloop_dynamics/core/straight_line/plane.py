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

"""A planar mechanism as one in space: positions in the x-y plane, axes along z."""

from .spatial import Body, Cut, X, Y, Z
from .vectors import IDENTITY, skew, transpose, ZERO
from ..types import (
    A_X, A_Y, ALPHA, ANGLE, ARMATURE, AX, AY, B_X, B_Y, COS, CUT_ANGLE, CUT_FIXED, CUT_PRISMATIC,
    CUT_REVOLUTE, CUT_TYPE, FX, FY, FZ, HX, HY, INERTIA, IZZ, JOINT_X, JOINT_Y, MASS, MASS_X,
    MASS_Y, MXX, MXY, MYY, OMEGA, PRISMATIC, PX, PY, REVOLUTE_ARMATURE, RX, RY, SIN, SX, SY, TYPE,
    VX, VY)

# What the cut joints hold: axes of body B, and pairs of axes that stay perpendicular.
_TURNING = (Z, X), (Z, Y)
_HELD = {CUT_REVOLUTE: ((X, Y, Z), _TURNING), CUT_PRISMATIC: ((Y, Z), (*_TURNING, (X, Y))),
         CUT_FIXED: ((X, Y, Z), (*_TURNING, (X, Y)))}


def bodies(model, symbols):
    """
    Describe the rows of a planar tree.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    symbols : ndarray, shape (nb + 1, BODY_COLUMNS)
        Of the inputs, as ``Model.body``.

    Returns
    -------
    list of Body
        What the plane leaves open, such as inertias about axes in it, is zero.

    """
    found = []
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
    """
    Describe the cut joints of a planar mechanism.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    symbols : ndarray, shape (number of cuts, 5)
        Of the inputs, as ``Model.cut_point``.

    Returns
    -------
    list of Cut

    """
    return [Cut(*_HELD[one[CUT_TYPE]], (row[A_X], row[A_Y], 0.0), (row[B_X], row[B_Y], 0.0),
                None, None, row[CUT_ANGLE], None)
            for one, row in zip(model.cut, symbols)]


def write(recursion, body):
    """
    Write the motion, inertias and forces into the columns of ``Workspace.body``.

    Parameters
    ----------
    recursion : Recursion
        After ``outward``.
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        Columns ALPHA to FY, SX and SY are written.

    """
    for i, motion in enumerate(recursion.motion):
        row = body[i]
        row[ALPHA], row[COS], row[SIN] = motion.angle, motion.frame[0][0], motion.frame[1][0]
        for columns, vector in (((PX, PY), motion.origin), ((RX, RY), motion.offset),
                                ((VX, VY), motion.velocity), ((AX, AY), motion.acceleration),
                                ((SX, SY), motion.axis[3:])):
            row[list(columns)] = vector[:2]
        row[OMEGA] = motion.spin[2]
        if i > 0:
            inertia, force = recursion.inertia[i], recursion.force[i]
            row[[IZZ, HX, HY]] = inertia[2][2:5]
            row[[MXX, MXY, MYY]] = inertia[3][3], inertia[3][4], inertia[4][4]
            row[[FZ, FX, FY]] = force[2:5]


def read(recursion, body):
    """
    Take the motion, inertias and forces from these columns, as effects have left them.

    Parameters
    ----------
    recursion : Recursion
        Continues after ``outward``.
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        Of symbols.

    """
    ground = recursion.ground
    recursion.ground = ground._replace(acceleration=(*body[0, [AX, AY]], 0.0))
    recursion.motion, recursion.inertia, recursion.force = [recursion.ground], [None], [None]
    for row, one in zip(body[1:], recursion.bodies[1:]):
        cos, sin = row[COS], row[SIN]
        motion = ground._replace(
            angle=row[ALPHA], frame=((cos, 0.0 - sin, 0.0), (sin, cos, 0.0), IDENTITY[2]),
            origin=(*row[[PX, PY]], 0.0), offset=(*row[[RX, RY]], 0.0),
            spin=(0.0, 0.0, row[OMEGA]), velocity=(*row[[VX, VY]], 0.0),
            acceleration=(*row[[AX, AY]], 0.0),
            axis=(0.0, 0.0, one.turns) + ((0.0,) * 3 if one.turns else (*row[[SX, SY]], 0.0)))
        coupling = skew((row[HY], 0.0 - row[HX], 0.0))
        mass = ((row[MXX], row[MXY], 0.0), (row[MXY], row[MYY], 0.0), (0.0, 0.0, row[MXX]))
        about = (ZERO, ZERO, (0.0, 0.0, row[IZZ]))
        recursion.motion.append(motion)
        recursion.inertia.append(
            tuple(a + b for a, b in zip(about, coupling))
            + tuple(a + b for a, b in zip(transpose(coupling), mass)))
        recursion.force.append((0.0, 0.0, row[FZ], row[FX], row[FY], 0.0))
