# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A twin of closure equations: how far loops and couplings are from closing."""

from closedloop_dynamics.mechanism.coupling_law import law_value
from closedloop_dynamics.mechanism.couplings import in_tree, measured
from closedloop_dynamics.mechanism.cut_freedoms import cut_freedoms
from closedloop_dynamics.mechanism.kinematics import body_poses, pose_of, world_points
from closedloop_dynamics.mechanism.mechanism import (
    CUT_WITH_ORIENTATION, CYLINDRICAL, DISTANCE, FIXED, HELICAL, PLANAR, POINT_ON_LINE,
    POINT_ON_PLANE, PRISMATIC, REVOLUTE, UNIVERSAL)
from closedloop_dynamics.mechanism.rotations import composed, CONJUGATE, direction, rotated
import numpy as np


def closure_errors(mechanism, poses):
    """
    Return the errors of all closure equations, from the description alone, shape (...) each.

    [m or rad]; in space three for a direction that is kept, [m] or sines of angles. ``poses``:
    shape (..., nb, 3), in space (..., nb, 7); as ``body_poses`` returns them.
    """
    errors = []
    parts_of = _planar_parts if mechanism.planar else _spatial_parts
    for cut in mechanism.cut_joints:
        pose_a, pose_b = (pose_of(mechanism, poses, body) for body in (cut.body_a, cut.body_b))
        gap = world_points(pose_a, cut.point_a) - world_points(pose_b, cut.point_b)
        errors += [vector[..., k] for vector in parts_of(cut, pose_a, pose_b, gap)
                   for k in range(vector.shape[-1])]
    return errors


def _planar_parts(cut, pose_a, pose_b, gap):
    parts = []
    if cut.type in (PRISMATIC, POINT_ON_LINE):
        along = direction(pose_b[..., 2] + cut.angle)
        parts.append((gap[..., 1] * along[..., 0] - gap[..., 0] * along[..., 1])[..., np.newaxis])
    elif cut.type == DISTANCE:
        parts.append((np.hypot(gap[..., 0], gap[..., 1]) - cut.length)[..., np.newaxis])
    else:
        parts.append(gap)
    if cut.type in (PRISMATIC, FIXED):
        parts.append((pose_a[..., 2] - pose_b[..., 2] - cut.angle)[..., np.newaxis])
    return parts


def _spatial_parts(cut, pose_a, pose_b, gap):
    along_a, along_b = (
        None if axis is None else rotated(pose[..., 3:], np.array(axis) / np.linalg.norm(axis))
        for pose, axis in ((pose_a, cut.axis_a), (pose_b, cut.axis_b)))
    parts = []
    if cut.type in (PRISMATIC, CYLINDRICAL, HELICAL, POINT_ON_LINE):
        parts.append(np.cross(gap, along_b))
    elif cut.type in (PLANAR, POINT_ON_PLANE):
        parts.append(np.sum(gap * along_b, axis=-1, keepdims=True))
    elif cut.type == DISTANCE:
        parts.append(np.linalg.norm(gap, axis=-1, keepdims=True) - cut.length)
    else:
        parts.append(gap)
    if cut.type in CUT_WITH_ORIENTATION:
        # The turn that is left of body A's frame against where the joint holds it, or began.
        held = composed(pose_b[..., 3:], np.array(cut.orientation))
        left = composed(pose_a[..., 3:], held * CONJUGATE)
    if cut.type in (REVOLUTE, CYLINDRICAL, PLANAR):
        parts.append(np.cross(along_a, along_b))
    elif cut.type == UNIVERSAL:
        parts.append(np.sum(along_a * along_b, axis=-1, keepdims=True))
    elif cut.type in (PRISMATIC, FIXED):
        parts.append(2.0 * left[..., 3:] * left[..., :3])
    elif cut.type == HELICAL:
        parts.append(np.cross(rotated(left, along_b), along_b))
        angle = 2.0 * np.arctan2(np.sum(left[..., :3] * along_b, axis=-1), left[..., 3])
        # As many turns as there are between the two is not given by where bodies are.
        turned = np.sum(gap * along_b, axis=-1) / cut.lead - angle
        parts.append(cut.lead * ((turned + np.pi) % (2.0 * np.pi) - np.pi)[..., np.newaxis])
    return parts


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
        if coupling.law is not None:
            error = error - law_value(
                coupling.law, position[..., places[coupling.law.joint].start])
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
        return factor * np.sum(gap * direction(pose_b[..., 2] + cut.angle), axis=-1)
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
