# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Loops as elements of URDF, in the forms that other programs read.

``constraint`` is proposed for URDF, ``loop`` is that of URDF+, ``drake`` are Drake's ball
constraints, ``gazebo`` are joints of SDF. Parsers of URDF pass over elements that they do not
know.
"""

from xml.etree import ElementTree

import numpy as np

from .in_space import Z
from .pose import Pose
from .sdf_writing import add_loop_joint, BALLS, balls, DRAKE, LOOP_JOINTS
from .writing import numbers
from ..mechanism.mechanism import (
    CYLINDRICAL, FIXED, MechanismError, PLANAR, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from ..mechanism.rotations import angles_of, of_quaternion

CONSTRAINT, LOOP, DRAKES, GAZEBO = 'constraint', 'loop', 'drake', 'gazebo'
_PAIRS = (REVOLUTE, PRISMATIC, FIXED, SPHERICAL, CYLINDRICAL, PLANAR)
# Cut joints that each form has a word for.
FORMS = {CONSTRAINT: (*_PAIRS, UNIVERSAL), LOOP: _PAIRS, DRAKES: BALLS, GAZEBO: LOOP_JOINTS}


def add_loops(robot, cuts, form, poses=None):
    """
    Add the elements that close loops to an element robot, in a form of FORMS.

    ``cuts`` are in space; their bodies, and the ground, are links of the same names. ``poses`` of
    these, each joint at zero, where the loops are closed, are for ``gazebo`` only, whose joints
    are drawn once. MechanismError where the form has no word for a cut joint.
    """
    if form == DRAKES and cuts:
        robot.set('xmlns:drake', DRAKE)
    for cut in cuts:
        if cut.type not in FORMS[form]:
            raise MechanismError(
                f'{robot.get("name")}: cut_joints.{cut.name}.type: expected one of '
                f'{", ".join(FORMS[form])}, as loops of the form {form} are, got {cut.type!r}')
        if form == CONSTRAINT:
            _add_constraint(robot, cut)
        elif form == LOOP:
            _add_loop(robot, cut)
        elif form == DRAKES:
            _add_balls(robot, cut)
        else:
            add_loop_joint(ElementTree.SubElement(robot, 'gazebo'), cut,
                           {body: body for body in (cut.body_a, cut.body_b)}, poses)


def _add_constraint(robot, cut):
    """Add two frames, and an axis in each."""
    element = ElementTree.SubElement(robot, 'constraint', name=cut.name, type=cut.type)
    turned = np.eye(3)
    axes = cut.axis_a, cut.axis_b
    if cut.type in (FIXED, PRISMATIC):
        turned, axes = of_quaternion(cut.orientation).T, (cut.axis_b, cut.axis_b)
    for end, body, point, frame, axis in (
            ('parent', cut.body_a, cut.point_a, turned, axes[0]),
            ('child', cut.body_b, cut.point_b, np.eye(3), axes[1])):
        ElementTree.SubElement(element, end, link=body)
        add_origin(element, Pose(frame, np.array(point)), f'{end}_origin')
        if cut.type not in (FIXED, SPHERICAL):
            ElementTree.SubElement(element, f'{end}_axis', xyz=numbers(*axis))


def _add_loop(robot, cut):
    """Add two frames that have the axis in common."""
    if cut.type in (FIXED, PRISMATIC):
        frame_a, frame_b, axis = of_quaternion(cut.orientation).T, np.eye(3), cut.axis_b
    elif cut.type == SPHERICAL:
        frame_a, frame_b, axis = np.eye(3), np.eye(3), None
    else:
        frame_a, frame_b, axis = _along(cut.axis_a), _along(cut.axis_b), Z
    element = ElementTree.SubElement(robot, 'loop', name=cut.name, type=cut.type)
    for tag, body, point, frame in (('predecessor', cut.body_a, cut.point_a, frame_a),
                                    ('successor', cut.body_b, cut.point_b, frame_b)):
        end = ElementTree.SubElement(element, tag, link=body)
        add_origin(end, Pose(frame, np.array(point)))
    if axis is not None:
        ElementTree.SubElement(element, 'axis', xyz=numbers(*axis))


def _along(axis):
    """Return a frame with an axis as its z."""
    axis = np.array(axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(axis, across), axis])


def _add_balls(robot, cut):
    for ends in balls(cut):
        element = ElementTree.SubElement(robot, 'drake:ball_constraint')
        for end, point, (body, place) in zip('AB', ('AP', 'BQ'), ends):
            ElementTree.SubElement(element, f'drake:ball_constraint_body_{end}', name=body)
            ElementTree.SubElement(
                element, f'drake:ball_constraint_p_{point}', value=numbers(*place))


def add_origin(element, pose, tag='origin'):
    """Add where a frame is, to an element of URDF."""
    ElementTree.SubElement(element, tag, xyz=numbers(*pose.position),
                           rpy=numbers(*angles_of(pose.rotation)))
