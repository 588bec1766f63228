# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
States with orientations: quaternions among the coordinates, angular velocities among the rates.

A quaternion x, y, z, w turns the joint's frame into the child's; its rates are the angular
velocity about the child's axes, so that its derivative is half the quaternion times that. Changes
of coordinates have the length of the rates; a rotation is composed with the exponential of its
change. Where a mechanism has no such joint there is no table, and nothing of this is compiled.
"""

import numpy as np

from .types import BALL, Handle, TYPE

# Columns of Manifold.balls.
QUATERNION, TURN = range(2)
# A rotation by d changes the components of a quaternion by d / 2.
HALF = 0.5


def manifold_of(model):
    """Return the places of a model's quaternions, None where there are none."""
    return Handle(model.manifold()) if (model.tree[:, TYPE] == BALL).any() else None


def weights(manifold, nv):
    """Return the weights of errors by component, (nq,): 2 for those of quaternions, else 1."""
    found = np.ones(nv if manifold is None else nv + len(manifold.balls))
    if manifold is not None:
        for first in manifold.balls[:, QUATERNION]:
            found[first:first + 4] = 1.0 / HALF
    return found
