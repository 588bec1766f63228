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
Mechanisms in MJCF, URDF and SDF: the same bodies, joints and loops for other programs.

A joint of several freedoms that a format does not have becomes several of one freedom, with links
without mass between them; they are called ``JOINT_1``, ``JOINT_2``. What a format cannot say
at all is refused.

"""

from dataclasses import replace
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from .pose import angles_of, of_quaternion, Pose, quaternion_of
from ..mechanism.couplings import in_tree, measured
from ..mechanism.mechanism import (
    Body, Coupling, CutJoint, CYLINDRICAL, DISTANCE, FIXED, FREE, GROUND, HELICAL, Joint,
    JOINT_FREEDOMS, MechanismError, PLANAR, Point, POINT_ON_LINE, PRISMATIC, REVOLUTE, SPHERICAL,
    UNIVERSAL)
from ..mechanism.validation import checked

X, Y, Z = (tuple(axis) for axis in np.eye(3).tolist())
# Which way each effect on a joint is written: attribute of MJCF, and dynamics in URDF and in SDF.
JOINT_EFFECTS = {'joint_damping': ('coefficient', 'damping', 'damping', 'damping'),
                 'joint_friction': ('coulomb', 'frictionloss', 'friction', 'friction'),
                 'joint_spring': ('stiffness', 'stiffness', None, 'spring_stiffness')}
# What a driven joint is told by where it has no limit of its own [N m or N].
EFFORT = '1e9'
# SDF has no links without mass: theirs, in parts of the lightest body's.
LEAST_MASS = 1e-12


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
                             (*cut.point_b, 0.0), actuated=cut.actuated, **keys))
    points = [Point(point.name, point.body, (*point.position, 0.0)) for point in mechanism.points]
    couplings = []
    for coupling in mechanism.couplings:
        factors, offset = in_tree(mechanism, coupling)
        factors.update((cut.name, coupling.joints[cut.name])
                       for cut in measured(mechanism, coupling))
        couplings.append(Coupling(coupling.name, factors, offset))
    return checked(replace(
        mechanism, bodies=tuple(bodies), joints=tuple(joints), cut_joints=tuple(cuts),
        points=tuple(points), couplings=tuple(couplings), source=None))


def mjcf(mechanism, effects=None, start=None):
    """
    Return a mechanism as MJCF.

    Parameters
    ----------
    mechanism : Mechanism
        With cut joints that are spherical, revolute or fixed.
    effects : dict of str to dict, optional
        Keys of effects, of which gravity and those on joints are written.
    start : ndarray, shape (nq,), optional
        Coordinates, which become the key frame ``start``.

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
    acting, carried = _acting(mechanism, effects), _children(mechanism)
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
    if start is not None:
        _add_key_frame(root, mechanism, start)
    return _written(root)


def _add_key_frame(root, mechanism, start):
    """Add a position, its coordinates in the order in which MuJoCo has the joints."""
    values = {}
    for joint in mechanism.joints:
        some = np.asarray(start, dtype=float)[mechanism.coordinates.coordinates[joint.name]]
        if joint.type == HELICAL:
            some = np.array([some[0], joint.lead * some[0]])
        for single in _chain(mechanism, joint, balls=True):
            count = 4 if single.type == SPHERICAL else 1
            values[single.name] = np.roll(some[:count], 1) if count == 4 else some[:1]
            some = some[count:]
    order = [joint.get('name') for joint in root.find('worldbody').iter('joint')]
    frame = ElementTree.SubElement(root, 'keyframe')
    ElementTree.SubElement(frame, 'key', name='start',
                           qpos=_numbers(*(one for name in order for one in values[name])))


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
            key, attribute, *_ = JOINT_EFFECTS[kind]
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


def urdf_with_loops(mechanism, effects=None, start=None):
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
    acting, mimics = _acting(mechanism, effects), _mimics(mechanism, 'URDF')
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
        limit = ElementTree.SubElement(element, 'limit', effort=EFFORT if joint.actuated else '0',
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


def _mimics(mechanism, written):
    """Return by joint the other one that it mimics, the factor and the offset."""
    found = {}
    for coupling in mechanism.couplings:
        names = [name for name in coupling.joints if name not in found]
        if len(coupling.joints) != 2 or not names:
            raise MechanismError(
                f'{mechanism.name}: couplings.{coupling.name}: expected two joints, one of which '
                f'follows from no other coupling, to write {written}')
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


def sdf(mechanism, effects=None, start=None):
    """
    Return a mechanism as SDF: a world with a model whose joints form loops.

    SDF draws a machine once, with its loops closed, and counts coordinates from there.

    Parameters
    ----------
    mechanism : Mechanism
        With cut joints of types that SDF has, and couplings of two joints.
    effects : dict of str to dict, optional
        Keys of effects, of which gravity and those on joints are written.
    start : ndarray, shape (nq,), optional
        Coordinates of the position that is drawn, which closes the loops; zero if not given.

    Returns
    -------
    str
        XML. Coordinates of joints are those of the mechanism less those of the start.

    Raises
    ------
    MechanismError
        Where SDF cannot say something.

    """
    mechanism = in_space(mechanism)
    places = mechanism.coordinates
    start = places.start() if start is None else np.asarray(start, dtype=float)
    root = ElementTree.Element('sdf', version='1.11')
    world = ElementTree.SubElement(root, 'world', name=mechanism.name)
    ElementTree.SubElement(world, 'gravity').text = _numbers(*_gravity(effects))
    writer = _Sdf(mechanism, ElementTree.SubElement(world, 'model', name=mechanism.name),
                  _acting(mechanism, effects))
    zero = {joint.name: start[places.coordinates[joint.name]][0] for joint in mechanism.joints
            if JOINT_FREEDOMS[joint.type] == 1}
    shifted = replace(mechanism, couplings=tuple(replace(
        one, offset=one.offset - sum(factor * zero[name] for name, factor in one.joints.items()))
        for one in mechanism.couplings))
    writer.mimics = _mimics(shifted, 'SDF')
    for joint in mechanism.joints:
        writer.add_joint(joint, start[places.coordinates[joint.name]])
    for cut in mechanism.cut_joints:
        writer.add_loop(cut)
    for point in mechanism.points:
        frame = ElementTree.SubElement(writer.model, 'frame', name=writer.links[point.name],
                                       attached_to=writer.links[point.body])
        writer.add_pose(frame, Pose(np.eye(3), np.array(point.position)))
    return _written(root)


class _Sdf:
    """What is written into an element model, link by link and joint by joint."""

    def __init__(self, mechanism, model, acting):
        """Name the links, in SDF's one space of names for all, and write what they weigh."""
        self.mechanism, self.model, self.acting, self.mimics = mechanism, model, acting, {}
        taken = {one.name for one in (*mechanism.joints, *mechanism.cut_joints)} | {'world'}
        taken |= {single.name for joint in mechanism.joints
                  for single in self._singles(joint)}
        self.links, self.elements, self.poses = {GROUND: '__model__'}, {}, {GROUND: Pose(
            np.eye(3), np.zeros(3))}
        names = [one.name for one in (*mechanism.bodies, *mechanism.points)]
        for name in names:
            word = name
            while word in taken or (word != name and word in names):
                word += '_link'
            taken.add(word)
            self.links[name] = word
        self.taken = taken
        massive = [body for body in mechanism.bodies if not body.massless]
        self.least = LEAST_MASS * np.array([
            min((body.mass for body in massive), default=1.0),
            min((np.linalg.eigvalsh(_matrix(body))[-1] for body in massive), default=1.0)])
        for body in mechanism.bodies:
            self._add_link(body.name, body)

    def _add_link(self, name, body=None):
        """Add a link; one without mass gets next to nothing."""
        self.elements[name] = link = ElementTree.SubElement(
            self.model, 'link', name=self.links[name])
        mass, moment = self.least
        center, moments = np.zeros(3), (moment, moment, moment, 0.0, 0.0, 0.0)
        if body is not None and not body.massless:
            mass, center, moments = body.mass, body.center_of_mass, _moments(body)
        inertial = ElementTree.SubElement(link, 'inertial')
        self.add_pose(inertial, Pose(np.eye(3), np.array(center)))
        _text(inertial, 'mass', mass)
        inertia = ElementTree.SubElement(inertial, 'inertia')
        for tag, value in zip(('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz'), moments):
            _text(inertia, tag, value)

    def add_pose(self, element, pose, relative_to=None):
        """Add a pose, first of all children."""
        child = ElementTree.Element('pose')
        if relative_to:
            child.set('relative_to', relative_to)
        if np.array_equal(pose.rotation, np.eye(3)):
            child.text = _numbers(*pose.position, 0, 0, 0)
        else:
            child.set('rotation_format', 'quat_xyzw')
            child.text = _numbers(*pose.position, *quaternion_of(pose.rotation))
        element.insert(0, child)

    def _singles(self, joint):
        """Return the joints that SDF has for a joint; none for one that floats."""
        if joint.type == FREE and joint.parent == GROUND:
            return []
        if joint.type in (UNIVERSAL, HELICAL, FIXED):
            return [_Single(joint.name, joint.type, joint.axis)]
        return _chain(self.mechanism, joint, balls=True)

    def add_joint(self, joint, q):
        """Add a joint of the tree, drawn at its coordinates."""
        singles, place = self._singles(joint), _pose(joint)
        self.poses[joint.child] = self.poses[joint.parent] @ place @ _moved(joint, q)
        if not singles:
            if joint.actuated:
                raise self._error('joints', joint, 'actuated', 'false', 'true')
            self.add_pose(self.elements[joint.child], self.poses[joint.child])
            return
        parent = joint.parent
        for number, single in enumerate(singles):
            child = joint.child
            if number < len(singles) - 1:
                child = f'{joint.name}_link_{number + 1}'
                while child in self.taken:
                    child += '_'
                self.taken.add(child)
                self.links[child] = child
                self._add_link(child)
            count = {SPHERICAL: 4, UNIVERSAL: 2, FIXED: 0}.get(single.type, 1)
            element = self._joint(single.name, single.type, parent, child)
            before, after = _drawn(single, joint, q[:count])
            self.add_pose(element, place @ before, self.links[parent])
            self.add_pose(self.elements[child], after, single.name)
            self._add_axes(element, single, joint, q[:count])
            parent, place, q = child, Pose(np.eye(3), np.zeros(3)), q[count:]

    def _joint(self, name, kind, parent, child):
        """Add an element joint with its ends."""
        element = ElementTree.SubElement(
            self.model, 'joint', name=name,
            type={SPHERICAL: 'ball', HELICAL: 'screw'}.get(kind, kind))
        for tag, body in (('parent', parent), ('child', child)):
            ElementTree.SubElement(element, tag).text = (
                'world' if body == GROUND else self.links[body])
        return element

    def _add_axes(self, element, single, joint, q):
        """Add axes and lead, what acts along them, and that a joint is driven."""
        if joint.actuated and single.type == SPHERICAL:
            raise self._error('joints', joint, 'actuated', 'false', 'true')
        if joint.type == HELICAL:
            _text(element, 'screw_thread_pitch', 2.0 * np.pi * joint.lead)
        axes = [single.axis] if single.axis is not None else []
        if joint.type == UNIVERSAL:
            axes.append(joint.second_axis)
        for number, axis in enumerate(axes):
            child = _add_axis(element, number, axis)
            if joint.actuated:
                _text(ElementTree.SubElement(child, 'limit'), 'effort', EFFORT)
            dynamics = ElementTree.Element('dynamics')
            for kind, values in self.acting.get(single.name, {}).items():
                key, *_, tag = JOINT_EFFECTS[kind]
                if kind == 'joint_spring':
                    _text(dynamics, 'spring_reference', values.get('rest', 0.0) - q[0])
                _text(dynamics, tag, values[key])
            if len(dynamics):
                child.append(dynamics)
            if single.name in self.mimics:
                other, factor, offset = self.mimics[single.name]
                mimic = ElementTree.SubElement(child, 'mimic', joint=other, axis='axis')
                for tag, value in (('multiplier', factor), ('offset', offset), ('reference', 0)):
                    _text(mimic, tag, value)

    def add_loop(self, cut):
        """Add a joint that closes a loop, where its second body has it."""
        if cut.type not in (REVOLUTE, PRISMATIC, FIXED, SPHERICAL, UNIVERSAL, HELICAL):
            raise self._error('cut_joints', cut, 'type',
                              'a joint that SDF has, not cylindrical or planar,', repr(cut.type))
        # SDF has joints in the world only as parents.
        a, b = (cut.body_a, cut.point_a, cut.axis_a), (cut.body_b, cut.point_b, cut.axis_b)
        (parent, _, first), (child, point, second) = (a, b) if cut.body_b != GROUND else (b, a)
        element = self._joint(cut.name, cut.type, parent, child)
        self.add_pose(element, Pose(np.eye(3), np.array(point)), self.links[child])
        across = self.poses[child].rotation.T @ self.poses[parent].rotation
        if cut.type == UNIVERSAL:
            _add_axis(element, 0, across @ first)
            _add_axis(element, 1, second)
        elif cut.type not in (FIXED, SPHERICAL):
            axis = across @ first if second is None else second
            if cut.type == HELICAL:
                _text(element, 'screw_thread_pitch', 2.0 * np.pi * cut.lead)
            _add_axis(element, 0, axis)
        physics = ElementTree.SubElement(ElementTree.SubElement(element, 'physics'), 'simbody')
        _text(physics, 'must_be_loop_joint', 'true')

    def _error(self, section, record, key, expected, got):
        return MechanismError(f'{self.mechanism.name}: {section}.{record.name}.{key}: expected '
                              f'{expected} to write SDF, got {got}')


def _add_axis(element, number, axis):
    child = ElementTree.SubElement(element, 'axis2' if number else 'axis')
    ElementTree.SubElement(child, 'xyz').text = _numbers(*axis)
    return child


def _text(element, tag, value):
    """Add a child with a number or a word."""
    ElementTree.SubElement(element, tag).text = (
        value if isinstance(value, str) else _numbers(value))


def _turn(axis, angle):
    return of_quaternion([*(np.sin(0.5 * angle) * np.array(axis)), np.cos(0.5 * angle)])


def _drawn(single, joint, q):
    """Return where a joint's frame is in the one before it, and its child in that, at q."""
    frame, child, place, after = np.eye(3), np.eye(3), np.zeros(3), np.zeros(3)
    if single.type == SPHERICAL:
        frame = of_quaternion(q)
    elif single.type == UNIVERSAL:
        frame, child = _turn(joint.axis, q[0]), _turn(joint.second_axis, q[1])
    elif single.type in (REVOLUTE, HELICAL):
        child = _turn(single.axis, q[0])
        if single.type == HELICAL:
            after = joint.lead * q[0] * np.array(single.axis)
    elif single.type == PRISMATIC:
        after = q[0] * np.array(single.axis)
    return Pose(frame, place), Pose(child, after)


def _moved(joint, q):
    """Return where a joint's child is in its frame."""
    pose = Pose(np.eye(3), np.zeros(3))
    if joint.type == FREE:
        return Pose(of_quaternion(q[3:]), np.array(q[:3]))
    kinds = {CYLINDRICAL: ((REVOLUTE, joint.axis), (PRISMATIC, joint.axis)),
             PLANAR: ((PRISMATIC, X), (PRISMATIC, Y), (REVOLUTE, Z))}.get(
                 joint.type, ((joint.type, joint.axis),))
    for number, (kind, axis) in enumerate(kinds):
        frame, child = _drawn(_Single('', kind, axis), joint, q[number:])
        pose = pose @ frame @ child
    return pose


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


def _acting(mechanism, effects):
    """
    Return the effects on joints that formats know, by joint and type.

    Raises
    ------
    MechanismError
        Where something acts at a cut joint, which is no joint of theirs.

    """
    found = {}
    for coupling in mechanism.couplings:
        for cut in measured(mechanism, coupling):
            raise MechanismError(
                f'{mechanism.name}: couplings.{coupling.name}: expected joints of the tree, to '
                f'write it in this format, got {cut.name}, which closes a loop; cut another joint '
                'of that loop')
    named = {mechanism.coordinates.joint_of(values['joint'])
             for values in (effects or {}).values() if values.get('joint')}
    for cut in mechanism.cut_joints:
        if cut.actuated or cut.name in named:
            raise MechanismError(
                f'{mechanism.name}: cut_joints.{cut.name}: expected no drive and no effect where '
                'a loop is closed, to write it in this format; cut another joint of that loop')
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


def _matrix(body):
    xx, yy, zz, xy, xz, yz = _moments(body)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


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


WRITERS = {'.mjcf': mjcf, '.xml': mjcf, '.urdf': urdf_with_loops, '.sdf': sdf, '.world': sdf}
