# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""A motion that was simulated or recorded, and where it puts the bodies."""

from dataclasses import dataclass

import numpy as np

from ..mechanism.mechanism import GROUND, PRISMATIC, REVOLUTE


@dataclass(frozen=True)
class Motion:
    """States of one mechanism at n instants."""

    mechanism: object  # Mechanism.mechanism.Mechanism
    time: np.ndarray  # Shape (n,) [s]
    # Shape (n, nv): of the joints in their order [rad or m, and per s; N m or N].
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    # Shape (n, number of cut joints, 3): moment [N m] and force [N] along x and y that body
    # B exerts on body A, in world axes. In space 6: moment and force along x, y and z.
    forces: np.ndarray


def wrench_parts(mechanism):
    """Return the names of a wrench's components in columns, moments first, in their order."""
    return ('torque', 'x', 'y') if mechanism.planar else (
        'torque_x', 'torque_y', 'torque_z', 'x', 'y', 'z')


def magnitudes(wrenches):
    """Return the magnitudes of the forces in wrenches of shape (..., 3), in space (..., 6)."""
    return np.linalg.norm(wrenches[..., wrenches.shape[-1] // 2:], axis=-1)


def from_rows(mechanism, names, rows):
    """Return the motion that the rows of ``studies.run`` tell."""
    column = dict(zip(names, np.array(rows, dtype=float).T))
    zero = np.zeros(len(rows))

    def joints(quantity):
        return np.stack([column[f'{quantity}.{name}'] for name in mechanism.joint_names], axis=1)

    parts = wrench_parts(mechanism)
    forces = [[column.get(f'force.{cut.name}.{part}', zero) for part in parts]
              for cut in mechanism.cut_joints]
    return Motion(
        mechanism, column['time'], joints('position'), joints('velocity'), joints('effort'),
        np.array(forces).reshape(len(forces), len(parts), len(rows)).transpose(2, 0, 1))


def body_poses(mechanism, position):
    """
    Place the bodies.

    ``position``: shape (..., nv); joint coordinates [rad or m].

    Returns
    -------
    ndarray, shape (..., nb, 3)
        x, y [m] and angle [rad] of each body, in the mechanism's order of bodies.

    """
    mechanism.require_planar('a picture')
    position = np.asarray(position, dtype=float)
    joints = {joint.child: (joint, position[..., index])
              for index, joint in enumerate(mechanism.joints)}
    placed = {GROUND: np.zeros((*position.shape[:-1], 3))}

    def pose(body):
        if body not in placed:
            joint, coordinate = joints[body]
            placed[body] = _child_pose(pose(joint.parent), joint, coordinate)
        return placed[body]

    return np.stack([pose(body.name) for body in mechanism.bodies], axis=-2)


def _child_pose(parent, joint, coordinate):
    origin = world_points(parent, joint.position)
    angle = parent[..., 2] + joint.angle
    if joint.type == PRISMATIC:
        along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        origin = origin + coordinate[..., np.newaxis] * along
    else:
        angle = angle + coordinate
    return np.concatenate([origin, angle[..., np.newaxis]], axis=-1)


def world_points(pose, points):
    """
    Move points of a body into the world.

    Parameters
    ----------
    pose : ndarray, shape (..., 3)
        x, y, angle of the body.
    points : sequence, shape (2,) or (m, 2)
        In the body's frame [m].

    Returns
    -------
    ndarray, shape (..., 2) or (..., m, 2)

    """
    points = np.asarray(points, dtype=float)
    if points.ndim == 2:
        pose = pose[..., np.newaxis, :]
    cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    return np.stack([pose[..., 0] + cosine * points[..., 0] - sine * points[..., 1],
                     pose[..., 1] + sine * points[..., 0] + cosine * points[..., 1]], axis=-1)


def named_point(mechanism, poses, name):
    """
    Return the places of a named point, shape (..., 2).

    ``poses``: shape (..., nb, 3); of the bodies.

    """
    point = next(point for point in mechanism.points if point.name == name)
    return world_points(pose_of(mechanism, poses, point.body), point.position)


def pose_of(mechanism, poses, body):
    """Return the poses of one body, or of the ground, out of those of all."""
    if body == GROUND:
        return np.zeros((*poses.shape[:-2], 3))
    return poses[..., [one.name for one in mechanism.bodies].index(body), :]


def closure_errors(mechanism, poses):
    """
    Return the errors of all closure equations, from the description alone.

    ``poses``: shape (..., nb, 3); as ``body_poses`` returns them.

    Returns
    -------
    list of ndarray, shape (...)
        One for each equation [m or rad].

    """
    errors = []
    for cut in mechanism.cut_joints:
        pose_a, pose_b = (pose_of(mechanism, poses, body) for body in (cut.body_a, cut.body_b))
        gap = world_points(pose_a, cut.point_a) - world_points(pose_b, cut.point_b)
        if cut.type == PRISMATIC:
            axis = pose_b[..., 2] + cut.angle
            errors.append(gap[..., 1] * np.cos(axis) - gap[..., 0] * np.sin(axis))
        else:
            errors += [gap[..., 0], gap[..., 1]]
        if cut.type != REVOLUTE:
            errors.append(pose_a[..., 2] - pose_b[..., 2] - cut.angle)
    return errors


def closure(mechanism, position):
    """Return the largest closure error [m or rad], shape (n,), of positions, shape (n, nv)."""
    poses = body_poses(mechanism, position)
    return np.max(np.abs([np.zeros(len(poses)), *closure_errors(mechanism, poses)]), axis=0)
