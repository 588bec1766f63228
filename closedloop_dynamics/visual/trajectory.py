# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A motion that was simulated or recorded, and where it puts the bodies."""

from dataclasses import dataclass, fields

import numpy as np

from ..mechanism.couplings import in_tree, measured
from ..mechanism.cut_freedoms import cut_freedoms
from ..mechanism.mechanism import (
    CUT_WITH_ORIENTATION, CYLINDRICAL, DISTANCE, FIXED, FREE, GROUND, HELICAL, PLANAR,
    POINT_ON_LINE, POINT_ON_PLANE, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL, UNTURNED)
from ..mechanism.rotations import composed, CONJUGATE, rotated

_AXES = np.eye(3)
# Numbers of a pose in space: x, y, z, and a quaternion x, y, z, w.
POSE = 7
# Change of coordinates by which velocities are found, by central differences [s].
_INSTANT = 1e-6


@dataclass(frozen=True)
class Trajectory:
    """States of one mechanism at n instants."""

    mechanism: object  # Mechanism.mechanism.Mechanism
    time: np.ndarray  # Shape (n,) [s]
    # Shape (n, nq), (n, nv), (n, nv): of the joints, in the order of ``Mechanism.coordinates``
    # [rad or m, and per s; N m or N]; orientations are quaternions.
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    # Shape (n, number of cut joints, 3): moment [N m] and force [N] along x and y that body
    # B exerts on body A, in world axes. In space 6: moment and force along x, y and z.
    forces: np.ndarray

    def part(self, which):
        """Return some of its instants, chosen by a slice or an array of truth values."""
        return Trajectory(self.mechanism, *(
            getattr(self, each.name)[which] for each in fields(self)[1:]))


def wrench_parts(mechanism):
    """Return the names of a wrench's components in columns, moments first, in their order."""
    return ('torque', 'x', 'y') if mechanism.planar else (
        'torque_x', 'torque_y', 'torque_z', 'x', 'y', 'z')


def magnitudes(wrenches):
    """Return the magnitudes of the forces in wrenches of shape (..., 3), in space (..., 6)."""
    return np.linalg.norm(force_of(wrenches), axis=-1)


def force_of(wrenches):
    """Return the forces in wrenches, moments first, of shape (..., 3), in space (..., 6)."""
    return wrenches[..., wrenches.shape[-1] // 2:]


def from_rows(mechanism, names, rows):
    """Return the motion in rows of ``recording.run``."""
    column = dict(zip(names, np.array(rows, dtype=float).T))
    zero = np.zeros(len(rows))

    def joints(quantity):
        names = mechanism.coordinates.columns(quantity)
        return np.stack([column[name] for name in names], axis=1)

    parts = wrench_parts(mechanism)
    forces = [[column.get(f'force.{cut.name}.{part}', zero) for part in parts]
              for cut in mechanism.cut_joints]
    return Trajectory(
        mechanism, column['time'], joints('position'), joints('velocity'), joints('effort'),
        np.array(forces).reshape(len(forces), len(parts), len(rows)).transpose(2, 0, 1))


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
    moved = _child_pose if mechanism.planar else _child_pose_in_space
    placed = {GROUND: _ground(mechanism, position.shape[:-1])}

    def pose(body):
        if body not in placed:
            joint, coordinates = joints[body]
            placed[body] = moved(pose(joint.parent), joint, coordinates)
        return placed[body]

    if names is None:
        names = [body.name for body in mechanism.bodies]
    return np.stack([pose(name) for name in names], axis=-2)


def body_velocities(mechanism, position, rates, names):
    """
    Return how bodies move.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Whose bodies these are.
    position : ndarray, shape (nq,)
        Joint coordinates, as for ``body_poses``.
    rates : ndarray, shape (n, nv)
        Joint rates [rad/s or m/s], n times others.
    names : sequence of str
        Of the bodies.

    Returns
    -------
    ndarray, shape (n, number of names, 6)
        Velocity of the frame's origin [m/s] and angular velocity [rad/s], in world axes; to about
        1e-9 of their size.

    """
    moved = mechanism.coordinates.moved
    after, before = (body_poses(mechanism, np.array(
        [moved(position, step * rate) for rate in rates]), names)
        for step in (_INSTANT, -_INSTANT))
    found = np.zeros((len(rates), len(names), 6))
    if mechanism.planar:
        found[..., [0, 1, 5]] = (after - before) / (2.0 * _INSTANT)
        return found
    found[..., :3] = (after[..., :3] - before[..., :3]) / (2.0 * _INSTANT)
    turn = composed(after[..., 3:], before[..., 3:] * CONJUGATE)
    found[..., 3:] = turn[..., :3] * np.sign(turn[..., 3:]) / _INSTANT
    return found


def wrench_in_joints(mechanism, position, body, place, wrench):
    """
    Return the joint torques equivalent to a wrench on a body.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Of the body.
    position : ndarray, shape (nq,)
        Joint coordinates, as for ``body_poses``.
    body : str
        Its name.
    place : ndarray, shape (3,)
        That the force acts on, in the body's frame [m]; in the plane the last one is zero.
    wrench : ndarray, shape (6,)
        Force [N] and torque [N m] along the body's axes.

    Returns
    -------
    ndarray, shape (nv,)
        [N m or N].

    """
    names, carrying = mechanism.coordinates, {joint.child: joint for joint in mechanism.joints}
    places, link = [], body
    while link != GROUND:
        joint = carrying[link]
        places += range(*names.rates[joint.name].indices(names.nv))
        link = joint.parent
    torques, rates = np.zeros(names.nv), np.zeros((len(places), names.nv))
    rates[range(len(places)), places] = 1.0
    pose = poses_in_space(body_poses(mechanism, position, (body,))[0])
    arm, force, torque = (rotated(pose[3:], np.asarray(vector)) for vector in (
        place, wrench[:3], wrench[3:]))
    velocities = body_velocities(mechanism, position, rates, (body,))[:, 0]
    torques[places] = velocities @ np.concatenate([force, torque + np.cross(arm, force)])
    return torques


def _ground(mechanism, shape):
    """Return the pose of the ground, as often as a shape says."""
    return np.broadcast_to(
        np.zeros(3) if mechanism.planar else (0.0, 0.0, 0.0, *UNTURNED),
        (*shape, 3 if mechanism.planar else 7))


def _child_pose(parent, joint, coordinates):
    origin = world_points(parent, joint.position)
    angle = parent[..., 2] + joint.angle
    if joint.type == PRISMATIC:
        along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        origin = origin + coordinates * along
    else:
        angle = angle + coordinates[..., 0]
    return np.concatenate([origin, angle[..., np.newaxis]], axis=-1)


def _child_pose_in_space(parent, joint, coordinates):
    origin = world_points(parent, joint.position)
    turn = composed(parent[..., 3:], np.array(joint.orientation))
    axis = None if joint.axis is None else np.array(joint.axis) / np.linalg.norm(joint.axis)
    first, last = coordinates[..., :1], coordinates[..., -1:]
    if joint.type in (PRISMATIC, CYLINDRICAL):
        origin = origin + last * rotated(turn, axis)
    elif joint.type == HELICAL:
        origin = origin + joint.lead * first * rotated(turn, axis)
    elif joint.type == PLANAR:
        origin = origin + rotated(turn, coordinates * (1.0, 1.0, 0.0))
    elif joint.type == FREE:
        origin = origin + rotated(turn, coordinates[..., :3])
    if joint.type in (REVOLUTE, CYLINDRICAL, HELICAL, UNIVERSAL):
        turn = composed(turn, _turn_about(axis, first))
    if joint.type == UNIVERSAL:
        second = np.array(joint.second_axis) / np.linalg.norm(joint.second_axis)
        turn = composed(turn, _turn_about(second, last))
    elif joint.type == PLANAR:
        turn = composed(turn, _turn_about(_AXES[2], last))
    elif joint.type in (SPHERICAL, FREE):
        own = coordinates[..., -4:]
        turn = composed(turn, own / np.linalg.norm(own, axis=-1, keepdims=True))
    return np.concatenate([origin, turn], axis=-1)


def _turn_about(axis, angle):
    """Return the quaternions of turns [rad], shape (..., 1), about a unit axis."""
    return np.concatenate([np.sin(0.5 * angle) * axis, np.cos(0.5 * angle)], axis=-1)


def world_points(pose, points):
    """
    Move points of a body into the world.

    Parameters
    ----------
    pose : ndarray, shape (..., 3)
        x, y, angle of the body; in space (..., 7), x, y, z and quaternion.
    points : sequence, shape (2,) or (m, 2)
        In the body's frame [m]; in space of three numbers each.

    Returns
    -------
    ndarray, shape (..., 2) or (..., m, 2), in space (..., 3) or (..., m, 3)

    """
    points = np.asarray(points, dtype=float)
    if points.ndim == 2:
        pose = pose[..., np.newaxis, :]
    if pose.shape[-1] == 7:
        return pose[..., :3] + rotated(pose[..., 3:], points)
    cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    return np.stack([pose[..., 0] + cosine * points[..., 0] - sine * points[..., 1],
                     pose[..., 1] + sine * points[..., 0] + cosine * points[..., 1]], axis=-1)


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
    found = np.zeros((*poses.shape[:-1], POSE))
    found[..., :2] = poses[..., :2]
    found[..., 5], found[..., 6] = np.sin(0.5 * poses[..., 2]), np.cos(0.5 * poses[..., 2])
    return found


def pose_of(mechanism, poses, body):
    """Return the poses of one body, or of the ground, out of those of all."""
    if body == GROUND:
        return _ground(mechanism, poses.shape[:-2])
    return poses[..., [one.name for one in mechanism.bodies].index(body), :]


def closure_errors(mechanism, poses):
    """
    Return the errors of all closure equations, from the description alone.

    ``poses``: shape (..., nb, 3), in space (..., nb, 7); as ``body_poses`` returns them.

    Returns
    -------
    list of ndarray, shape (...)
        One for each equation [m or rad]; in space three for a direction that is kept, [m] or
        sines of angles.

    """
    errors = []
    of_cut = _planar_errors if mechanism.planar else _spatial_errors
    for cut in mechanism.cut_joints:
        pose_a, pose_b = (pose_of(mechanism, poses, body) for body in (cut.body_a, cut.body_b))
        gap = world_points(pose_a, cut.point_a) - world_points(pose_b, cut.point_b)
        errors += of_cut(cut, pose_a, pose_b, gap)
    return errors


def _planar_errors(cut, pose_a, pose_b, gap):
    errors = []
    if cut.type in (PRISMATIC, POINT_ON_LINE):
        axis = pose_b[..., 2] + cut.angle
        errors.append(gap[..., 1] * np.cos(axis) - gap[..., 0] * np.sin(axis))
    elif cut.type == DISTANCE:
        errors.append(np.hypot(gap[..., 0], gap[..., 1]) - cut.length)
    else:
        errors += [gap[..., 0], gap[..., 1]]
    if cut.type in (PRISMATIC, FIXED):
        errors.append(pose_a[..., 2] - pose_b[..., 2] - cut.angle)
    return errors


def _spatial_errors(cut, pose_a, pose_b, gap):
    along_a, along_b = (
        None if axis is None else rotated(pose[..., 3:], np.array(axis) / np.linalg.norm(axis))
        for pose, axis in ((pose_a, cut.axis_a), (pose_b, cut.axis_b)))
    vectors = []
    if cut.type in (PRISMATIC, CYLINDRICAL, HELICAL, POINT_ON_LINE):
        vectors.append(np.cross(gap, along_b))
    elif cut.type in (PLANAR, POINT_ON_PLANE):
        vectors.append(np.sum(gap * along_b, axis=-1, keepdims=True))
    elif cut.type == DISTANCE:
        vectors.append(np.linalg.norm(gap, axis=-1, keepdims=True) - cut.length)
    else:
        vectors.append(gap)
    if cut.type in CUT_WITH_ORIENTATION:
        # The turn that is left of body A's frame against where the joint holds it, or began.
        held = composed(pose_b[..., 3:], np.array(cut.orientation))
        left = composed(pose_a[..., 3:], held * CONJUGATE)
    if cut.type in (REVOLUTE, CYLINDRICAL, PLANAR):
        vectors.append(np.cross(along_a, along_b))
    elif cut.type == UNIVERSAL:
        vectors.append(np.sum(along_a * along_b, axis=-1, keepdims=True))
    elif cut.type in (PRISMATIC, FIXED):
        vectors.append(2.0 * left[..., 3:] * left[..., :3])
    elif cut.type == HELICAL:
        vectors.append(np.cross(rotated(left, along_b), along_b))
        angle = 2.0 * np.arctan2(np.sum(left[..., :3] * along_b, axis=-1), left[..., 3])
        # As many turns as there are between the two is not given by where bodies are.
        turned = np.sum(gap * along_b, axis=-1) / cut.lead - angle
        vectors.append(cut.lead * ((turned + np.pi) % (2.0 * np.pi) - np.pi)[..., np.newaxis])
    return [vector[..., k] for vector in vectors for k in range(vector.shape[-1])]


def closure(mechanism, position):
    """Return the largest closure error [m or rad], shape (n,), of positions, shape (n, nv)."""
    poses = body_poses(mechanism, position)
    return np.max(np.abs([np.zeros(len(poses)), *closure_errors(mechanism, poses),
                          *coupling_errors(mechanism, position)]), axis=0)


def coupling_errors(mechanism, position):
    """Return the errors of couplings, a list of shapes (...), of positions, shape (..., nq)."""
    places, errors = mechanism.coordinates.coordinates, []
    for coupling in mechanism.couplings:
        factors, offset = in_tree(mechanism, coupling)
        error = sum((factor * position[..., places[joint].start]
                     for joint, factor in factors.items()), np.zeros(position.shape[:-1])) - offset
        for cut in measured(mechanism, coupling):
            error = error + _cut_part(mechanism, cut, coupling.joints[cut.name], error, position)
        errors.append(error)
    return errors


def _cut_part(mechanism, cut, factor, others, position):
    """Return the part of a cut joint in a coupling's sum, beside those of all other joints."""
    poses = body_poses(mechanism, position)
    pose_a, pose_b = (pose_of(mechanism, poses, body) for body in (cut.body_a, cut.body_b))
    gap = world_points(pose_a, cut.point_a) - world_points(pose_b, cut.point_b)
    if mechanism.planar:
        angle = pose_b[..., 2] + cut.angle
        return factor * (gap[..., 0] * np.cos(angle) + gap[..., 1] * np.sin(angle))
    if cut.type != REVOLUTE:
        axis = rotated(pose_b[..., 3:], np.array(cut.axis_b))
        return factor * np.sum(gap * axis, axis=-1) / (cut.lead if cut.type == HELICAL else 1.0)
    _, side, there = cut_freedoms(mechanism)[cut.name].turn
    side = rotated(pose_a[..., 3:], side)
    across = rotated(pose_b[..., 3:], np.cross(cut.axis_b, there))
    angle = np.arctan2(np.sum(side * across, axis=-1),
                       np.sum(side * rotated(pose_b[..., 3:], there), axis=-1))
    # As many turns as there are is not given by where bodies are.
    turns = np.round((others / factor + angle) / (2.0 * np.pi))
    return factor * (angle - 2.0 * np.pi * turns)
