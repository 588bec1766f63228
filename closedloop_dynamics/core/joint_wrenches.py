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

"""
The wrenches in all joints, those of the trees and those that close the loops.

A wrench is ordered (moment, force x, force y), in world axes. In a cut joint it is what body B
exerts on body A, at the cut point of A. In a joint of a tree it is what the parent exerts on the
child, at the child's origin: the reaction, and along the joint's own freedom what its drive,
springs, dampers and friction hand over.

"""

import math

from .compiled import compiled, inlined
from .types import (
    A_X, A_Y, ALPHA, BODY_A, BODY_B, COS, CUT_ANGLE, CUT_FIXED, CUT_NUMBER, CUT_PRISMATIC,
    CUT_ROW, CUT_TYPE, DOF, FX, FY, FZ, INERTIA, MASS, MASS_X, MASS_Y, PARENT, PRISMATIC, PX, PY,
    RX, RY, SIN, SX, SY, TYPE)

# Columns of the recursion: a body's bias force, then the wrench in its joint; its acceleration
# beyond the velocity-product one.
MOMENT, FORCE_X, FORCE_Y, TURN, ALONG_X, ALONG_Y = range(6)
COLUMNS = 6


@inlined
def _cut_wrench(cut, cut_point, body, a, lam):
    """Return moment and force at one cut joint, of its multipliers."""
    kind, first = cut[a, CUT_TYPE], cut[a, CUT_ROW]
    if kind == CUT_PRISMATIC:
        angle = body[cut[a, BODY_B], ALPHA] + cut_point[a, CUT_ANGLE]
        return lam[first + 1], -math.sin(angle) * lam[first], math.cos(angle) * lam[first]
    return lam[first + 2] if kind == CUT_FIXED else 0.0, lam[first], lam[first + 1]


@compiled
def cut_wrenches(cut, cut_point, body, lam, out):
    """
    Compute the wrenches at the cut joints.

    Parameters
    ----------
    cut, cut_point : ndarray
        Of the ``Model``. The arrays alone: from Python, unpacking whole records takes longer.
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After an evaluation; only poses are read.
    lam : ndarray, shape (nc,)
        Multipliers.
    out : ndarray, shape (number of cuts, 3)
        Written in place, in the user's order [N m, N].

    """
    for a in range(out.shape[0]):
        moment, fx, fy = _cut_wrench(cut, cut_point, body, a, lam)
        k = cut[a, CUT_NUMBER]
        out[k, 0] = moment
        out[k, 1] = fx
        out[k, 2] = fy


@compiled
def bias_forces(body, out):
    """
    Keep the bodies' bias forces, which an evaluation overwrites.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``, and after the effects that act on points.
    out : ndarray, shape (nb + 1, COLUMNS)
        MOMENT to FORCE_Y are written.

    """
    for i in range(body.shape[0]):
        out[i, MOMENT] = body[i, FZ]
        out[i, FORCE_X] = body[i, FX]
        out[i, FORCE_Y] = body[i, FY]


@compiled
def joint_wrenches(model, work, qdd, lam, wrench):
    """
    Compute the wrenches in the joints of the trees: Newton and Euler, from the tips inward.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward``; only poses are read.
    qdd : ndarray, shape (nv,)
        Joint accelerations.
    lam : ndarray, shape (nc,)
        Multipliers.
    wrench : ndarray, shape (nb + 1, COLUMNS)
        After ``bias_forces``. MOMENT to FORCE_Y become the wrench in each body's joint.

    """
    tree, constant, body = model.tree, model.body, work.body
    for i in range(1, tree.shape[0]):
        p = tree[i, PARENT]
        turn = wrench[p, TURN] if p > 0 else 0.0
        x = (wrench[p, ALONG_X] if p > 0 else 0.0) - turn * body[i, RY]
        y = (wrench[p, ALONG_Y] if p > 0 else 0.0) + turn * body[i, RX]
        if tree[i, TYPE] == PRISMATIC:
            x += body[i, SX] * qdd[tree[i, DOF]]
            y += body[i, SY] * qdd[tree[i, DOF]]
        else:
            turn += qdd[tree[i, DOF]]
        wrench[i, TURN] = turn
        wrench[i, ALONG_X] = x
        wrench[i, ALONG_Y] = y
        hx = -(body[i, SIN] * constant[i, MASS_X] + body[i, COS] * constant[i, MASS_Y])
        hy = body[i, COS] * constant[i, MASS_X] - body[i, SIN] * constant[i, MASS_Y]
        wrench[i, MOMENT] += constant[i, INERTIA] * turn + hx * x + hy * y
        wrench[i, FORCE_X] += constant[i, MASS] * x + hx * turn
        wrench[i, FORCE_Y] += constant[i, MASS] * y + hy * turn
    for a in range(model.cut.shape[0]):
        i, j = model.cut[a, BODY_A], model.cut[a, BODY_B]
        moment, fx, fy = _cut_wrench(model.cut, model.cut_point, body, a, lam)
        x = body[i, COS] * model.cut_point[a, A_X] - body[i, SIN] * model.cut_point[a, A_Y]
        y = body[i, SIN] * model.cut_point[a, A_X] + body[i, COS] * model.cut_point[a, A_Y]
        wrench[i, MOMENT] -= moment + x * fy - y * fx
        wrench[i, FORCE_X] -= fx
        wrench[i, FORCE_Y] -= fy
        x += body[i, PX] - body[j, PX]
        y += body[i, PY] - body[j, PY]
        wrench[j, MOMENT] += moment + x * fy - y * fx
        wrench[j, FORCE_X] += fx
        wrench[j, FORCE_Y] += fy
    for i in range(tree.shape[0] - 1, 0, -1):
        p = tree[i, PARENT]
        wrench[p, MOMENT] += (wrench[i, MOMENT] + body[i, RX] * wrench[i, FORCE_Y]
                              - body[i, RY] * wrench[i, FORCE_X])
        wrench[p, FORCE_X] += wrench[i, FORCE_X]
        wrench[p, FORCE_Y] += wrench[i, FORCE_Y]
