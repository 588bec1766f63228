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

"""Cut joints: closure error, its rates, and the response of the trees to unit cut forces."""

import math

from .compiled import inlined
from .types import (
    A_X, A_Y, ALPHA, AX, AY, B_X, B_Y, BODY_A, BODY_B, COS, CUT_ANGLE, CUT_PRISMATIC,
    CUT_REVOLUTE, CUT_TYPE, DINV, HX, HY, OMEGA, PRISMATIC, PX, PY, REVOLUTE, RHS, ROW, ROWS, RX,
    RY, SIN, SLOT_A, SLOT_B, SLOT_COMMON, SLOT_END, SX, SY, TYPE, UX, UY, UZ, VX, VY)

# What ``update`` computes of the unit cut forces: nothing, their shares at the joints of trees
# that give way, or their levers on the bodies' angles and on the slides (J^T for these).
NO_RESPONSES, REDUCED, LEVERS = range(3)


@inlined
def _reduce(model, work, responses, first, last, row, z, x, y):
    """
    Carry a unit force inward along slots ``first`` to ``last`` and keep its share at each joint.

    Returns what arrives at the origin of the parent of the last body: moment, force.

    """
    tree, slot_body = model.tree, model.slot_body
    body, response, scaled = work.body, work.response, work.response_scaled
    for slot in range(first, last):
        i = slot_body[slot]
        kind = tree[i, TYPE]
        if responses == LEVERS:
            g = 0.0
            if kind == PRISMATIC:
                u = body[i, SX] * x + body[i, SY] * y
            else:
                u, z = z, 0.0
        elif kind == REVOLUTE:
            u = z
            g = u * body[i, DINV]
            x -= body[i, HX] * g
            y -= body[i, HY] * g
            z = 0.0
        else:
            u = body[i, SX] * x + body[i, SY] * y if kind == PRISMATIC else z
            g = u * body[i, DINV]
            z -= body[i, UZ] * g
            x -= body[i, UX] * g
            y -= body[i, UY] * g
        response[slot, row] = u
        scaled[slot, row] = g
        z += body[i, RX] * y - body[i, RY] * x
    return z, x, y


@inlined
def _respond(model, work, responses, a, row, z, x, y, ax, ay, bx, by):
    """
    Compute the response to the unit force of one closure equation of cut joint ``a``.

    Moment ``z`` and force ``x``, ``y`` act on body A at offset ``ax``, ``ay`` from its
    origin, and with the opposite sign on body B at offset ``bx``, ``by``.

    """
    cut = model.cut
    middle, common, end = cut[a, SLOT_B], cut[a, SLOT_COMMON], cut[a, SLOT_END]
    za, xa, ya = _reduce(
        model, work, responses, cut[a, SLOT_A], middle, row, z + ax * y - ay * x, x, y)
    if middle < end:
        zb, xb, yb = _reduce(
            model, work, responses, middle, common, row, -z - bx * y + by * x, -x, -y)
        if common < end:
            _reduce(model, work, responses, common, end, row, za + zb, xa + xb, ya + yb)


@inlined
def update(model, work, responses):
    """
    Compute closure, its rates and, if asked, the unit responses of every cut joint.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward`` and, if reduced, ``articulated_inertia.inward``. Writes
        ``closure`` (psi), ``closure_rate`` (J qd), ``bias`` (Jdot qd), and ``response`` (the
        columns of J^T reduced to the joints) with ``response_scaled``, or the levers.
    responses : int
        ``NO_RESPONSES``, ``REDUCED`` or ``LEVERS``.

    Notes
    -----
    psi = p_A - p_B (doc/theory.md section 1). The multiplier acts on body A, its
    opposite on body B. For a prismatic cut joint the first equation is n . (p_A - p_B), n normal
    to the axis that turns with body B; its gradient is the force n on A and -n on B,
    both at p_A.

    """
    body, cut, point = work.body, model.cut, model.cut_point
    psi, rate, bias = work.closure, work.closure_rate, work.bias
    for a in range(cut.shape[0]):
        i, j, r, kind = cut[a, BODY_A], cut[a, BODY_B], cut[a, ROW], cut[a, CUT_TYPE]
        cos, sin, omega = body[i, COS], body[i, SIN], body[i, OMEGA]
        ax = cos * point[a, A_X] - sin * point[a, A_Y]
        ay = sin * point[a, A_X] + cos * point[a, A_Y]
        cos, sin, omega_b = body[j, COS], body[j, SIN], body[j, OMEGA]
        bx = cos * point[a, B_X] - sin * point[a, B_Y]
        by = sin * point[a, B_X] + cos * point[a, B_Y]
        x = body[i, PX] - body[j, PX] + ax - bx
        y = body[i, PY] - body[j, PY] + ay - by
        vx = body[i, VX] - body[j, VX] - omega * ay + omega_b * by
        vy = body[i, VY] - body[j, VY] + omega * ax - omega_b * bx
        square, square_b = omega * omega, omega_b * omega_b
        acx = body[i, AX] - body[j, AX] - square * ax + square_b * bx
        acy = body[i, AY] - body[j, AY] - square * ay + square_b * by
        if kind == CUT_PRISMATIC:
            angle = body[j, ALPHA] + point[a, CUT_ANGLE]
            nx, ny = -math.sin(angle), math.cos(angle)
            psi[r] = nx * x + ny * y
            # n turns with body B: its rate is -omega_b times the axis (ny, -nx).
            along, along_rate = ny * x - nx * y, ny * vx - nx * vy
            rate[r] = nx * vx + ny * vy - omega_b * along
            bias[r] = (nx * acx + ny * acy - 2.0 * omega_b * along_rate
                       - square_b * psi[r])
            if responses != NO_RESPONSES:
                _respond(model, work, responses, a, 0, 0.0, nx, ny, ax, ay, x + bx, y + by)
        else:
            psi[r], psi[r + 1] = x, y
            rate[r], rate[r + 1] = vx, vy
            bias[r], bias[r + 1] = acx, acy
            if responses != NO_RESPONSES:
                _respond(model, work, responses, a, 0, 0.0, 1.0, 0.0, ax, ay, bx, by)
                _respond(model, work, responses, a, 1, 0.0, 0.0, 1.0, ax, ay, bx, by)
        if kind != CUT_REVOLUTE:
            last = cut[a, ROWS] - 1
            psi[r + last] = body[i, ALPHA] - body[j, ALPHA] - point[a, CUT_ANGLE]
            rate[r + last] = omega - omega_b
            bias[r + last] = 0.0
            if responses != NO_RESPONSES:
                _respond(model, work, responses, a, last, 1.0, 0.0, 0.0, ax, ay, bx, by)


@inlined
def largest(values):
    """
    Return the largest absolute value, such as the closure error.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Any numbers.

    Returns
    -------
    float
        NaN if there is one.

    """
    most = 0.0
    for value in values:
        if not abs(value) <= most:
            most = abs(value)
    return most


@inlined
def free_acceleration(model, work, out):
    """
    Compute J I^-1 phi, the acceleration of each closure error without cut forces.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``update``.
    out : ndarray, shape (nc,)
        Written in place, in elimination order.

    """
    body, scaled = work.body, work.response_scaled
    cut, slot_body = model.cut, model.slot_body
    for a in range(cut.shape[0]):
        for k in range(cut[a, ROWS]):
            total = 0.0
            for slot in range(cut[a, SLOT_A], cut[a, SLOT_END]):
                total += scaled[slot, k] * body[slot_body[slot], RHS]
            out[cut[a, ROW] + k] = total


@inlined
def apply(model, work, lam):
    """
    Add J^T lambda, reduced, to the right-hand sides of the joints.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``update``; RHS is added to.
    lam : ndarray, shape (nc,)
        Multipliers in elimination order.

    """
    body, response = work.body, work.response
    cut, slot_body = model.cut, model.slot_body
    for a in range(cut.shape[0]):
        for slot in range(cut[a, SLOT_A], cut[a, SLOT_END]):
            i = slot_body[slot]
            total = body[i, RHS]
            for k in range(cut[a, ROWS]):
                total += response[slot, k] * lam[cut[a, ROW] + k]
            body[i, RHS] = total
