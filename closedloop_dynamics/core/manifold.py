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


def number_of_coordinates(manifold, nv):
    """Return nq, of a table or None and the number of rates."""
    return nv if manifold is None else nv + len(manifold.balls)


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
def _rates(manifold, state, nv, out):
    """Do as ``rates_of_coordinates`` does, where there are quaternions."""
    nq = nv + manifold.balls.shape[0]
    for i in range(nv):
        if manifold.place[i] >= 0:
            out[manifold.place[i]] = state[nq + i]
    for ball in range(manifold.balls.shape[0]):
        a, b = manifold.balls[ball, QUATERNION], nq + manifold.balls[ball, TURN]
        x, y, z, w = state[a], state[a + 1], state[a + 2], state[a + 3]
        p, q, r = HALF * state[b], HALF * state[b + 1], HALF * state[b + 2]
        out[a] = w * p + y * r - z * q
        out[a + 1] = w * q + z * p - x * r
        out[a + 2] = w * r + x * q - y * p
        out[a + 3] = -(x * p + y * q + z * r)


@inlined
def rates_of_coordinates(manifold, state, nv, out):
    """
    Compute the derivatives of the coordinates.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    state : ndarray, shape (ns,)
        Coordinates, rates, others.
    nv : int
        Number of rates.
    out : ndarray, shape (ns,)
        The first nq are written.

    """
    if manifold is None:
        for i in range(nv):
            out[i] = state[nv + i]
    else:
        _rates(manifold, state, nv, out)


@compiled
def _move(manifold, q, change, share):
    """Do as ``move`` does, where there are quaternions."""
    for i in range(manifold.place.shape[0]):
        if manifold.place[i] >= 0:
            q[manifold.place[i]] += share * change[i]
    for ball in range(manifold.balls.shape[0]):
        a, b = manifold.balls[ball, QUATERNION], manifold.balls[ball, TURN]
        half = HALF * share
        p, q_, r = half * change[b], half * change[b + 1], half * change[b + 2]
        angle = math.sqrt(p * p + q_ * q_ + r * r)
        # Beyond the last digit the sine is the angle.
        sine = math.sin(angle) / angle if angle > 1e-9 else 1.0
        p, q_, r, s = sine * p, sine * q_, sine * r, math.cos(angle)
        x, y, z, w = q[a], q[a + 1], q[a + 2], q[a + 3]
        q[a] = w * p + x * s + y * r - z * q_
        q[a + 1] = w * q_ + y * s + z * p - x * r
        q[a + 2] = w * r + z * s + x * q_ - y * p
        q[a + 3] = w * s - x * p - y * q_ - z * r
    _normalise(manifold, q)


@inlined
def move(manifold, q, change, share):
    """
    Change coordinates, in place.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    q : ndarray, shape (nq,)
        Coordinates.
    change : ndarray, shape (nv,)
        As rates are.
    share : float
        How much of it is made; a step size, where the change is a rate.

    """
    if manifold is None:
        for i in range(q.shape[0]):
            q[i] += share * change[i]
    else:
        _move(manifold, q, change, share)


@compiled
def _normalise(manifold, q):
    """Do as ``normalise`` does, where there are quaternions."""
    for ball in range(manifold.balls.shape[0]):
        a = manifold.balls[ball, QUATERNION]
        scale = 1.0 / math.sqrt(
            q[a] * q[a] + q[a + 1] * q[a + 1] + q[a + 2] * q[a + 2] + q[a + 3] * q[a + 3])
        for k in range(4):
            q[a + k] *= scale


@inlined
def normalise(manifold, q):
    """
    Give the quaternions norm 1, in place.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism.
    q : ndarray, shape (>= nq,)
        Coordinates, others behind them.

    """
    if manifold is not None:
        _normalise(manifold, q)


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
    found = np.ones(number_of_coordinates(manifold, nv))
    if manifold is not None:
        for first in manifold.balls[:, QUATERNION]:
            found[first:first + 4] = 1.0 / HALF
    return found
