# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Transmission angles: how a coupler pushes the link that a linkage drives."""

from typing import NamedTuple, Optional, Tuple

import numpy as np

from ..mechanism.kinematics import body_poses, pose_of, world_points
from ..mechanism.mechanism import (
    DISTANCE, GROUND, POINT_ON_LINE, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from ..mechanism.rotations import direction


class _Joint(NamedTuple):
    """A joint of the tree or where a loop is cut: its points in both bodies, and its axis."""

    name: str
    type: str  # noqa: A003
    ends: Tuple[Tuple[str, tuple], Tuple[str, tuple]]
    # Body and direction in its frame.
    axis: Optional[Tuple[str, tuple]]

    def end_in(self, body):
        """Return the point in a body, None where it is neither of its two."""
        return dict(self.ends).get(body)

    def other_than(self, body):
        return next(name for name, _ in self.ends if name != body)


def transmission_angle(mechanism, position, drive):
    """
    Return the transmission angle over a motion, shape (n,) [rad], at most pi / 2.

    A coupler between pins (balls or universal joints in space) leads from the driven link to one
    that turns or slides on the ground. The angle is a right one less that between the line
    through its pins and the way that its pin on that link can go: in a four-bar
    linkage, the angle between coupler and output link. In the plane a slot pushes, too, across
    its direction: a pin of one link in a slot of the other, or a block on a pin of the driven
    link. The least angle where several push; None where nothing of the kind does.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Any.
    position : ndarray, shape (n, nq)
        Joint coordinates.
    drive : str
        The driven joint.

    """
    found = [np.arctan2(np.abs(along), np.abs(across))
             for along, across in transmission_parts(mechanism, position, drive)]
    return np.min(found, axis=0) if found else None


def transmission_parts(mechanism, position, drive):
    """
    Return numerator and denominator of the tangent of each transmission angle, shape (n,).

    Of either sign: the coupler's part along the way that its pin can go, and across it. Smooth in
    the position, but for where a part is zero.
    """
    joints = list(_joints(mechanism))
    grounded = {joint.other_than(GROUND): joint for joint in joints
                if joint.type in (REVOLUTE, PRISMATIC) and joint.end_in(GROUND) is not None}
    driven = next((body for body, joint in grounded.items() if joint.name == drive), None)
    poses = body_poses(mechanism, position)

    def place(body, point):
        return world_points(pose_of(mechanism, poses, body), point)

    def heading(body, axis):
        return place(body, axis) - place(body, np.zeros(len(axis)))

    pushes = [(place(*end), place(*end) - place(*start), output)
              for start, end, output in _couplers(mechanism, joints, driven, grounded)]
    pushes += [(place(*tip), _across(heading(*slot)), output)
               for slot, tip, output in _slots(mechanism, joints, driven, grounded)]
    found = []
    for tip, line, output in pushes:
        joint, way = grounded[output], None
        if joint.axis is not None:
            way = heading(*joint.axis)
        if joint.type == REVOLUTE:
            arm = tip - place(GROUND, joint.end_in(GROUND))
            way = _across(arm) if mechanism.planar else np.cross(way, arm)
        along = (line * way).sum(axis=-1)
        across = (line * _across(way)).sum(axis=-1) if mechanism.planar else np.linalg.norm(
            np.cross(line, way), axis=-1)
        found.append((along, across))
    return found


def _across(vectors):
    """Return vectors in the plane, turned by a right angle."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def _joints(mechanism):
    for joint in mechanism.joints:
        # In the plane, a slider moves along the x axis of its own frame.
        axis = joint.axis if not mechanism.planar else (1.0, 0.0)
        yield _Joint(joint.name, joint.type, (
            (joint.parent, joint.position), (joint.child, (0.0,) * len(joint.position))),
            None if axis is None else (joint.child, axis))
    for cut in mechanism.cut_joints:
        axis = cut.axis_b if not mechanism.planar else direction(cut.angle)
        yield _Joint(cut.name, cut.type, (
            (cut.body_a, cut.point_a), (cut.body_b, cut.point_b)),
            None if axis is None else (cut.body_b, axis))


def _slots(mechanism, joints, driven, grounded):
    """
    Return slots by which the driven link pushes an output link, in the plane: across the slot.

    Yields the body that has the slot with the slot's direction, body and place of the pin or block
    in it, and the name of the output link.
    """
    for joint in joints if mechanism.planar else ():
        if joint.type == POINT_ON_LINE:
            bodies = dict(joint.ends)
            for output in set(bodies) & set(grounded) - {driven}:
                if driven in bodies:
                    yield joint.axis, joint.ends[0], output
        elif joint.type == PRISMATIC and GROUND not in dict(joint.ends):
            for block, place in _blocks(joint, joints, driven):
                output = joint.other_than(block)
                if output in grounded:
                    yield joint.axis, (block, place), output


def _blocks(slide, joints, driven):
    """Return the bodies of a slide that a pin joins to the driven link, with its place in them."""
    return [(joint.other_than(driven), joint.end_in(joint.other_than(driven)))
            for joint in joints if joint.type == REVOLUTE and joint.end_in(driven) is not None
            and slide.end_in(joint.other_than(driven)) is not None]


def _couplers(mechanism, joints, driven, grounded):
    """
    Return where couplers begin and end, on the driven link and on an output link.

    Yields body and point of either end, and the name of the output link.
    """
    pin_types = (REVOLUTE,) if mechanism.planar else (SPHERICAL, UNIVERSAL)
    for joint in joints:
        start = joint.end_in(driven)
        if start is None:
            continue
        other = joint.other_than(driven)
        if joint.type == DISTANCE and other in grounded:
            yield (driven, start), (other, joint.end_in(other)), other
        elif joint.type in pin_types and other not in (GROUND, *grounded):
            for pin in joints:
                if pin is not joint and pin.type in pin_types and (
                        pin.end_in(other) is not None and pin.other_than(other) in grounded):
                    output = pin.other_than(other)
                    if output != driven:
                        yield (driven, start), (output, pin.end_in(output)), output
