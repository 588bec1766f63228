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
States with orientations: quaternions among the coordinates, angular velocities among the rates.

A quaternion x, y, z, w turns the joint's frame into the child's; its rates are the angular
velocity about the child's axes, so that its derivative is half the quaternion times that. Changes
of coordinates have the length of the rates; a rotation is composed with the exponential of its
change. Where a mechanism has no such joint there is no table, and nothing of this is compiled.

"""

import math
from typing import NamedTuple

import numpy as np

from .compiled import compiled, inlined
from .types import AXIS, BALL, COORDINATE, DOF, TYPE

# Columns of Manifold.balls.
QUATERNION, TURN = range(2)
# A rotation by d changes the components of a quaternion by d / 2.
HALF = 0.5


class Manifold(NamedTuple):
    """
    Where the quaternions are in a state.

    Attributes
    ----------
    balls : ndarray of int, shape (n, 2)
        First coordinate and first rate of each.
    place : ndarray of int, shape (nv,)
        Coordinate of each rate; less than 0 for those of rotations.
    number : ndarray, shape (nv,)
        Scratch: the coordinate of each rate, 0 for those of rotations.

    """

    balls: np.ndarray
    place: np.ndarray
    number: np.ndarray


def manifold_of(model):
    """
    Return the table of a model's quaternions.

    Parameters
    ----------
    model : core.types.Model
        Constant arrays of a mechanism.

    Returns
    -------
    Manifold or None
        None where there are no quaternions.

    """
    rows = model.tree[1:]
    turns = rows[:, TYPE] == BALL
    if not turns.any():
        return None
    place = np.full(len(rows), -1)
    place[rows[~turns, DOF]] = rows[~turns, COORDINATE]
    # The last of three rows, about the third axis, tells of all.
    last = rows[turns & (rows[:, AXIS] == 2)]
    balls = np.column_stack([last[:, COORDINATE], last[:, DOF] - 2])
    return Manifold(np.ascontiguousarray(balls), place, np.zeros(len(rows)))


@inlined
def rates_begin(manifold, nv):
    """
    Return the place of the first rate in a state vector, which is nq.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    nv : int
        Number of rates.

    Returns
    -------
    int

    """
    if manifold is None:
        return nv
    return nv + manifold.balls.shape[0]


@compiled
def _rates(manifold, state, nv, out, lanes, lane):
    """Do as ``rates_of_coordinates`` does, where there are quaternions, in one lane."""
    nq = nv + manifold.balls.shape[0]
    for i in range(nv):
        if manifold.place[i] >= 0:
            out[lanes * manifold.place[i] + lane] = state[lanes * (nq + i) + lane]
    for ball in range(manifold.balls.shape[0]):
        a = lanes * manifold.balls[ball, QUATERNION] + lane
        b = lanes * (nq + manifold.balls[ball, TURN]) + lane
        x, y, z, w = state[a], state[a + lanes], state[a + 2 * lanes], state[a + 3 * lanes]
        p, q, r = HALF * state[b], HALF * state[b + lanes], HALF * state[b + 2 * lanes]
        out[a] = w * p + y * r - z * q
        out[a + lanes] = w * q + z * p - x * r
        out[a + 2 * lanes] = w * r + x * q - y * p
        out[a + 3 * lanes] = -(x * p + y * q + z * r)


@inlined
def rates_of_coordinates(manifold, state, nv, out, lanes):
    """
    Compute the derivatives of the coordinates.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    state : ndarray, shape (lanes * ns,)
        Coordinates, rates, others.
    nv : int
        Number of rates.
    out : ndarray, shape (lanes * ns,)
        The first lanes * nq are written.
    lanes : int
        So many states are stored side by side: number k of lane n at ``lanes * k + n``.

    """
    if manifold is None:
        for i in range(lanes * nv):
            out[i] = state[lanes * nv + i]
    else:
        for lane in range(lanes):
            _rates(manifold, state, nv, out, lanes, lane)


@compiled
def _power(manifold, tau, state, nv, out, lanes, lane):
    """Do as ``power_of_turns`` does, where there are quaternions, in one lane."""
    power, nq = 0.0, nv + manifold.balls.shape[0]
    for ball in range(manifold.balls.shape[0]):
        rate = manifold.balls[ball, TURN]
        for k in range(rate, rate + 3):
            power += tau[lanes * k + lane] * state[lanes * (nq + k) + lane]
    out[out.shape[0] - lanes + lane] = power


@inlined
def power_of_turns(manifold, tau, state, nv, out, lanes):
    """
    Write the power of torques on rotations, where there are such, as the last of a derivative.

    Parameters
    ----------
    manifold, state, nv, out, lanes
        As for ``rates_of_coordinates``.
    tau : ndarray, shape (lanes * nv,)
        [N m, N].

    """
    if manifold is not None:
        for lane in range(lanes):
            _power(manifold, tau, state, nv, out, lanes, lane)


@compiled
def _work(manifold, tau, since, state, lanes, lane):
    """Return the work of torques since a state, where there are quaternions, in one lane."""
    work = state[state.shape[0] - lanes + lane] - since[since.shape[0] - lanes + lane]
    for i in range(manifold.place.shape[0]):
        if manifold.place[i] >= 0:
            place = lanes * manifold.place[i] + lane
            work += tau[lanes * i + lane] * (state[place] - since[place])
    return work


@inlined
def add_work(manifold, tau, since, state, lanes, work):
    """
    Add the work of torques that were held since a state.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    tau : ndarray, shape (lanes * nv,)
        [N m, N].
    since, state : ndarray, shape (lanes * ns,)
        Then and now.
    lanes : int
        As for ``rates_of_coordinates``.
    work : ndarray, shape (lanes,)
        Added to [J].

    """
    if manifold is None:
        for i in range(tau.shape[0]):
            work[i % lanes] += tau[i] * (state[i] - since[i])
    else:
        for lane in range(lanes):
            work[lane] += _work(manifold, tau, since, state, lanes, lane)


@compiled
def move_lane(manifold, q, change, share, lanes, lane):
    """
    Do as ``move`` does, where there are quaternions, in one lane.

    Parameters
    ----------
    manifold, q, change, share, lanes
        As for ``move``.
    lane : int
        Which.

    """
    for i in range(manifold.place.shape[0]):
        if manifold.place[i] >= 0:
            q[lanes * manifold.place[i] + lane] += share * change[lanes * i + lane]
    for ball in range(manifold.balls.shape[0]):
        a = lanes * manifold.balls[ball, QUATERNION] + lane
        b = lanes * manifold.balls[ball, TURN] + lane
        half = HALF * share
        i, j, k = half * change[b], half * change[b + lanes], half * change[b + 2 * lanes]
        angle = math.sqrt(i * i + j * j + k * k)
        # Beyond the last digit the sine is the angle.
        sine = math.sin(angle) / angle if angle > 1e-9 else 1.0
        i, j, k, s = sine * i, sine * j, sine * k, math.cos(angle)
        x, y, z, w = q[a], q[a + lanes], q[a + 2 * lanes], q[a + 3 * lanes]
        q[a] = w * i + x * s + y * k - z * j
        q[a + lanes] = w * j + y * s + z * i - x * k
        q[a + 2 * lanes] = w * k + z * s + x * j - y * i
        q[a + 3 * lanes] = w * s - x * i - y * j - z * k
    _normalise(manifold, q, lanes, lane)


@inlined
def move(manifold, q, change, share, lanes):
    """
    Change coordinates, in place.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    q : ndarray, shape (lanes * nq,)
        Coordinates.
    change : ndarray, shape (lanes * nv,)
        As rates are.
    share : float
        How much of it is made; a step size, where the change is a rate.
    lanes : int
        As for ``rates_of_coordinates``.

    """
    if manifold is None:
        for i in range(q.shape[0]):
            q[i] += share * change[i]
    else:
        for lane in range(lanes):
            move_lane(manifold, q, change, share, lanes, lane)


@compiled
def _normalise(manifold, q, lanes, lane):
    """Do as ``normalise`` does, where there are quaternions, in one lane."""
    for ball in range(manifold.balls.shape[0]):
        a = lanes * manifold.balls[ball, QUATERNION] + lane
        b, c, d = a + lanes, a + 2 * lanes, a + 3 * lanes
        scale = 1.0 / math.sqrt(q[a] * q[a] + q[b] * q[b] + q[c] * q[c] + q[d] * q[d])
        q[a] *= scale
        q[b] *= scale
        q[c] *= scale
        q[d] *= scale


@inlined
def normalise(manifold, q, lanes):
    """
    Give the quaternions norm 1, in place.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    q : ndarray, shape (>= lanes * nq,)
        Coordinates, others behind them.
    lanes : int
        As for ``rates_of_coordinates``.

    """
    if manifold is not None:
        for lane in range(lanes):
            _normalise(manifold, q, lanes, lane)


@compiled
def fill_numbers(manifold, q):
    """
    Put the coordinate of each rate into ``number``; 0 for rates of rotations.

    Parameters
    ----------
    manifold : Manifold
        Of the mechanism.
    q : ndarray, shape (nq,)
        Coordinates.

    """
    for i in range(manifold.place.shape[0]):
        manifold.number[i] = q[manifold.place[i]] if manifold.place[i] >= 0 else 0.0


@compiled
def fill_quaternions(matrices, out):
    """
    Write the unit quaternions of rotation matrices.

    Parameters
    ----------
    matrices : ndarray, shape (n, 3, 3)
        Rotations.
    out : ndarray, shape (n, 4)
        x, y, z, w in place; w is not negative.

    """
    for n in range(matrices.shape[0]):
        one = matrices[n]
        # A multiple of q: the row of q q^T with the largest diagonal entry tells it best.
        xx, yy, zz = one[0, 0], one[1, 1], one[2, 2]
        x, y, z = one[2, 1] - one[1, 2], one[0, 2] - one[2, 0], one[1, 0] - one[0, 1]
        w = 1.0 + xx + yy + zz
        if w < 1.0:
            xy, xz, yz = one[0, 1] + one[1, 0], one[0, 2] + one[2, 0], one[1, 2] + one[2, 1]
            if xx >= yy and xx >= zz:
                x, y, z, w = 1.0 + xx - yy - zz, xy, xz, x
            elif yy >= zz:
                x, y, z, w = xy, 1.0 - xx + yy - zz, yz, y
            else:
                x, y, z, w = xz, yz, 1.0 - xx - yy + zz, z
        size = math.copysign(math.sqrt(x * x + y * y + z * z + w * w), w)
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = x / size, y / size, z / size, w / size


def weights(manifold, nv):
    """
    Return what a component's error stands for: 2 for those of quaternions, 1 for others.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    nv : int
        Number of rates.

    Returns
    -------
    ndarray, shape (nq,)

    """
    found = np.ones(nv if manifold is None else nv + len(manifold.balls))
    if manifold is not None:
        for first in manifold.balls[:, QUATERNION]:
            found[first:first + 4] = 1.0 / HALF
    return found
