# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Rotations: matrices, unit quaternions x, y, z, w, angles; in the plane angles alone."""

import math

import numpy as np

from ..engine import native

CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])


def direction(angle):
    """Return the x axis of the plane turned by angles [rad], shape (..., 2)."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def turned(angle, vectors):
    """Return vectors of the plane, shape (..., 2), turned by angles [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def in_three(vectors):
    """Return vectors of the plane as those in space, shape (..., 3); others as they are."""
    vectors = np.asarray(vectors, dtype=float)
    return vectors if vectors.shape[-1] == 3 else np.concatenate(
        [vectors, np.zeros((*vectors.shape[:-1], 1))], axis=-1)


def angle_of(matrix):
    """Return the angle of a turn about z [rad]."""
    return math.atan2(matrix[1, 0], matrix[0, 0])


def quaternion_about(axis, angle):
    """Return the quaternions of turns by angles [rad] about a unit vector, shape (..., 4)."""
    half = 0.5 * np.asarray(angle)[..., np.newaxis]
    return np.concatenate([np.sin(half) * axis, np.cos(half)], axis=-1)


def about_z(angle):
    """Return the quaternions of turns by angles [rad] in the plane, shape (..., 4)."""
    return quaternion_about((0.0, 0.0, 1.0), angle)


def about(axis, angle):
    """Return the rotation about a unit vector by an angle [rad], shape (3, 3)."""
    return of_quaternion(quaternion_about(axis, angle))


def quaternion_of_vector(vector):
    """Return the quaternions of axes times angles [rad], shape (..., 3)."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    share = 0.5 * np.sinc(0.5 * angle / np.pi)
    return np.concatenate([share * vector, np.cos(0.5 * angle)], axis=-1)


def quaternion_of_angles(roll, pitch, yaw):
    """Return the quaternion of turns about the fixed axes x, y, z in this order [rad]."""
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(angle / 2.0), math.cos(angle / 2.0)) for angle in (roll, pitch, yaw))
    return (sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy)


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


def cross(first, second):
    """Return cross products of vectors, shape (..., 3), in a third of the time of np.cross."""
    first, second = np.asarray(first), np.asarray(second)
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    x, y, z = second[..., 0], second[..., 1], second[..., 2]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def rotated(quaternion, vectors):
    """Return vectors, shape (..., 3), turned by unit quaternions, shape (..., 4)."""
    quaternion = np.asarray(quaternion)
    vector, scalar = quaternion[..., :3], quaternion[..., 3:]
    return vectors + 2.0 * cross(vector, cross(vector, vectors) + scalar * vectors)


def rotation_vector(quaternion):
    """Return axis times angle of a unit quaternion x, y, z, w, by less than half a turn [rad]."""
    *axis, w = quaternion if quaternion[3] >= 0.0 else -quaternion
    sine = np.linalg.norm(axis)
    return np.array(axis) * (2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 2.0)


def perpendicular(axis):
    """Return a unit vector, shape (3,), perpendicular to a vector."""
    found = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    return found / np.linalg.norm(found)
