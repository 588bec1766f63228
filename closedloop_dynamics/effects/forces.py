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

"""Shared parts of the laws of forces at points, in the plane and in space."""

import math

from .table import (
    FASTEST, FREE, GAP, PLACE, RATE, SPEED, TOUCHING, UNDECIDED, WRONG)
from ..core.codegen.space import FORCE, FRAME, ORIGIN, SPIN, VELOCITY
from ..core.compiled import inlined
from ..core.types import COS, FX, FY, FZ, OMEGA, PX, PY, SIN, VX, VY

WORLD, BODY = 'world', 'body'


@inlined
def dot(a, b):
    """Return the scalar product of two vectors of three components."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a, b):
    """Return the vector product of two vectors of three components."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def offset(body, row, x, y):
    """
    Return the offset of a point from its body's origin, in world axes [m].

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``.
    row : int
        Of the body, 0 for the ground.
    x, y : float
        Place in the body's frame [m].

    """
    return (body[row, COS] * x - body[row, SIN] * y, body[row, SIN] * x + body[row, COS] * y)


@inlined
def push(body, row, rx, ry, fx, fy):
    """
    Apply a force to a body.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        The bias force, columns FZ to FY, is reduced.
    row : int
        Of the body.
    rx, ry : float
        Offset of the point of attack from the body's origin, world axes [m].
    fx, fy : float
        World axes [N].

    """
    body[row, FZ] -= rx * fy - ry * fx
    body[row, FX] -= fx
    body[row, FY] -= fy


@inlined
def in_contact(contacts, row, gap, rate):
    """
    Note a gap; return whether there is contact.

    Parameters
    ----------
    contacts : Contacts
        Of the table.
    row : int
        Of the effect.
    gap, rate : float
        Negative where bodies touch [m; rad]; its rate.

    """
    now, trial, mode = contacts.now, contacts.trial, contacts.mode[row]
    now[row, GAP] = gap
    now[row, RATE] = rate
    trial[row, FASTEST] = max(trial[row, FASTEST], abs(rate))
    if mode != UNDECIDED:
        trial[row, WRONG] = max(trial[row, WRONG], -gap if mode == FREE else gap)
    return mode == TOUCHING or (mode == UNDECIDED and gap < 0.0)


@inlined
def note_path(contacts, row, x, y, z, u, v, w):
    """
    Note where a roller is, beside a body of finite extent that it may pass.

    Parameters
    ----------
    contacts : Contacts
        Of the table.
    row : int
        Of the effect.
    x, y, z : float
        Place of its centre, in axes in which the body rests [m].
    u, v, w : float
        Velocity relative to the body, in any axes [m/s].

    """
    now, trial = contacts.now, contacts.trial
    now[row, PLACE] = x
    now[row, PLACE + 1] = y
    now[row, PLACE + 2] = z
    trial[row, SPEED] = max(trial[row, SPEED], math.sqrt(u * u + v * v + w * w))


@inlined
def elastic_force(stiffness, exponent, gap):
    """
    Return the elastic force of a contact, k d^n.

    Beyond its end, within a step that is cut there then, a contact goes on as a pull: so the
    motion is smooth there, and the end found to the last digits.

    """
    depth = abs(gap)
    # A power takes longer than all the rest of a contact.
    if exponent == 1.0:
        force = stiffness * depth
    elif exponent == 1.5:
        force = stiffness * (depth * math.sqrt(depth))
    else:
        force = stiffness * depth ** exponent
    return -force if gap > 0.0 else force


@inlined
def place(body, row, x, y):
    """Return the place of a point in the world [m]; parameters as of ``offset``."""
    rx, ry = offset(body, row, x, y)
    return body[row, PX] + rx, body[row, PY] + ry


@inlined
def velocity(body, row, px, py):
    """
    Return the velocity of what is at a place of a body [m/s].

    Parameters
    ----------
    body, row
        As for ``offset``.
    px, py : float
        In the world [m].

    """
    rx, ry = px - body[row, PX], py - body[row, PY]
    return body[row, VX] - body[row, OMEGA] * ry, body[row, VY] + body[row, OMEGA] * rx


@inlined
def push_at(body, row, px, py, fx, fy):
    """Apply a force to a body at a place in the world; parameters as of ``push``."""
    push(body, row, px - body[row, PX], py - body[row, PY], fx, fy)


@inlined
def pull(body, row, x, y, fx, fy):
    """Apply a force to a body at a place in its frame; parameters as of ``push``."""
    rx, ry = offset(body, row, x, y)
    push(body, row, rx, ry, fx, fy)


@inlined
def distance(body, a, ax, ay, b, bx, by):
    """
    Return the direction from one point to another, their distance and its rate.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``.
    a, b : int
        Rows of the points' bodies.
    ax, ay, bx, by : float
        Places in the bodies' frames [m].

    Returns
    -------
    x, y, length, rate : float
        Direction zero where the points meet; [m], [m/s].

    """
    px, py = place(body, a, ax, ay)
    x, y = place(body, b, bx, by)
    vx, vy = velocity(body, b, x, y)
    ux, uy = velocity(body, a, px, py)
    x -= px
    y -= py
    length, rate = math.sqrt(x * x + y * y), 0.0
    if length > 0.0:
        x /= length
        y /= length
        rate = x * (vx - ux) + y * (vy - uy)
    return x, y, length, rate


@inlined
def turned(body, row, x, y, z):
    """
    Return a vector of a body's frame in world axes, in space.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After the outward recursion.
    row : int
        Of the body, 0 for the ground.
    x, y, z : float
        In the frame of the body's row.

    """
    return (body[row, FRAME] * x + body[row, FRAME + 1] * y + body[row, FRAME + 2] * z,
            body[row, FRAME + 3] * x + body[row, FRAME + 4] * y + body[row, FRAME + 5] * z,
            body[row, FRAME + 6] * x + body[row, FRAME + 7] * y + body[row, FRAME + 8] * z)


@inlined
def velocity_in_space(body, row, rx, ry, rz):
    """
    Return the velocity of a point of a body, in space [m/s].

    Parameters
    ----------
    body, row
        As for ``turned``.
    rx, ry, rz : float
        Offset of the point from the origin of the body's row, world axes [m].

    """
    x, y, z = body[row, SPIN], body[row, SPIN + 1], body[row, SPIN + 2]
    return (body[row, VELOCITY] + y * rz - z * ry, body[row, VELOCITY + 1] + z * rx - x * rz,
            body[row, VELOCITY + 2] + x * ry - y * rx)


@inlined
def push_in_space(body, row, rx, ry, rz, fx, fy, fz):
    """
    Apply a force to a body, in space.

    Parameters
    ----------
    body, row, rx, ry, rz
        As for ``velocity_in_space``; the force that the body's acceleration takes is reduced.
    fx, fy, fz : float
        World axes [N].

    """
    twist(body, row, ry * fz - rz * fy, rz * fx - rx * fz, rx * fy - ry * fx)
    body[row, FORCE + 3] -= fx
    body[row, FORCE + 4] -= fy
    body[row, FORCE + 5] -= fz


@inlined
def place_in_space(body, row, x, y, z):
    """Return the place of a point in the world [m]; parameters as of ``turned``."""
    rx, ry, rz = turned(body, row, x, y, z)
    return body[row, ORIGIN] + rx, body[row, ORIGIN + 1] + ry, body[row, ORIGIN + 2] + rz


@inlined
def velocity_at(body, row, px, py, pz):
    """Return the velocity of what is at a place of a body in the world, in space [m/s]."""
    return velocity_in_space(body, row, px - body[row, ORIGIN], py - body[row, ORIGIN + 1],
                             pz - body[row, ORIGIN + 2])


@inlined
def distance_in_space(body, a, ax, ay, az, b, bx, by, bz):
    """
    Return two points in space, the direction from one to the other, their distance and its rate.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``.
    a, b : int
        Rows of the points' bodies.
    ax, ay, az, bx, by, bz : float
        Places in the bodies' frames [m].

    Returns
    -------
    px, py, pz, qx, qy, qz, x, y, z, length, rate : float
        Places of both in the world [m]; direction zero where they meet; [m], [m/s].

    """
    px, py, pz = place_in_space(body, a, ax, ay, az)
    qx, qy, qz = place_in_space(body, b, bx, by, bz)
    vx, vy, vz = velocity_at(body, b, qx, qy, qz)
    ux, uy, uz = velocity_at(body, a, px, py, pz)
    x, y, z = qx - px, qy - py, qz - pz
    length, rate = math.sqrt(x * x + y * y + z * z), 0.0
    if length > 0.0:
        x /= length
        y /= length
        z /= length
        rate = x * (vx - ux) + y * (vy - uy) + z * (vz - uz)
    return px, py, pz, qx, qy, qz, x, y, z, length, rate


@inlined
def push_there(body, row, px, py, pz, fx, fy, fz):
    """Apply a force to a body at a place in the world; parameters as of ``push_in_space``."""
    push_in_space(body, row, px - body[row, ORIGIN], py - body[row, ORIGIN + 1],
                  pz - body[row, ORIGIN + 2], fx, fy, fz)


@inlined
def twist(body, row, x, y, z):
    """
    Apply a torque to a body, in space.

    Parameters
    ----------
    body, row
        As for ``push_in_space``.
    x, y, z : float
        World axes [N m].

    """
    body[row, FORCE] -= x
    body[row, FORCE + 1] -= y
    body[row, FORCE + 2] -= z
