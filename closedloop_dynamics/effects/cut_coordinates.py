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
Coordinates of cut joints: where they are, how fast, and what acts along them.

The coordinate of a freedom that turns is the angle of body A in body B about an axis, that of one
that slides how far point A is from point B along the axis, of a helical joint this over the lead.
Which of a joint's bodies is A is told in ``mechanism.cut_freedoms``. A spherical joint has rates
alone: in the place of coordinates are their integrals, which tell the work of efforts.

A rate is the same function of the bodies' velocities that its acceleration is of their
accelerations; an effort along it is a force or torque on body A, and the opposite one on body B.

Laws see these coordinates behind those of the tree: one place for each freedom that anything
acts along.

"""

import math

from .forces import cross, dot, offset, push, push_in_space, turned, twist
from .table import (
    ACROSS_B, AXIS, FOLLOWED, IN_PLANE, POINT_A, POINT_B, RATE_ONLY, ROW_A, ROW_B, SCALE, SIDE_A,
    SIDE_B, SLIDES, ZERO)
from ..core.codegen.space import ACCELERATION, ORIGIN, SPIN, SPIN_RATE, VELOCITY
from ..core.compiled import compiled, inlined
from ..core.joint_wrenches import newton
from ..core.types import ALPHA, AX, AY, FZ, OMEGA, PX, PY, VX, VY


@inlined
def direction(body, row, planar, values, k, first):
    """
    Return a direction of a body in world axes.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``.
    row : int
        Of the body.
    planar : bool
        Whether this is in the plane.
    values : ndarray
        Of ``CutCoordinates``.
    k, first : int
        Row, and first column, of the direction in them.

    """
    x, y, z = values[k, first], values[k, first + 1], values[k, first + 2]
    if planar:
        x, y = offset(body, row, x, y)
    else:
        x, y, z = turned(body, row, x, y, z)
    return x, y, z


@inlined
def _place(body, row, planar, values, k, first):
    """Return the place of a point of a body in the world [m]."""
    x, y, z = direction(body, row, planar, values, k, first)
    if planar:
        return body[row, PX] + x, body[row, PY] + y, z
    return body[row, ORIGIN] + x, body[row, ORIGIN + 1] + y, body[row, ORIGIN + 2] + z


@inlined
def _lever(body, row, planar, place):
    """Return a place in the world from the origin of a body's row [m]."""
    x, y, z = place
    if planar:
        return x - body[row, PX], y - body[row, PY], z
    return x - body[row, ORIGIN], y - body[row, ORIGIN + 1], z - body[row, ORIGIN + 2]


@inlined
def _velocity(body, row, planar):
    """Return angular velocity and velocity of a body's row: two vectors."""
    if planar:
        return (0.0, 0.0, body[row, OMEGA]), (body[row, VX], body[row, VY], 0.0)
    return ((body[row, SPIN], body[row, SPIN + 1], body[row, SPIN + 2]),
            (body[row, VELOCITY], body[row, VELOCITY + 1], body[row, VELOCITY + 2]))


@inlined
def _acceleration(scratch, row, planar):
    """Return angular acceleration and acceleration of a row beyond the velocity-product ones."""
    if planar:
        return (0.0, 0.0, scratch[row, 3]), (scratch[row, 4], scratch[row, 5], 0.0)
    return ((scratch[row, 6], scratch[row, 7], scratch[row, 8]),
            (scratch[row, 9], scratch[row, 10], scratch[row, 11]))


@inlined
def _velocity_product(body, row, planar):
    """Return the velocity-product accelerations of a row."""
    if planar:
        return (0.0, 0.0, 0.0), (body[row, AX], body[row, AY], 0.0)
    return ((body[row, SPIN_RATE], body[row, SPIN_RATE + 1], body[row, SPIN_RATE + 2]),
            (body[row, ACCELERATION], body[row, ACCELERATION + 1], body[row, ACCELERATION + 2]))


@inlined
def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _at(motion, lever):
    """Return what an angular velocity, or acceleration, and that of an origin are at a lever."""
    turn, slide = motion
    x, y, z = cross(turn, lever)
    return slide[0] + x, slide[1] + y, slide[2] + z


@inlined
def _along(slides, axis, lever_a, lever_b, motion_a, motion_b):
    """Return the rate of a coordinate; of accelerations the part that they make up."""
    if slides:
        return dot(axis, _less(_at(motion_a, lever_a), _at(motion_b, lever_b)))
    return dot(axis, _less(motion_a[0], motion_b[0]))


@inlined
def _bias(slides, axis, lever_a, lever_b, motion_a, motion_b):
    """Return what velocities make up of the acceleration of a coordinate."""
    turn_a, turn_b = motion_a[0], motion_b[0]
    if slides:
        apart = _less(_at(motion_a, lever_a), _at(motion_b, lever_b))
        x, y, z = _less(cross(turn_a, cross(turn_a, lever_a)),
                        cross(turn_b, cross(turn_b, lever_b)))
        u, v, w = cross(turn_b, apart)
        return dot(axis, (x - 2.0 * u, y - 2.0 * v, z - 2.0 * w))
    return dot(cross(turn_b, axis), _less(turn_a, turn_b))


@compiled
def measure(index, values, body, states, first, position, velocity):
    """
    Find the coordinates and their rates.

    Parameters
    ----------
    index, values : ndarray
        Of ``CutCoordinates``.
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``.
    states : ndarray, shape (nz,)
        The effects' own, among them angles, and integrals of rates, that are followed.
    first : int
        Where to write the first of them.
    position, velocity : ndarray
        Written in place [rad, m; rad/s, m/s]. Angles in space are within half a turn of the one
        that is followed, or of zero; integrals of rates that are not followed are zero.

    """
    for k in range(index.shape[0]):
        planar, slides = index[k, IN_PLANE] == 1, index[k, SLIDES] == 1
        a, b = index[k, ROW_A], index[k, ROW_B]
        axis = direction(body, b, planar, values, k, AXIS)
        place = _place(body, a, planar, values, k, POINT_A)
        if slides:
            found = values[k, SCALE] * dot(
                axis, _less(place, _place(body, b, planar, values, k, POINT_B)))
        elif planar:
            found = body[a, ALPHA] - body[b, ALPHA] - values[k, ZERO]
        elif index[k, RATE_ONLY] == 1:
            found = states[index[k, FOLLOWED]] if index[k, FOLLOWED] >= 0 else 0.0
        else:
            side = direction(body, a, planar, values, k, SIDE_A)
            found = math.atan2(dot(side, direction(body, b, planar, values, k, ACROSS_B)),
                               dot(side, direction(body, b, planar, values, k, SIDE_B)))
            if index[k, FOLLOWED] >= 0:
                apart = (states[index[k, FOLLOWED]] - found) / (2.0 * math.pi)
                found += 2.0 * math.pi * math.floor(apart + 0.5)
        position[first + k] = found
        velocity[first + k] = values[k, SCALE] * _along(
            slides, axis, _lever(body, a, planar, place), _lever(body, b, planar, place),
            _velocity(body, a, planar), _velocity(body, b, planar))


@compiled
def exert(index, values, body, efforts, first):
    """
    Apply efforts along the coordinates to the bodies.

    Parameters
    ----------
    index, values : ndarray
        Of ``CutCoordinates``.
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``; bias forces are reduced.
    efforts : ndarray
        [N m; N].
    first : int
        Where the first of them is.

    """
    for k in range(index.shape[0]):
        planar = index[k, IN_PLANE] == 1
        effort = values[k, SCALE] * efforts[first + k]
        x, y, z = direction(body, index[k, ROW_B], planar, values, k, AXIS)
        place = _place(body, index[k, ROW_A], planar, values, k, POINT_A)
        sign = 1.0
        for n in range(2):
            row = index[k, ROW_A + n]
            if index[k, SLIDES] == 1:
                rx, ry, rz = _lever(body, row, planar, place)
                if planar:
                    push(body, row, rx, ry, sign * effort * x, sign * effort * y)
                else:
                    push_in_space(body, row, rx, ry, rz, sign * effort * x, sign * effort * y,
                                  sign * effort * z)
            elif planar:
                body[row, FZ] -= sign * effort
            else:
                twist(body, row, sign * effort * x, sign * effort * y, sign * effort * z)
            sign = -1.0


@compiled
def accelerations(cuts, model, work, qdd, whole, out):
    """
    Find the accelerations of the coordinates.

    Parameters
    ----------
    cuts : CutCoordinates
        Its scratch is overwritten.
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``kinematics.outward``.
    qdd : ndarray, shape (nv,)
        Accelerations of the tree.
    whole : bool
        Whether with what velocities make up; without, this is J qdd, J being the derivatives of
        the coordinates by those of the tree.
    out : ndarray, shape (nv + nk,)
        The last nk are written [rad/s^2, m/s^2].

    """
    index, values, scratch, body = cuts.index, cuts.values, cuts.scratch, work.body
    for i in range(scratch.shape[0]):
        for n in range(scratch.shape[1]):
            scratch[i, n] = 0.0
    newton(model, work, qdd, scratch)
    first = out.shape[0] - index.shape[0]
    for k in range(index.shape[0]):
        planar, slides = index[k, IN_PLANE] == 1, index[k, SLIDES] == 1
        a, b = index[k, ROW_A], index[k, ROW_B]
        axis = direction(body, b, planar, values, k, AXIS)
        place = _place(body, a, planar, values, k, POINT_A)
        lever_a, lever_b = _lever(body, a, planar, place), _lever(body, b, planar, place)
        found = _along(slides, axis, lever_a, lever_b, _acceleration(scratch, a, planar),
                       _acceleration(scratch, b, planar))
        if whole:
            found += _along(
                slides, axis, lever_a, lever_b, _velocity_product(body, a, planar),
                _velocity_product(body, b, planar))
            found += _bias(slides, axis, lever_a, lever_b, _velocity(body, a, planar),
                           _velocity(body, b, planar))
        out[first + k] = values[k, SCALE] * found
