# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Places and turns of frames."""

from typing import NamedTuple

import numpy as np

from ..mechanism.kinematics import body_poses, poses_in_space
from ..mechanism.mechanism import GROUND
from ..mechanism.rotations import about, of_quaternion


class Pose(NamedTuple):
    """Where one frame is in another."""

    rotation: np.ndarray  # Shape (3, 3): Columns: the axes of the frame
    position: np.ndarray  # Shape (3,): Of its origin [m]

    def __matmul__(self, other):
        """Return the pose of a frame that is given in this one."""
        return Pose(self.rotation @ other.rotation, self.place(other.position))

    def place(self, point):
        """Return where a point of this frame is, shape (3,)."""
        return self.rotation @ point + self.position

    @property
    def inverse(self):
        """Return the pose of the other frame in this one."""
        return Pose(self.rotation.T, -(self.rotation.T @ self.position))


IDENTITY = Pose(np.eye(3), np.zeros(3))


def pose_from(numbers):
    """Return the pose of x, y, z [m] and a quaternion x, y, z, w."""
    return Pose(of_quaternion(numbers[3:]), np.array(numbers[:3]))


def poses_at(mechanism, position):
    """Return where bodies, the ground among them, are at a position, shape (nq,), by name."""
    names = [GROUND, *(body.name for body in mechanism.bodies)]
    return {name: pose_from(numbers) for name, numbers in zip(
        names, poses_in_space(body_poses(mechanism, position, names)))}


def joint_frame(joint):
    """Return where the frame that a joint moves its child in lies in the parent's frame."""
    if len(joint.position) == 2:
        return Pose(about((0.0, 0.0, 1.0), joint.angle), np.array([*joint.position, 0.0]))
    return Pose(of_quaternion(joint.orientation), np.array(joint.position, dtype=float))


def unturned(position):
    """Return the pose of a frame that is at a place, its axes as those of the other."""
    return Pose(np.eye(3), np.array(position))
