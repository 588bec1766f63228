# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Places in the world and in the frames of bodies, while a machine stands in one position."""

import math

import numpy as np

from ..mechanism.fields import FieldError, shown
from ..mechanism.kinematics import body_poses, poses_in_space
from ..mechanism.mechanism import GROUND
from ..mechanism.rotations import of_quaternion


class BodyFrames:
    """Where bodies are at a position, shape (nq,); questions about others raise FieldError."""

    def __init__(self, mechanism, position):
        poses = poses_in_space(body_poses(mechanism, np.array(position)))
        self._poses = {GROUND: (np.zeros(3), np.eye(3))}
        self._size = 2 if mechanism.planar else 3
        for body, pose in zip(mechanism.bodies, poses):
            self._poses[body.name] = pose[:3], of_quaternion(pose[3:])

    def _of(self, body):
        if body not in self._poses:
            raise FieldError('a body', shown(body), path=('body',))
        return self._poses[body]

    def world(self, body, place):
        """Return a place of a body in the world, shape (3,) [m]."""
        origin, turn = self._of(body)
        return origin + turn @ [*place, 0.0][:3]

    def local(self, body, place):
        """Return a place in the world in the frame of a body, shape (2,) or (3,) [m]."""
        origin, turn = self._of(body)
        return (turn.T @ (np.array(place, dtype=float) - origin))[:self._size]

    def rounded(self, body, place):
        """Return the same as a list to be written."""
        return [round(one, 9) + 0.0 for one in self.local(body, place).tolist()]

    def turned_back(self, body, vector):
        """Return a vector in the frame of a body, shape (3,)."""
        return self._of(body)[1].T @ vector

    def angle(self, body):
        """Return how far a body is turned in the plane [rad]."""
        turn = self._of(body)[1]
        return math.atan2(turn[1, 0], turn[0, 0])

    def apart(self, a, b):
        """Return the distance of two places in the world [m]."""
        return math.dist(a[:self._size], b[:self._size])
