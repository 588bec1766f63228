# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms as URDF, their loops as elements ``loop`` and ``constraint``."""

from xml.etree import ElementTree

import numpy as np

from .in_space import in_space, Z
from .model import GRAVITY, MOMENTS, NO_LIMIT
from .pose import Pose
from .writing import (
    Acting, chain, gravity_of, JOINT_EFFECTS, mimics_of, moments_of, numbers, pose_of,
    written)
from ..mechanism.mechanism import (
    CYLINDRICAL, FIXED, FREE, GROUND, HELICAL, MechanismError, PLANAR, PRISMATIC, REVOLUTE,
    SPHERICAL, UNIVERSAL)
from ..mechanism.rotations import angles_of, of_quaternion

# Attribute of an element dynamics by the type of effect that acts on a joint.
DYNAMICS = {'joint_damping': 'damping', 'joint_friction': 'friction'}


def urdf_with_loops(mechanism, effects=None, start=None, left_out=None, limits=None):
    """
    Return a mechanism as URDF, its loops as elements loop and constraint.

    Parameters
    ----------
    mechanism : Mechanism
        With cut joints of common types, and couplings of two joints.
    effects : dict of str to dict, optional
        Keys of effects, of which damping and friction of joints are written.
    start : ndarray, shape (nq,), optional
        Coordinates, for which URDF has no place.
    left_out : dict, optional
        Filled with the names of effects that are not written, or in part, as ``Acting.left``.
    limits : dict of str to tuple of 2, optional
        Least and largest coordinate of joints of one freedom, None where there is none.

    Returns
    -------
    str
        XML. The root link is the ground.

    Raises
    ------
    MechanismError
        Where URDF cannot say something.

    """
    mechanism = in_space(mechanism)
    robot = ElementTree.Element('robot', name=mechanism.name)
    ElementTree.SubElement(robot, 'link', name=GROUND)
    for body in mechanism.bodies:
        link = ElementTree.SubElement(robot, 'link', name=body.name)
        if not body.massless:
            inertial = ElementTree.SubElement(link, 'inertial')
            ElementTree.SubElement(inertial, 'origin', xyz=numbers(*body.center_of_mass))
            ElementTree.SubElement(inertial, 'mass', value=numbers(body.mass))
            ElementTree.SubElement(inertial, 'inertia', dict(zip(
                MOMENTS, map(numbers, moments_of(body)))))
    acting = Acting(mechanism, effects, lambda joint: chain(mechanism, joint, balls=False), limits)
    mimics = mimics_of(mechanism, 'URDF')
    for joint in mechanism.joints:
        parent, singles = joint.parent, chain(mechanism, joint, balls=False)
        for number, single in enumerate(singles):
            child = joint.child
            if number < len(singles) - 1:
                child = f'{joint.name}_link_{number + 1}'
                ElementTree.SubElement(robot, 'link', name=child)
            kind = {REVOLUTE: 'continuous', FREE: 'floating'}.get(single.type, single.type)
            if kind == 'continuous' and acting.limits(single.name):
                kind = 'revolute'
            element = ElementTree.SubElement(robot, 'joint', name=single.name, type=kind)
            ElementTree.SubElement(element, 'parent', link=parent)
            ElementTree.SubElement(element, 'child', link=child)
            if number == 0:
                _add_origin(element, pose_of(joint))
            if single.axis is not None:
                ElementTree.SubElement(element, 'axis', xyz=numbers(*single.axis))
            _add_dynamics(element, single, joint, acting, mimics)
            parent = child
    for cut in mechanism.cut_joints:
        _loop(mechanism, robot, cut)
    if left_out is not None:
        left_out.update(acting.left)
        if tuple(gravity_of(effects).tolist()) != GRAVITY:
            left_out['gravity'] = 'simulators of URDF take -9.81 m/s^2 along z'
    return written(robot)


def _add_dynamics(element, single, joint, acting, mimics):
    """Add limits that URDF asks for, what acts on a joint, and what it mimics."""
    if single.type in (REVOLUTE, PRISMATIC):
        torque, speed = acting.drive(single.name, speeds=True)
        limit = ElementTree.SubElement(
            element, 'limit', effort=numbers((torque or NO_LIMIT) if joint.actuated else 0.0),
            velocity=numbers(speed or NO_LIMIT))
        ends = acting.limits(single.name)
        if ends or single.type == PRISMATIC:
            for key, one in zip(('lower', 'upper'), ends or (-NO_LIMIT, NO_LIMIT)):
                limit.set(key, numbers(one))
    if single.type in (REVOLUTE, PRISMATIC):
        found = {kind: acting.each(single.name, kind) for kind in DYNAMICS}
        values = {DYNAMICS[kind]: numbers(keys[0][JOINT_EFFECTS[kind]])
                  for kind, keys in found.items() if keys}
        if values:
            ElementTree.SubElement(element, 'dynamics', values)
    if joint.type == HELICAL and single.type == PRISMATIC:
        ElementTree.SubElement(element, 'mimic', joint=joint.name,
                               multiplier=numbers(joint.lead))
    if single.name in mimics:
        other, factor, offset = mimics[single.name]
        ElementTree.SubElement(element, 'mimic', joint=other, multiplier=numbers(factor),
                               offset=numbers(offset))


def _loop(mechanism, robot, cut):
    """Add what closes a loop."""
    if cut.type == UNIVERSAL:
        element = ElementTree.SubElement(robot, 'constraint', name=cut.name, type=cut.type)
        for end, body, point, axis in (('parent', cut.body_a, cut.point_a, cut.axis_a),
                                       ('child', cut.body_b, cut.point_b, cut.axis_b)):
            ElementTree.SubElement(element, end, link=body)
            ElementTree.SubElement(element, f'{end}_origin', xyz=numbers(*point))
            ElementTree.SubElement(element, f'{end}_axis', xyz=numbers(*axis))
        return
    if cut.type not in (REVOLUTE, PRISMATIC, FIXED, SPHERICAL, CYLINDRICAL, PLANAR):
        raise MechanismError(
            f'{mechanism.name}: cut_joints.{cut.name}.type: expected one that URDF has a tag for, '
            f'got {cut.type!r}')
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
        _add_origin(end, Pose(frame, np.array(point)))
    if axis is not None:
        ElementTree.SubElement(element, 'axis', xyz=numbers(*axis))


def _along(axis):
    """Return a frame with an axis as its z."""
    axis = np.array(axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(axis, across), axis])


def _add_origin(element, pose):
    ElementTree.SubElement(element, 'origin', xyz=numbers(*pose.position),
                           rpy=numbers(*angles_of(pose.rotation)))
