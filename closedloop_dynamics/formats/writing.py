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

"""
Mechanisms in MJCF and URDF: the same bodies, joints and loops for other programs.

A joint of several freedoms that a format does not have becomes several of one freedom, with links
without mass between them; they are called ``JOINT_1``, ``JOINT_2``. What a format cannot say
at all is refused.

"""

from dataclasses import replace
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from .pose import angles_of, of_quaternion, Pose, quaternion_of
from ..mechanism.couplings import in_tree
from ..mechanism.mechanism import (
    Body, Coupling, CutJoint, CYLINDRICAL, DISTANCE, FIXED, FREE, GROUND, HELICAL, Joint,
    MechanismError, PLANAR, Point, POINT_ON_LINE, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from ..mechanism.validation import checked

X, Y, Z = (tuple(axis) for axis in np.eye(3).tolist())
# Which way each effect on a joint is written: attribute of MJCF, and of dynamics in URDF.
JOINT_EFFECTS = {'joint_damping': ('coefficient', 'damping', 'damping'),
                 'joint_friction': ('coulomb', 'frictionloss', 'friction'),
                 'joint_spring': ('stiffness', 'stiffness', None)}


class _Single(NamedTuple):
    """A joint of one freedom, or a ball or nothing, of a chain that stands for a joint."""

    name: str
    type: str  # noqa: A003
    axis: tuple = None


def in_space(mechanism):
    """
    Return a planar mechanism as one in space: in the plane z = 0, with flat bodies.

    Parameters
    ----------
    mechanism : Mechanism
        One in space is returned as it is.

    Returns
    -------
    Mechanism

    """
    if not mechanism.planar:
        return mechanism

    def turned(angle):
        return (0.0, 0.0, float(np.sin(0.5 * angle)), float(np.cos(0.5 * angle)))

    bodies = [Body(body.name, body.mass, (*body.center_of_mass, 0.0), 0.0 if body.massless else (
        0.5 * body.inertia, 0.5 * body.inertia, body.inertia), body.massless)
        for body in mechanism.bodies]
    joints = [Joint(joint.name, joint.type, joint.parent, joint.child, (*joint.position, 0.0),
                    actuated=joint.actuated, orientation=turned(joint.angle),
                    axis=Z if joint.type == REVOLUTE else X) for joint in mechanism.joints]
    cuts = []
    for cut in mechanism.cut_joints:
        along = {'axis_b': (float(np.cos(cut.angle)), float(np.sin(cut.angle)), 0.0)}
        keys = {REVOLUTE: {'axis_a': Z, 'axis_b': Z}, FIXED: {'orientation': turned(cut.angle)},
                PRISMATIC: {'orientation': turned(cut.angle), **along}, POINT_ON_LINE: along,
                DISTANCE: {'length': cut.length}}[cut.type]
        cuts.append(CutJoint(cut.name, cut.type, cut.body_a, cut.body_b, (*cut.point_a, 0.0),
                             (*cut.point_b, 0.0), **keys))
    points = [Point(point.name, point.body, (*point.position, 0.0)) for point in mechanism.points]
    couplings = []
    for coupling in mechanism.couplings:
        factors, offset = in_tree(mechanism, coupling)
        couplings.append(Coupling(coupling.name, factors, offset))
    return checked(replace(
        mechanism, bodies=tuple(bodies), joints=tuple(joints), cut_joints=tuple(cuts),
        points=tuple(points), couplings=tuple(couplings), source=None))


def mjcf(mechanism, effects=None):
    """
    Return a mechanism as MJCF.

    Parameters
    ----------
    mechanism : Mechanism
        With cut joints that are spherical, revolute or fixed.
    effects : dict of str to dict, optional
        Keys of effects, of which gravity and those on joints are written.

    Returns
    -------
    str
        XML. Coordinates are those of the mechanism.

    Raises
    ------
    MechanismError
        Where MJCF cannot say something.

    """
    mechanism = in_space(mechanism)
    root = ElementTree.Element('mujoco', model=mechanism.name)
    ElementTree.SubElement(root, 'compiler', angle='radian')
    ElementTree.SubElement(root, 'option', gravity=_numbers(*_gravity(effects)))
    bodies = {GROUND: ElementTree.SubElement(root, 'worldbody')}
    sections = {tag: ElementTree.SubElement(root, tag)
                for tag in ('tendon', 'equality', 'actuator')}
    acting, carried = _acting(effects), _children(mechanism)
    waiting = [(joint, (), Pose(np.eye(3), np.zeros(3))) for joint in carried.get(GROUND, ())]
    records = {body.name: body for body in mechanism.bodies}
    while waiting:
        joint, before, place = waiting.pop(0)
        place = place @ _pose(joint)
        # Joints of a body without mass move with the body that it carries.
        singles = [(single, place) for single in _chain(mechanism, joint, balls=True)]
        if joint.type == HELICAL:
            _gear(sections, joint.name, {f'{joint.name}_slide': 1.0, joint.name: -joint.lead}, 0.0)
        singles, below = [*before, *singles], carried.get(joint.child, ())
        if records[joint.child].massless and joint.type != FIXED:
            ends = [cut.name for cut in mechanism.cut_joints
                    if joint.child in (cut.body_a, cut.body_b)]
            if len(below) != 1 or ends:
                raise MechanismError(
                    f'{mechanism.name}: bodies.{joint.child}: expected a mass, or one body that '
                    'it carries and no cut joint on it, to write MJCF')
            waiting.append((below[0], tuple(singles), place))
            continue
        parent = next(one.parent for one in mechanism.joints if one.name == (
            _first(mechanism, joint, len(before) > 0, records).name))
        _add_body(bodies, parent, records[joint.child], singles, place, acting)
        waiting += [(one, (), Pose(np.eye(3), np.zeros(3))) for one in below]
    for point in mechanism.points:
        ElementTree.SubElement(bodies[point.body], 'site', name=point.name,
                               pos=_numbers(*point.position))
    for cut in mechanism.cut_joints:
        _equalities(mechanism, cut, bodies, sections['equality'])
    for coupling in mechanism.couplings:
        _gear(sections, coupling.name, coupling.joints, coupling.offset)
    for joint in mechanism.joints:
        if joint.actuated:
            for single in _chain(mechanism, joint, balls=True):
                ElementTree.SubElement(sections['actuator'], 'motor', joint=single.name)
    for tag, section in sections.items():
        if not len(section):
            root.remove(section)
    return _written(root)


def _first(mechanism, joint, several, records):
    """Return the first joint of a chain through bodies without mass that ends in a joint."""
    above = {one.child: one for one in mechanism.joints}
    while several and joint.parent in above and records[joint.parent].massless and (
            above[joint.parent].type != FIXED):
        joint = above[joint.parent]
    return joint


def _add_body(bodies, parent, body, singles, place, acting):
    """Add a body with the joints before it, which are given in frames along the way."""
    element = ElementTree.SubElement(
        bodies[parent], 'body', name=body.name, pos=_numbers(*place.position),
        quat=_quaternion(place.rotation))
    bodies[body.name] = element
    if not body.massless:
        xx, yy, zz, xy, xz, yz = _moments(body)
        ElementTree.SubElement(
            element, 'inertial', pos=_numbers(*body.center_of_mass), mass=_numbers(body.mass),
            fullinertia=_numbers(xx, yy, zz, xy, xz, yz))
    for single, at in singles:
        there = place.inverse @ at
        added = ElementTree.SubElement(
            element, 'joint', name=single.name, pos=_numbers(*there.position),
            type={REVOLUTE: 'hinge', PRISMATIC: 'slide', SPHERICAL: 'ball'}[single.type])
        if single.axis is not None:
            added.set('axis', _numbers(*(there.rotation @ single.axis)))
        for kind, values in acting.get(single.name, {}).items():
            key, attribute, _ = JOINT_EFFECTS[kind]
            added.set(attribute, _numbers(values[key]))
            if values.get('rest'):
                added.set('springref', _numbers(values['rest']))


def _equalities(mechanism, cut, bodies, section):
    """Add what closes a loop."""
    if cut.type not in (SPHERICAL, REVOLUTE, FIXED):
        raise MechanismError(
            f'{mechanism.name}: cut_joints.{cut.name}.type: expected spherical, revolute or fixed '
            f'to write MJCF, got {cut.type!r} (cut the loop at another joint)')
    # A hinge is a ball at each of two points of its axis.
    for number, along in enumerate((0.0, 0.1) if cut.type == REVOLUTE else (0.0,)):
        name = f'{cut.name}_{number + 1}' if cut.type == REVOLUTE else cut.name
        held = of_quaternion(cut.orientation).T if cut.type == FIXED else np.eye(3)
        for body, point, axis, end, turn in (
                (cut.body_a, cut.point_a, cut.axis_a, 'a', held),
                (cut.body_b, cut.point_b, cut.axis_b, 'b', np.eye(3))):
            place = np.array(point) + (along * np.array(axis) if along else 0.0)
            ElementTree.SubElement(bodies[body], 'site', name=f'{name}_{end}',
                                   pos=_numbers(*place), quat=_quaternion(turn))
        ElementTree.SubElement(section, 'weld' if cut.type == FIXED else 'connect', name=name,
                               site1=f'{name}_a', site2=f'{name}_b')


def _gear(sections, name, factors, offset):
    """Add a linear equation between joints."""
    tendon = ElementTree.SubElement(sections['tendon'], 'fixed', name=f'{name}_sum')
    for joint, factor in factors.items():
        ElementTree.SubElement(tendon, 'joint', joint=joint, coef=_numbers(factor))
    ElementTree.SubElement(sections['equality'], 'tendon', name=f'{name}_held',
                           tendon1=f'{name}_sum', polycoef=_numbers(offset, 0, 0, 0, 0))


def urdf_with_loops(mechanism, effects=None):
    """
    Return a mechanism as URDF, its loops as elements loop and constraint.

    Parameters
    ----------
    mechanism : Mechanism
        With cut joints of common types, and couplings of two joints.
    effects : dict of str to dict, optional
        Keys of effects, of which damping and friction of joints are written.

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
            ElementTree.SubElement(inertial, 'origin', xyz=_numbers(*body.center_of_mass))
            ElementTree.SubElement(inertial, 'mass', value=_numbers(body.mass))
            ElementTree.SubElement(inertial, 'inertia', dict(zip(
                ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz'), map(_numbers, _moments(body)))))
    mimics, acting = _mimics(mechanism), _acting(effects)
    for joint in mechanism.joints:
        parent, singles = joint.parent, _chain(mechanism, joint, balls=False)
        for number, single in enumerate(singles):
            child = joint.child
            if number < len(singles) - 1:
                child = f'{joint.name}_link_{number + 1}'
                ElementTree.SubElement(robot, 'link', name=child)
            kind = {REVOLUTE: 'continuous', FREE: 'floating'}.get(single.type, single.type)
            element = ElementTree.SubElement(robot, 'joint', name=single.name, type=kind)
            ElementTree.SubElement(element, 'parent', link=parent)
            ElementTree.SubElement(element, 'child', link=child)
            if number == 0:
                _origin(element, 'origin', _pose(joint))
            if single.axis is not None:
                ElementTree.SubElement(element, 'axis', xyz=_numbers(*single.axis))
            _add_dynamics(element, single, joint, acting, mimics)
            parent = child
    for cut in mechanism.cut_joints:
        _loop(mechanism, robot, cut)
    return _written(robot)


def _add_dynamics(element, single, joint, acting, mimics):
    """Add limits that URDF asks for, what acts on a joint, and what it mimics."""
    if single.type in (REVOLUTE, PRISMATIC):
        limit = ElementTree.SubElement(element, 'limit', effort='1e9' if joint.actuated else '0',
                                       velocity='1e9')
        if single.type == PRISMATIC:
            limit.set('lower', '-1e9')
            limit.set('upper', '1e9')
    values = {JOINT_EFFECTS[kind][2]: keys[JOINT_EFFECTS[kind][0]]
              for kind, keys in acting.get(single.name, {}).items() if JOINT_EFFECTS[kind][2]}
    if values:
        ElementTree.SubElement(
            element, 'dynamics', {key: _numbers(value) for key, value in values.items()})
    if joint.type == HELICAL and single.type == PRISMATIC:
        ElementTree.SubElement(element, 'mimic', joint=joint.name,
                               multiplier=_numbers(joint.lead))
    if single.name in mimics:
        other, factor, offset = mimics[single.name]
        ElementTree.SubElement(element, 'mimic', joint=other, multiplier=_numbers(factor),
                               offset=_numbers(offset))


def _mimics(mechanism):
    """Return by joint the other one that it mimics, the factor and the offset."""
    found = {}
    for coupling in mechanism.couplings:
        names = [name for name in coupling.joints if name not in found]
        if len(coupling.joints) != 2 or not names:
            raise MechanismError(
                f'{mechanism.name}: couplings.{coupling.name}: expected two joints, one of which '
                'follows from no other coupling, to write URDF')
        name = names[0]
        other, = (one for one in coupling.joints if one != name)
        factor = coupling.joints[name]
        found[name] = other, -coupling.joints[other] / factor, coupling.offset / factor
    return found


def _loop(mechanism, robot, cut):
    """Add what closes a loop."""
    if cut.type == UNIVERSAL:
        element = ElementTree.SubElement(robot, 'constraint', name=cut.name, type=cut.type)
        for end, body, point, axis in (('parent', cut.body_a, cut.point_a, cut.axis_a),
                                       ('child', cut.body_b, cut.point_b, cut.axis_b)):
            ElementTree.SubElement(element, end, link=body)
            ElementTree.SubElement(element, f'{end}_origin', xyz=_numbers(*point))
            ElementTree.SubElement(element, f'{end}_axis', xyz=_numbers(*axis))
        return
    if cut.type not in (REVOLUTE, PRISMATIC, FIXED, SPHERICAL, CYLINDRICAL, PLANAR):
        raise MechanismError(
            f'{mechanism.name}: cut_joints.{cut.name}.type: expected one that URDF has a tag for, '
            f'got {cut.type!r}')
    if cut.type in (FIXED, PRISMATIC):
        frame_b = np.eye(3)
        frame_a = of_quaternion(cut.orientation).T
        axis = cut.axis_b
    elif cut.type == SPHERICAL:
        frame_a = frame_b = np.eye(3)
        axis = None
    else:
        frame_a, frame_b, axis = _along(cut.axis_a), _along(cut.axis_b), Z
    element = ElementTree.SubElement(robot, 'loop', name=cut.name, type=cut.type)
    for tag, body, point, frame in (('predecessor', cut.body_a, cut.point_a, frame_a),
                                    ('successor', cut.body_b, cut.point_b, frame_b)):
        end = ElementTree.SubElement(element, tag, link=body)
        _origin(end, 'origin', Pose(frame, np.array(point)))
    if axis is not None:
        ElementTree.SubElement(element, 'axis', xyz=_numbers(*axis))


def _chain(mechanism, joint, balls):
    """Return the joints of one freedom, or balls where a format has them, that are a joint."""
    slides = [(PRISMATIC, axis) for axis in (X, Y, Z)]
    ball = [(SPHERICAL, None)] if balls else [(REVOLUTE, axis) for axis in (X, Y, Z)]
    kinds = {
        REVOLUTE: [(REVOLUTE, joint.axis)], PRISMATIC: [(PRISMATIC, joint.axis)],
        UNIVERSAL: [(REVOLUTE, joint.axis), (REVOLUTE, joint.second_axis)],
        CYLINDRICAL: [(REVOLUTE, joint.axis), (PRISMATIC, joint.axis)],
        HELICAL: [(REVOLUTE, joint.axis), (PRISMATIC, joint.axis)],
        PLANAR: [*slides[:2], (REVOLUTE, Z)], SPHERICAL: ball, FREE: [*slides, *ball],
        FIXED: [] if balls else [(FIXED, None)]}[joint.type]
    if joint.type == FREE and not balls:
        kinds = [(FREE, None)]
    if joint.type == HELICAL:
        names = [joint.name, f'{joint.name}_slide']
    elif len(kinds) == 1:
        names = [joint.name]
    else:
        names = [f'{joint.name}_{number + 1}' for number in range(len(kinds))]
    taken = {other.name for other in mechanism.joints if other is not joint}
    for name in names:
        if name in taken:
            raise MechanismError(f'{mechanism.name}: joints.{name}: expected another name, this '
                                 f'one is needed for a part of {joint.name}')
    return [_Single(name, *kind) for name, kind in zip(names, kinds)]


def _children(mechanism):
    found = {}
    for joint in mechanism.joints:
        found.setdefault(joint.parent, []).append(joint)
    return found


def _acting(effects):
    """Return the effects on joints that formats know, by joint and type."""
    found = {}
    for values in (effects or {}).values():
        if values['type'] in JOINT_EFFECTS:
            found.setdefault(values['joint'], {})[values['type']] = values
    return found


def _gravity(effects):
    total = np.zeros(3)
    for values in (effects or {}).values():
        if values['type'] == 'gravity':
            total[:len(values['acceleration'])] += values['acceleration']
    return total


def _along(axis):
    """Return a frame with an axis as its z."""
    axis = np.array(axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(axis, across), axis])


def _pose(joint):
    return Pose(of_quaternion(joint.orientation), np.array(joint.position, dtype=float))


def _origin(element, tag, pose):
    roll, pitch, yaw = angles_of(pose.rotation)
    ElementTree.SubElement(element, tag, xyz=_numbers(*pose.position),
                           rpy=_numbers(roll, pitch, yaw))


def _moments(body):
    return (*body.inertia, 0.0, 0.0, 0.0)[:6]


def _quaternion(rotation):
    """Return a rotation as MuJoCo writes it, w first."""
    x, y, z, w = quaternion_of(rotation)
    return _numbers(w, x, y, z)


def _numbers(*values):
    """Write numbers with all their digits; whole ones without a point."""
    return ' '.join(repr(float(value)).removesuffix('.0') for value in values)


def _written(root):
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


WRITERS = {'.mjcf': mjcf, '.xml': mjcf, '.urdf': urdf_with_loops}
