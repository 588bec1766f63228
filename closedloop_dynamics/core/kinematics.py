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

"""Outward recursion: poses, velocities, velocity-product accelerations, rigid-body inertias."""

import math

from .compiled import inlined
from .types import (
    ALPHA, ANGLE, AX, AY, COS, DOF, FX, FY, FZ, HX, HY, INERTIA, IZZ, JOINT_X, JOINT_Y, MASS,
    MASS_X, MASS_Y, MXX, MXY, MYY, OMEGA, PARENT, PRISMATIC, PX, PY, RX, RY, SIN, SX, SY, TYPE,
    VX, VY)


@inlined
def outward(model, q, qd, work):
    """
    Update every body's motion, its rigid-body inertia and its bias force.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    q, qd : ndarray, shape (nv,)
        Joint coordinates [rad, m] and rates.
    work : Workspace
        ``work.body`` is written, columns ALPHA to FY, SX and SY.

    Notes
    -----
    World axes throughout, each body at its own origin: then neither inertias nor forces are
    ever rotated, only shifted, and a revolute joint's axis is (1, 0, 0). The acceleration is
    the one that q, qd and gravity leave when qdd = 0; a ground that accelerates by -g stands
    for gravity. The bias force is what a body needs for that acceleration.

    """
    tree, constant, body = model.tree, model.body, work.body
    body[0, COS] = 1.0
    body[0, AX] = -model.gravity[0]
    body[0, AY] = -model.gravity[1]
    for i in range(1, tree.shape[0]):
        p = tree[i, PARENT]
        rate = qd[tree[i, DOF]]
        cos_p, sin_p, omega_p = body[p, COS], body[p, SIN], body[p, OMEGA]
        rx = cos_p * constant[i, JOINT_X] - sin_p * constant[i, JOINT_Y]
        ry = sin_p * constant[i, JOINT_X] + cos_p * constant[i, JOINT_Y]
        angle = body[p, ALPHA] + constant[i, ANGLE]
        vx, vy = body[p, VX], body[p, VY]
        ax, ay = body[p, AX], body[p, AY]
        omega = omega_p
        if tree[i, TYPE] == PRISMATIC:
            cos, sin = math.cos(angle), math.sin(angle)
            slide = q[tree[i, DOF]]
            rx += slide * cos
            ry += slide * sin
            vx += rate * cos
            vy += rate * sin
            # Coriolis acceleration of sliding along a turning axis.
            ax -= 2.0 * omega_p * rate * sin
            ay += 2.0 * omega_p * rate * cos
            body[i, SX] = cos
            body[i, SY] = sin
        else:
            angle += q[tree[i, DOF]]
            omega += rate
            cos, sin = math.cos(angle), math.sin(angle)
        body[i, ALPHA] = angle
        body[i, COS] = cos
        body[i, SIN] = sin
        body[i, RX] = rx
        body[i, RY] = ry
        body[i, PX] = body[p, PX] + rx
        body[i, PY] = body[p, PY] + ry
        body[i, OMEGA] = omega
        body[i, VX] = vx - omega_p * ry
        body[i, VY] = vy + omega_p * rx
        square = omega_p * omega_p
        ax -= square * rx
        ay -= square * ry
        body[i, AX] = ax
        body[i, AY] = ay
        mass = constant[i, MASS]
        hx = -(sin * constant[i, MASS_X] + cos * constant[i, MASS_Y])
        hy = cos * constant[i, MASS_X] - sin * constant[i, MASS_Y]
        body[i, IZZ] = constant[i, INERTIA]
        body[i, HX] = hx
        body[i, HY] = hy
        body[i, MXX] = mass
        body[i, MXY] = 0.0
        body[i, MYY] = mass
        # Force at the centre of mass: mass times (a - omega^2 c), c = (hy, -hx) / mass.
        square = omega * omega
        body[i, FZ] = hx * ax + hy * ay
        body[i, FX] = mass * ax - square * hy
        body[i, FY] = mass * ay + square * hx


@inlined
def point_position(work, i, x, y, out):
    """
    Compute the place of a point of body ``i`` given in its frame.

    Parameters
    ----------
    work : Workspace
        After ``outward``.
    i : int
        Row of the body, 0 for the ground.
    x, y : float
        Place in the body's frame [m].
    out : ndarray, shape (2,)
        Written in place [m].

    """
    body = work.body
    out[0] = body[i, PX] + body[i, COS] * x - body[i, SIN] * y
    out[1] = body[i, PY] + body[i, SIN] * x + body[i, COS] * y


@inlined
def point_velocity(work, i, x, y, out):
    """
    Compute the velocity of a point of body ``i`` given in its frame.

    Parameters
    ----------
    work, i, x, y
        As for ``point_position``.
    out : ndarray, shape (2,)
        Written in place [m/s].

    """
    body = work.body
    rx = body[i, COS] * x - body[i, SIN] * y
    ry = body[i, SIN] * x + body[i, COS] * y
    out[0] = body[i, VX] - body[i, OMEGA] * ry
    out[1] = body[i, VY] + body[i, OMEGA] * rx
