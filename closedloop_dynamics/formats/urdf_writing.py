# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms as URDF with their loop closures."""

from xml.etree import ElementTree

import numpy as np

from .in_space import in_space
from .model import GRAVITY, MOMENTS, NO_LIMIT
from .pose import IDENTITY, joint_frame, poses_at
from .urdf_loops import add_loops, add_origin, CONSTRAINT, GAZEBO
from .writing import (
    chain, counted_from, drawn, gravity_of, JOINT_EFFECTS, JointEffects, mimics_of, moments_of,
    moved, numbers, written)
from ..mechanism.coordinates import WITH_ORIENTATION
from ..mechanism.mechanism import FREE, GROUND, HELICAL, PRISMATIC, REVOLUTE

# Attribute of an element dynamics by the type of effect that acts on a joint.
DYNAMICS = {'joint_damping': 'damping', 'joint_friction': 'friction'}


def urdf_with_loops(mechanism, effects=None, start=None, left_out=None, limits=None,
                    loops=CONSTRAINT):
    """
    Return a mechanism as URDF with its loops.

    Parameters
    ----------
    mechanism : Mechanism
        With cut joints of common types, and couplings of two joints.
    effects : dict of str to dict, optional
        Keys of effects, of which damping and friction of joints are written.
    start : ndarray, shape (nq,), optional
        Coordinates that close the loops; zero if not given. URDF has no place for them: they are
        drawn where loops are of the form ``gazebo``, which count coordinates from there.
    left_out, limits
        As for ``mjcf_writing.mjcf``.
    loops : str
        How they are written: one of ``urdf_loops.FORMS``.

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
    places = mechanism.coordinates
    zero = places.start() if start is None or loops != GAZEBO else np.asarray(start, dtype=float)
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
    joint_effects = JointEffects(
        mechanism, effects, lambda joint: chain(mechanism, joint, balls=False), limits)
    mimics = mimics_of(counted_from(mechanism, zero), 'URDF')
    for joint in mechanism.joints:
        parent, singles = joint.parent, chain(mechanism, joint, balls=False)
        q = zero[places.coordinates[joint.name]]
        for number, (single, origin) in enumerate(zip(singles, _origins(joint, singles, q))):
            child = joint.child
            if number < len(singles) - 1:
                child = f'{joint.name}_link_{number + 1}'
                ElementTree.SubElement(robot, 'link', name=child)
            kind = {REVOLUTE: 'continuous', FREE: 'floating'}.get(single.type, single.type)
            if kind == 'continuous' and joint_effects.limits(single.name):
                kind = 'revolute'
            element = ElementTree.SubElement(robot, 'joint', name=single.name, type=kind)
            ElementTree.SubElement(element, 'parent', link=parent)
            ElementTree.SubElement(element, 'child', link=child)
            if origin is not IDENTITY:
                add_origin(element, origin)
            if single.axis is not None:
                ElementTree.SubElement(element, 'axis', xyz=numbers(*single.axis))
            _add_dynamics(
                element, single, joint, joint_effects, mimics, _counted(joint, q, number))
            parent = child
    add_loops(robot, mechanism.cut_joints, loops, poses_at(mechanism, zero))
    if left_out is not None:
        left_out.update(joint_effects.left)
        if tuple(gravity_of(effects).tolist()) != GRAVITY:
            left_out['gravity'] = 'simulators of URDF take -9.81 m/s^2 along z'
    return written(robot)


def _add_dynamics(element, single, joint, joint_effects, mimics, zero):
    """Add limits, counted from zero, effects on a joint, and the joint it mimics."""
    if single.type in (REVOLUTE, PRISMATIC):
        torque, speed = joint_effects.drive(single.name, speeds=True)
        limit = ElementTree.SubElement(
            element, 'limit', effort=numbers((torque or NO_LIMIT) if joint.actuated else 0.0),
            velocity=numbers(speed or NO_LIMIT))
        ends = joint_effects.limits(single.name)
        if ends or single.type == PRISMATIC:
            for key, one in zip(('lower', 'upper'), ends or (-NO_LIMIT, NO_LIMIT)):
                # Missing limits stay missing, wherever it is drawn.
                limit.set(key, numbers(one if abs(one) >= NO_LIMIT else one - zero))
    if single.type in (REVOLUTE, PRISMATIC):
        found = {kind: joint_effects.each(single.name, kind) for kind in DYNAMICS}
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


def _origins(joint, singles, q):
    """Return the poses of the single joints of a joint, drawn at its coordinates."""
    if joint.type in WITH_ORIENTATION:
        return [joint_frame(joint) @ moved(joint, q), *(IDENTITY for _ in singles[1:])]
    found = []
    for number, single in enumerate(singles):
        value = _counted(joint, q, number)
        before = IDENTITY if number else joint_frame(joint)
        if value:
            frame, child = drawn(single, joint, [value])
            before = before @ frame @ child
        found.append(before)
    return found


def _counted(joint, q, number):
    """Return the coordinate of a single joint at coordinates of its joint [rad or m]."""
    if joint.type in WITH_ORIENTATION or not len(q):
        return 0.0
    return joint.lead * q[0] if joint.type == HELICAL and number else q[number]
