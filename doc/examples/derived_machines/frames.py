# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Other frames for the bodies of a mechanism, in which all that belongs to them is given."""

from dataclasses import replace

from closedloop_dynamics.formats.pose import joint_frame
from closedloop_dynamics.mechanism.inertia import inertia_matrix, moments_in
from closedloop_dynamics.mechanism.mechanism import (
    CUT_WITH_ORIENTATION, DISTANCE, GROUND, MechanismError, POINT_ON_LINE, PRISMATIC, UNTURNED)
from closedloop_dynamics.mechanism.rotations import (
    angle_of, in_three, of_quaternion, quaternion_of)
import numpy as np

# Sine of an angle that is rounding.
ROUNDING = 1e-12


def moved_place(pose, place):
    """Return a place of 2 or 3 numbers in another frame; ``pose`` is that frame in its own."""
    found = pose.inverse.place(in_three(place))
    return tuple(found[:len(place)].tolist())


def moved_inertia(pose, inertia):
    """Return moments of inertia about a body's centre of mass along the axes of another frame."""
    if not isinstance(inertia, tuple):
        return inertia
    turned = pose.rotation.T @ inertia_matrix(inertia) @ pose.rotation
    return tuple(moments_in(turned).tolist())


def reframed(mechanism, frames):
    """
    Return a mechanism with other frames, and cut joints whose coordinates count from elsewhere.

    ``frames``, by body, the ground among them: the new frame in the old one. Joints whose child
    has a new frame stay as they are: their places in it are for the caller to find. MechanismError
    where a body that slides where a loop is cut would have its frame turned.
    """
    def place(body, values):
        return moved_place(frames[body], values) if body in frames else values

    bodies = tuple(_body(body, frames[body.name]) if body.name in frames else body
                   for body in mechanism.bodies)
    joints = tuple(_joint(joint, frames[joint.parent]) if joint.parent in frames else joint
                   for joint in mechanism.joints)
    cuts, recounted = [], []
    for cut in mechanism.cut_joints:
        if {cut.body_a, cut.body_b} & set(frames):
            if cut.type == POINT_ON_LINE if mechanism.planar else (
                    cut.type not in CUT_WITH_ORIENTATION and cut.orientation == UNTURNED):
                recounted.append(cut.name)
            cut = replace(_cut(cut, frames, mechanism.planar),
                          point_a=place(cut.body_a, cut.point_a),
                          point_b=place(cut.body_b, cut.point_b))
        cuts.append(cut)
    points = tuple(replace(point, position=place(point.body, point.position))
                   for point in mechanism.points)
    ground = mechanism.ground_visual
    if GROUND in frames:
        ground = tuple(_visual(visual, frames[GROUND]) for visual in ground)
    return replace(mechanism, bodies=bodies, joints=joints, cut_joints=tuple(cuts),
                   points=points, ground_visual=ground), tuple(recounted)


def _body(body, pose):
    return replace(
        body, center_of_mass=moved_place(pose, body.center_of_mass),
        inertia=moved_inertia(pose, body.inertia),
        visual=tuple(_visual(visual, pose) for visual in body.visual))


def _visual(visual, pose):
    return replace(visual, center=moved_place(pose, visual.center), orientation=quaternion_of(
        pose.rotation.T @ of_quaternion(visual.orientation)))


def _joint(joint, pose):
    """Return a joint in another frame of its parent."""
    moved = pose.inverse @ joint_frame(joint)
    if len(joint.position) == 2:
        return replace(joint, position=tuple(moved.position[:2].tolist()),
                       angle=joint.angle - angle_of(pose.rotation))
    return replace(joint, position=tuple(moved.position.tolist()),
                   orientation=quaternion_of(moved.rotation))


def _cut(cut, frames, planar):
    """Return a cut joint with its directions in other frames of its bodies."""
    turns = [frames[body].rotation if body in frames else np.eye(3)
             for body in (cut.body_a, cut.body_b)]
    if planar:
        if cut.type == PRISMATIC and abs(turns[0][1, 0]) > ROUNDING:
            raise MechanismError(
                f'cut_joints.{cut.name}: expected the frame of body_a, {cut.body_a}, along the '
                'slide: it would have to lie along another one, too')
        own = 0.0 if cut.type == POINT_ON_LINE else angle_of(turns[0])
        return cut if cut.type == DISTANCE else replace(
            cut, angle=cut.angle + own - angle_of(turns[1]))
    axes = {key: tuple((turn.T @ getattr(cut, key)).tolist())
            for key, turn in zip(('axis_a', 'axis_b'), turns) if getattr(cut, key) is not None}
    kept = cut.type in CUT_WITH_ORIENTATION or cut.orientation != UNTURNED
    return replace(cut, **axes, orientation=quaternion_of(
        turns[1].T @ of_quaternion(cut.orientation) @ turns[0]) if kept else UNTURNED)
