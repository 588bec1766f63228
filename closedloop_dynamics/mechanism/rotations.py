# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Rotations in space: matrices, unit quaternions x, y, z, w, and angles."""

import math

import numpy as np

from ..engine import native

CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])


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
    found, = quaternions_of(np.array([matrix]))
    return tuple((found + 0.0).tolist())


def quaternions_of(matrices):
    """Return the same of rotations, shape (n, 3, 3), as an array, shape (n, 4)."""
    found = np.empty((len(matrices), 4))
    native.fill_quaternions(np.ascontiguousarray(matrices), found)
    return found


def composed(first, second):
    """Return products of quaternions, shapes (..., 4): ``first`` after ``second``."""
    ax, ay, az, aw = (first[..., k] for k in range(4))
    bx, by, bz, bw = (second[..., k] for k in range(4))
    return np.moveaxis(np.array([
        aw * bx + ax * bw + ay * bz - az * by, aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx, aw * bw - ax * bx - ay * by - az * bz]), 0, -1)


def rotated(quaternion, vectors):
    """Return vectors, shape (..., 3), turned by unit quaternions, shape (..., 4)."""
    quaternion = np.asarray(quaternion)
    vector, scalar = quaternion[..., :3], quaternion[..., 3:]
    return vectors + 2.0 * np.cross(vector, np.cross(vector, vectors) + scalar * vectors)


def rotation_vector(quaternion):
    """Return axis times angle of a unit quaternion x, y, z, w, by less than half a turn [rad]."""
    *axis, w = quaternion if quaternion[3] >= 0.0 else -quaternion
    sine = np.linalg.norm(axis)
    return np.array(axis) * (2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 2.0)


def perpendicular(axis):
    """Return a unit vector, shape (3,), perpendicular to a vector."""
    found = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    return found / np.linalg.norm(found)
