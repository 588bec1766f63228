# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Places and turns of frames."""

import math
from typing import NamedTuple

import numpy as np


class Pose(NamedTuple):
    """
    Where one frame is in another.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Columns: the axes of the frame.
    position : ndarray, shape (3,)
        Of its origin [m].

    """

    rotation: np.ndarray
    position: np.ndarray

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


def unturned(position):
    """Return the pose of a frame that is at a place, its axes as those of the other."""
    return Pose(np.eye(3), np.array(position))


def about(axis, angle):
    """Return the rotation about a unit vector by an angle [rad], shape (3, 3)."""
    half = 0.5 * angle
    return of_quaternion((*(np.sin(half) * np.array(axis)), np.cos(half)))


def of_angles(angles):
    """Return the rotation (3, 3) of turns about the fixed axes x, y, z in this order [rad]."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle), math.cos(angle)) for angle in angles)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr]])


def angles_of(matrix):
    """
    Return roll, pitch and yaw of a rotation, shape (3, 3).

    They are turns about the fixed axes x, y and z, one after the other [rad].

    """
    (xx, xy, _), (yx, yy, _), (zx, zy, zz) = matrix.tolist()
    cosine = math.hypot(xx, yx)
    pitch = math.atan2(-zx, cosine)
    if cosine < 1e-9:
        # Roll and yaw are one turn.
        return 0.0, pitch, math.atan2(-xy, yy)
    return math.atan2(zy, zz), pitch, math.atan2(yx, xx)


def of_quaternion(quaternion):
    """Return the rotation, shape (3, 3), of a quaternion x, y, z, w of about norm 1."""
    x, y, z, w = np.asarray(quaternion, dtype=float) / np.linalg.norm(quaternion)
    return np.array([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)]])


def quaternion_of(matrix):
    """Return the unit quaternion x, y, z, w of a rotation, shape (3, 3); w is not negative."""
    # q q^T, of which the column with the largest diagonal entry tells q best.
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix
    outer = 0.25 * np.array([
        [1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
        [xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx],
        [xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy],
        [zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz]])
    column = outer[np.argmax(np.diag(outer))]
    found = column / np.copysign(np.linalg.norm(column), column[3])
    return tuple((found + 0.0).tolist())
