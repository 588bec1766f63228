# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
States with orientations: quaternions among the coordinates, angular velocities among the rates.

A quaternion x, y, z, w turns the joint's frame into the child's; its rates are the angular
velocity about the child's axes, so that its derivative is half the quaternion times that. Changes
of coordinates have the length of the rates; a rotation is composed with the exponential of its
change. Where a mechanism has no such joint there is no table, and nothing of this is compiled.
"""

from typing import NamedTuple

import numpy as np

from .types import AXIS, BALL, COORDINATE, DOF, TYPE

# Columns of Manifold.balls.
QUATERNION, TURN = range(2)
# A rotation by d changes the components of a quaternion by d / 2.
HALF = 0.5


class Manifold(NamedTuple):
    """Where the quaternions are in a state."""

    balls: np.ndarray  # Int, shape (n, 2): First coordinate and first rate of each
    #: Int, shape (nv,): Coordinate of each rate; less than 0 for those of rotations.
    place: np.ndarray
    #: Shape (nv,): Scratch: the coordinate of each rate, 0 for those of rotations.
    number: np.ndarray


def manifold_of(model):
    """Return the table of a model's quaternions, None where there are none."""
    rows = model.tree[1:]
    turns = rows[:, TYPE] == BALL
    if not turns.any():
        return None
    place = np.full(len(rows), -1)
    place[rows[~turns, DOF]] = rows[~turns, COORDINATE]
    # The last of three rows, about the third axis, has all.
    last = rows[turns & (rows[:, AXIS] == 2)]
    balls = np.column_stack([last[:, COORDINATE], last[:, DOF] - 2])
    return Manifold(np.ascontiguousarray(balls), place, np.zeros(len(rows)))


def weights(manifold, nv):
    """Return the weights of errors by component, (nq,): 2 for those of quaternions, else 1."""
    found = np.ones(nv if manifold is None else nv + len(manifold.balls))
    if manifold is not None:
        for first in manifold.balls[:, QUATERNION]:
            found[first:first + 4] = 1.0 / HALF
    return found
