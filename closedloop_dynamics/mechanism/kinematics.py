# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Where bodies are and how they move, from the description alone.

A pose in the plane is x, y and angle, which counts turns; in space x, y, z and a unit quaternion
x, y, z, w.
"""

import numpy as np

from .mechanism import (
    CYLINDRICAL, FIXED, FREE, GROUND, HELICAL, PLANAR, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL,
    UNTURNED)
from .rotations import (
    about_z, composed, cross, in_three, quaternion_about, rotated, turned)

X, Y, Z = np.eye(3)
# Numbers of a pose in space.
POSE = 7


def steps_of(joint):
    """
    Return the turns and slides that a joint is made of, one after the other.

    Type (revolute, prismatic, helical or spherical), and axis in the frame before, shape (2,) for
    one that slides in the plane, else (3,); None of a spherical one. Each has one coordinate, a
    spherical one four.
    """
    if joint.axis is None and joint.type in (REVOLUTE, PRISMATIC):
        return [(REVOLUTE, Z) if joint.type == REVOLUTE else (PRISMATIC, X[:2])]
    slides, ball = [(PRISMATIC, axis) for axis in (X, Y, Z)], (SPHERICAL, None)
    axis, second = (None if one is None else np.array(one) / np.linalg.norm(one)
                    for one in (joint.axis, joint.second_axis))
    return {
        UNIVERSAL: [(REVOLUTE, axis), (REVOLUTE, second)],
        CYLINDRICAL: [(REVOLUTE, axis), (PRISMATIC, axis)],
        PLANAR: [*slides[:2], (REVOLUTE, Z)], SPHERICAL: [ball], FREE: [*slides, ball],
        FIXED: []}.get(joint.type, [(joint.type, axis)])


def body_poses(mechanism, position, names=None):
    """
    Place the bodies.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Whose bodies these are.
    position : array_like, shape (..., nv)
        Joint coordinates [rad or m]; in space (..., nq), joint after joint: of a spherical joint
        the quaternion x, y, z, w, of a free one x, y, z before it, of a planar one x, y and
        angle, of a cylindrical one angle and displacement.
    names : sequence of str, optional
        Of the bodies that are wanted; all in the mechanism's order when not given.

    Returns
    -------
    ndarray, shape (..., nb, 3)
        x, y [m] and angle [rad] of each body. In space
        (..., nb, 7): x, y, z [m] and the unit quaternion x, y, z, w.

    """
    position = np.asarray(position, dtype=float)
    joints = {joint.child: (joint, position[..., mechanism.coordinates.coordinates[joint.name]])
              for joint in mechanism.joints}
    placed = {GROUND: _ground(mechanism, position.shape[:-1])}

    def pose(body):
        if body not in placed:
            joint, coordinates = joints[body]
            placed[body] = moved_by(_joint_frame(pose(joint.parent), joint), joint, coordinates)
        return placed[body]

    if names is None:
        names = [body.name for body in mechanism.bodies]
    return np.stack([pose(name) for name in names], axis=-2)


def _joint_frame(parent, joint):
    """Return the poses of a joint's frame, of those of its parent."""
    turn = parent[..., 2:] + joint.angle if parent.shape[-1] != POSE else (
        composed(parent[..., 3:], np.array(joint.orientation)))
    return np.concatenate([place_on(parent, np.array(joint.position)), turn], axis=-1)


def moved_by(pose, joint, coordinates):
    """
    Return where a joint's child is, of the pose of the joint's frame, shape (..., 3) or (..., 7).

    ``coordinates`` are those of the joint in the last axis [rad or m], and quaternions of any
    length.
    """
    planar, place = pose.shape[-1] != POSE, 0
    origin, turn = (pose[..., :2], pose[..., 2:]) if planar else (pose[..., :3], pose[..., 3:])
    for kind, axis in steps_of(joint):
        if kind == SPHERICAL:
            own = coordinates[..., place:place + 4]
            turn = composed(turn, own / np.linalg.norm(own, axis=-1, keepdims=True))
            continue
        value = coordinates[..., place:place + 1]
        if kind in (PRISMATIC, HELICAL):
            along = turned(turn[..., 0], axis) if planar else rotated(turn, axis)
            origin = origin + (joint.lead * value if kind == HELICAL else value) * along
        if kind in (REVOLUTE, HELICAL):
            turn = turn + value if planar else composed(
                turn, quaternion_about(axis, value[..., 0]))
        place += 1
    return np.concatenate([origin, turn], axis=-1)


def motion_of(mechanism, position, velocity, body, place=(0.0, 0.0, 0.0)):
    """
    Return how a point of a body and the body move by the joint rates.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Whose body it is.
    position : array_like, shape (nq,)
        As for ``body_poses``.
    velocity : array_like, shape (nv,)
        Joint rates [rad/s or m/s].
    body : str
        Name of the body.
    place : array_like, shape (3,)
        Of the point, in the body's frame [m]; in the plane the last number is zero.

    Returns
    -------
    jacobian : ndarray, shape (6, nv)
        Velocity of the point and angular velocity, in world axes, by the joint rates.
    bias : ndarray, shape (6,)
        Their accelerations where the joint rates stay as they are [m/s^2, rad/s^2].

    """
    names, carrying = mechanism.coordinates, {joint.child: joint for joint in mechanism.joints}
    chain, link = [], body
    while link != GROUND:
        chain.insert(0, carrying[link])
        link = carrying[link].parent
    position, velocity = np.asarray(position, dtype=float), np.asarray(velocity, dtype=float)
    pose, parts = _ground(mechanism, ()), []
    # The part that has moved so far: spin and its rate, place and acceleration of a point of it.
    spin, spin_rate, point, acceleration = np.zeros((4, 3))
    for joint in chain:
        frame = _joint_frame(pose, joint)
        coordinates = position[names.coordinates[joint.name]]
        pose = moved_by(frame, joint, coordinates)
        origin, turn = np.split(poses_in_space(frame), [3])
        rate = names.rates[joint.name].start
        for kind, axis in steps_of(joint):
            count = 4 if kind == SPHERICAL else 1
            value, coordinates = coordinates[:count], coordinates[count:]
            if kind == SPHERICAL:
                turn = composed(turn, value / np.linalg.norm(value))
            axes = rotated(turn, np.eye(3)) if kind == SPHERICAL else rotated(
                turn, in_three(np.asarray(axis)))[np.newaxis]
            lead = {PRISMATIC: 1.0, HELICAL: joint.lead}.get(kind, 0.0)
            origin = origin + lead * value[0] * axes[0]
            arm = origin - point
            acceleration = acceleration + cross(spin_rate, arm) + cross(spin, cross(spin, arm))
            point, rates = origin, velocity[rate:rate + len(axes)]
            moving, turning = lead * axes, 0.0 * axes if kind == PRISMATIC else axes
            acceleration = acceleration + 2.0 * cross(spin, rates @ moving)
            spin_rate = spin_rate + cross(spin, rates @ turning)
            spin = spin + rates @ turning
            parts.append((rate, moving, turning, origin))
            rate += len(axes)
            if kind in (REVOLUTE, HELICAL):
                turn = composed(turn, quaternion_about(in_three(np.asarray(axis)), value[0]))
    origin, turn = np.split(poses_in_space(pose), [3])
    end = origin + rotated(turn, np.asarray(place))
    jacobian, arm = np.zeros((6, names.nv)), end - point
    for rate, moving, turning, origin in parts:
        jacobian[:3, rate:rate + len(moving)] = (moving + np.cross(turning, end - origin)).T
        jacobian[3:, rate:rate + len(moving)] = turning.T
    return jacobian, np.concatenate([
        acceleration + cross(spin_rate, arm) + cross(spin, cross(spin, arm)), spin_rate])


def body_velocities(mechanism, position, rates, names):
    """
    Return how bodies move, shape (n, number of names, 6).

    Velocity of the frame's origin [m/s] and angular velocity [rad/s], in world axes. ``position``
    is as for ``body_poses``, shape (nq,), ``rates`` are n times others, shape (n, nv) [rad/s or
    m/s].
    """
    rates = np.asarray(rates, dtype=float)
    return np.stack([rates @ motion_of(mechanism, position, np.zeros(
        mechanism.coordinates.nv), name)[0].T for name in names], axis=1)


def wrench_in_joints(mechanism, position, body, place, wrench):
    """
    Return the joint torques equivalent to a wrench on a body, shape (nv,) [N m or N].

    ``position`` is as for ``body_poses``, shape (nq,). The force acts on a ``place`` in the body's
    frame, shape (3,) [m], in the plane the last one zero; the wrench is force [N] and torque [N m]
    along the body's axes, shape (6,).
    """
    turn = poses_in_space(body_poses(mechanism, position, (body,))[0])[3:]
    jacobian, _ = motion_of(
        mechanism, position, np.zeros(mechanism.coordinates.nv), body, place)
    return jacobian.T @ np.concatenate(
        [rotated(turn, np.asarray(part)) for part in (wrench[:3], wrench[3:])])


def _ground(mechanism, shape):
    """Return the pose of the ground, as often as a shape says."""
    return np.broadcast_to(
        np.zeros(3) if mechanism.planar else (0.0, 0.0, 0.0, *UNTURNED),
        (*shape, 3 if mechanism.planar else POSE))


def world_points(pose, points):
    """
    Move points of a body, shape (2,) or (m, 2) in its frame, into the world [m].

    ``pose``, shape (..., 3): x, y, angle of the body; in space (..., 7), x, y, z and quaternion,
    and points of three numbers. Returns shape (..., 2) or (..., m, 2), in space (..., 3) or (...,
    m, 3).
    """
    points = np.asarray(points, dtype=float)
    return place_on(pose[..., np.newaxis, :] if points.ndim == 2 else pose, points)


def place_on(pose, points):
    """Return the same of one point for each pose, or of one for all, shape (..., 2) or (3,)."""
    if pose.shape[-1] == POSE:
        return pose[..., :3] + rotated(pose[..., 3:], points)
    return pose[..., :2] + turned(pose[..., 2], points)


def named_point(mechanism, poses, name):
    """
    Return the places of a named point, shape (..., 2), in space (..., 3).

    ``poses``: shape (..., nb, 3), in space (..., nb, 7); of the bodies.
    """
    point = mechanism.point(name)
    return world_points(pose_of(mechanism, poses, point.body), point.position)


def named_paths(mechanism, position):
    """Return the places of all named points, shape (n, 2) or (n, 3), of positions, (n, nq)."""
    poses = body_poses(mechanism, position)
    return {point.name: named_point(mechanism, poses, point.name)
            for point in mechanism.points}


def poses_in_space(poses):
    """Return poses of shape (..., 3), x, y and angle, or (..., 7) as they are, as (..., 7)."""
    if poses.shape[-1] == POSE:
        return poses
    return np.concatenate([in_three(poses[..., :2]), about_z(poses[..., 2])], axis=-1)


def pose_of(mechanism, poses, body):
    """Return the poses of one body, or of the ground, out of those of all."""
    if body == GROUND:
        return _ground(mechanism, poses.shape[:-2])
    return poses[..., [one.name for one in mechanism.bodies].index(body), :]
