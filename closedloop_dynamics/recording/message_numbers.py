# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers in ROS messages, whichever library has decoded these; nothing of ROS is imported."""

NANOSECONDS = 10 ** 9


def stamp_of(message):
    """Return the stamp of a message with a header [ns]."""
    return nanoseconds(message.header.stamp)


def nanoseconds(time):
    """Return a Time or Duration [ns]."""
    return time.sec * NANOSECONDS + time.nanosec


def vector(message):
    """Return x, y and z of a Vector3, a Point or the like."""
    return message.x, message.y, message.z


def pose_numbers(transform):
    """Return the numbers of a Transform: x, y, z [m] and the quaternion x, y, z, w."""
    return (*vector(transform.translation), *vector(transform.rotation), transform.rotation.w)


def twist_numbers(message):
    """Return the numbers of a Twist: linear [m/s] and angular velocity [rad/s]."""
    return (*vector(message.linear), *vector(message.angular))


def wrench_numbers(message):
    """Return the numbers of a Wrench: force [N] and torque [N m]."""
    return (*vector(message.force), *vector(message.torque))


def constraint_force(message, planar):
    """Return a Wrench as motions have it, moments first: in the plane torque, x and y."""
    x, y, _, *torque = numbers = wrench_numbers(message)
    return (torque[2], x, y) if planar else (*torque, *numbers[:3])
