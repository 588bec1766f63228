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

"""Dense matrices of the mechanism: constraint Jacobian and generalized inertia matrix."""

import math

from .compiled import compiled
from .types import (
    A_X, A_Y, ALPHA, ARMATURE, B_X, B_Y, BODY_A, BODY_B, COS, CUT_ANGLE, CUT_PRISMATIC,
    CUT_REVOLUTE, CUT_ROW, CUT_TYPE, DOF, HX, HY, IZZ, MXX, MXY, MYY, PARENT,
    PRISMATIC, PX, PY, ROWS, RX, RY, SIN, SLOT_A, SLOT_B, SLOT_COMMON, SLOT_END, SX, SY, TYPE)


@compiled
def _row(model, work, a, row, z, x, y, px, py, qx, qy, jac):
    """Write one row: moment z and force x, y act on body A at p, the opposite on B at q."""
    cut, tree, body = model.cut, model.tree, work.body
    for slot in range(cut[a, SLOT_A], cut[a, SLOT_END]):
        i = model.slot_body[slot]
        on_a = slot < cut[a, SLOT_B] or slot >= cut[a, SLOT_COMMON]
        on_b = slot >= cut[a, SLOT_B]
        total = 0.0
        if tree[i, TYPE] == PRISMATIC:
            if on_a != on_b:
                total = body[i, SX] * x + body[i, SY] * y
                if on_b:
                    total = -total
        else:
            if on_a:
                total += z + (px - body[i, PX]) * y - (py - body[i, PY]) * x
            if on_b:
                total -= z + (qx - body[i, PX]) * y - (qy - body[i, PY]) * x
        jac[row, tree[i, DOF]] = total


@compiled
def constraint_jacobian(model, work, jac):
    """
    Compute J = d psi / d q, rows in the mechanism's order.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward``.
    jac : ndarray, shape (nc, nv)
        Written in place.

    Notes
    -----
    Appendix A.1 and A.2 of the paper print its blocks for two mechanisms; doc/theory.md lists
    their misprints.

    """
    body, cut, point = work.body, model.cut, model.cut_point
    jac[:, :] = 0.0
    for a in range(cut.shape[0]):
        i, j, row, kind = cut[a, BODY_A], cut[a, BODY_B], cut[a, CUT_ROW], cut[a, CUT_TYPE]
        px = body[i, PX] + body[i, COS] * point[a, A_X] - body[i, SIN] * point[a, A_Y]
        py = body[i, PY] + body[i, SIN] * point[a, A_X] + body[i, COS] * point[a, A_Y]
        qx = body[j, PX] + body[j, COS] * point[a, B_X] - body[j, SIN] * point[a, B_Y]
        qy = body[j, PY] + body[j, SIN] * point[a, B_X] + body[j, COS] * point[a, B_Y]
        if kind == CUT_PRISMATIC:
            angle = body[j, ALPHA] + point[a, CUT_ANGLE]
            _row(model, work, a, row, 0.0, -math.sin(angle), math.cos(angle), px, py, px, py, jac)
        else:
            _row(model, work, a, row, 0.0, 1.0, 0.0, px, py, qx, qy, jac)
            _row(model, work, a, row + 1, 0.0, 0.0, 1.0, px, py, qx, qy, jac)
        if kind != CUT_REVOLUTE:
            _row(model, work, a, row + cut[a, ROWS] - 1, 1.0, 0.0, 0.0, px, py, qx, qy, jac)


@compiled
def generalized_inertia_matrix(model, work, gim):
    """
    Compute the generalized inertia matrix of the spanning tree by composite rigid bodies.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        Right after ``kinematics.outward``; the inertia columns are used up.
    gim : ndarray, shape (nv, nv)
        Written in place [kg m^2, kg m, kg].

    """
    tree, constant, body = model.tree, model.body, work.body
    gim[:, :] = 0.0
    for i in range(tree.shape[0] - 1, 0, -1):
        izz, hx, hy = body[i, IZZ], body[i, HX], body[i, HY]
        mxx, mxy, myy = body[i, MXX], body[i, MXY], body[i, MYY]
        # Force of the composite body for a unit acceleration of its joint, then inward.
        if tree[i, TYPE] == PRISMATIC:
            sx, sy = body[i, SX], body[i, SY]
            z, x, y = hx * sx + hy * sy, mxx * sx + mxy * sy, mxy * sx + myy * sy
        else:
            z, x, y = izz, hx, hy
        row = tree[i, DOF]
        k = i
        while k > 0:
            if tree[k, TYPE] == PRISMATIC:
                value = body[k, SX] * x + body[k, SY] * y
            else:
                value = z
            gim[row, tree[k, DOF]] = value
            gim[tree[k, DOF], row] = value
            z += body[k, RX] * y - body[k, RY] * x
            k = tree[k, PARENT]
        gim[row, row] += constant[i, ARMATURE]
        p, rx, ry = tree[i, PARENT], body[i, RX], body[i, RY]
        body[p, IZZ] += izz + 2.0 * (rx * hy - ry * hx) + rx * (rx * myy - ry * mxy) - ry * (
            rx * mxy - ry * mxx)
        body[p, HX] += hx + rx * mxy - ry * mxx
        body[p, HY] += hy + rx * myy - ry * mxy
        body[p, MXX] += mxx
        body[p, MXY] += mxy
        body[p, MYY] += myy
