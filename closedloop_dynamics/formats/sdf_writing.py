# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Mechanisms as SDF: a world with one model, whose joints form loops.

SDF draws a machine once, with its loops closed, and counts coordinates from there.
"""

from xml.etree import ElementTree

import numpy as np

from .in_space import in_space
from .model import MOMENTS, NO_LIMIT
from .pose import IDENTITY, joint_frame, poses_at, unturned
from .writing import (
    APART, chain, counted_from, drawn, gravity_of, JOINT_EFFECTS, JointEffects, mimics_of,
    moments_of, numbers, reflected, Single, written)
from ..mechanism.inertia import inertia_matrix
from ..mechanism.mechanism import (
    FIXED, FREE, GROUND, HELICAL, MechanismError, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from ..mechanism.rotations import quaternion_of

# Child of an element dynamics by the type of effect that acts on a joint.
DYNAMICS = {'joint_damping': 'damping', 'joint_friction': 'friction',
            'joint_spring': 'spring_stiffness'}
# The space of names of Drake's own elements.
DRAKE = 'http://drake.mit.edu'
# SDF has no links without mass: theirs, in parts of the lightest body's.
LEAST_MASS = 1e-12
# Types of joints that can close loops; those that Drake's ball constraints can replace.
LOOP_JOINTS = REVOLUTE, PRISMATIC, FIXED, SPHERICAL, UNIVERSAL, HELICAL
BALLS = SPHERICAL, REVOLUTE


def sdf(mechanism, effects=None, start=None, left_out=None, limits=None, drake=False):
    """
    Return a mechanism as SDF: a world with a model whose joints form loops.

    SDF draws a machine once, with its loops closed, and counts coordinates from there.

    Parameters
    ----------
    mechanism : Mechanism
        With cut joints of types that SDF has, and couplings of two joints.
    start : ndarray, shape (nq,), optional
        Coordinates of the position that is drawn, which closes the loops; zero if not given.
    effects, left_out, limits
        As for ``mjcf_writing.mjcf``.
    drake : bool
        Whether loops are closed by Drake's ball constraints, as it refuses loops of joints.

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
    ElementTree.SubElement(world, 'gravity').text = numbers(*gravity_of(effects))
    writer = _Sdf(mechanism, ElementTree.SubElement(world, 'model', name=mechanism.name), effects,
                  limits)
    writer.mimics = mimics_of(counted_from(mechanism, start), 'SDF')
    writer.poses = poses_at(mechanism, start)
    waiting, drawn_bodies = list(mechanism.joints), {GROUND}
    while waiting:
        # What a joint is on is drawn before it, whatever their order in the mechanism.
        joint = next(one for one in waiting if one.parent in drawn_bodies)
        waiting.remove(joint)
        drawn_bodies.add(joint.child)
        writer.add_joint(joint, start[places.coordinates[joint.name]])
    for cut in mechanism.cut_joints:
        (writer.add_ball_constraints if drake else writer.add_loop)(cut)
    for point in mechanism.points:
        frame = ElementTree.SubElement(writer.model, 'frame', name=writer.links[point.name],
                                       attached_to=writer.links[point.body])
        _add_pose(frame, unturned(point.position))
    if writer.drakes:
        root.set('xmlns:drake', DRAKE)
    if left_out is not None:
        left_out.update(writer.joint_effects.left)
    return written(root)


class _Sdf:
    """Writer of an element model, link by link and joint by joint."""

    def __init__(self, mechanism, model, effects, limits):
        """Name the links, in SDF's one space of names for all, and write their inertias."""
        self.mechanism, self.model, self.mimics, self.drakes = mechanism, model, {}, False
        self.joint_effects = JointEffects(mechanism, effects, self._singles, limits)
        taken = {one.name for one in (*mechanism.joints, *mechanism.cut_joints)} | {'world'}
        taken |= {single.name for joint in mechanism.joints
                  for single in self._singles(joint)}
        self.links, self.elements, self.poses = {GROUND: '__model__'}, {}, {}
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
            min((np.linalg.eigvalsh(inertia_matrix(moments_of(body)))[-1] for body in massive),
                default=1.0)])
        for body in mechanism.bodies:
            self._add_link(body.name, body)

    def _add_link(self, name, body=None):
        """Add a link; one without mass gets next to nothing."""
        self.elements[name] = link = ElementTree.SubElement(
            self.model, 'link', name=self.links[name])
        mass, moment = self.least
        center, moments = np.zeros(3), (moment, moment, moment, 0.0, 0.0, 0.0)
        if body is not None and not body.massless:
            mass, center, moments = body.mass, body.center_of_mass, moments_of(body)
        inertial = ElementTree.SubElement(link, 'inertial')
        _add_pose(inertial, unturned(center))
        _text(inertial, 'mass', mass)
        inertia = ElementTree.SubElement(inertial, 'inertia')
        for tag, value in zip(MOMENTS, moments):
            _text(inertia, tag, value)

    def _singles(self, joint):
        """Return the joints that SDF has for a joint; none for one that floats."""
        if joint.type == FREE and joint.parent == GROUND:
            return []
        if joint.type in (UNIVERSAL, HELICAL, FIXED):
            return [Single(joint.name, joint.type, joint.axis)]
        return chain(self.mechanism, joint, balls=True)

    def add_joint(self, joint, q):
        """Add a joint of the tree, drawn at its coordinates."""
        singles, place = self._singles(joint), joint_frame(joint)
        if not singles:
            if joint.actuated:
                raise self._error('joints', joint, 'actuated', 'false', 'true')
            _add_pose(self.elements[joint.child], self.poses[joint.child])
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
            element = _joint(self.model, single.name, single.type, 'world' if parent == GROUND
                             else self.links[parent], self.links[child])
            before, after = drawn(single, joint, q[:count])
            _add_pose(element, place @ before, self.links[parent])
            _add_pose(self.elements[child], after, single.name)
            self._add_axes(element, single, joint, q[:count])
            parent, place, q = child, IDENTITY, q[count:]

    def _add_axes(self, element, single, joint, q):
        """Add axes and lead, the effects along them, and whether a joint is driven."""
        if joint.actuated and single.type == SPHERICAL:
            raise self._error('joints', joint, 'actuated', 'false', 'true')
        if joint.type == HELICAL:
            _text(element, 'screw_thread_pitch', 2.0 * np.pi * joint.lead)
        axes = [single.axis] if single.axis is not None else []
        if joint.type == UNIVERSAL:
            axes.append(joint.second_axis)
        acting = {kind: self.joint_effects.each(single.name, kind) if axes else ()
                  for kind in DYNAMICS}
        if joint.actuated and len(axes) == 1:
            # Drake's drives alone have rotors.
            for values in self.joint_effects.each(single.name, 'rotor'):
                self.drakes = True
                _text(element, 'drake:rotor_inertia', reflected(values))
                _text(element, 'drake:gear_ratio', 1)
        for number, axis in enumerate(axes):
            child = _add_axis(element, number, axis)
            limit = ElementTree.Element('limit')
            if len(axes) == 1:
                ends = self.joint_effects.limits(single.name) or ()
                for tag, one in zip(('lower', 'upper'), ends):
                    # Missing limits stay missing, wherever it is drawn.
                    _text(limit, tag, one if abs(one) >= NO_LIMIT else one - q[number])
            if joint.actuated:
                torque, speed = self.joint_effects.drive(single.name, speeds=True)
                _text(limit, 'effort', torque or NO_LIMIT)
                if speed is not None:
                    _text(limit, 'velocity', speed)
            if len(limit):
                child.append(limit)
            dynamics = ElementTree.Element('dynamics')
            for kind, tag in DYNAMICS.items():
                values = [*acting[kind], None, None][number]
                if values is None:
                    continue
                if kind == 'joint_spring':
                    _text(dynamics, 'spring_reference', values.get('rest', 0.0) - q[number])
                _text(dynamics, tag, values[JOINT_EFFECTS[kind]])
            if len(dynamics):
                child.append(dynamics)
            if single.name in self.mimics:
                other, factor, offset = self.mimics[single.name]
                mimic = ElementTree.SubElement(child, 'mimic', joint=other, axis='axis')
                for tag, value in (('multiplier', factor), ('offset', offset), ('reference', 0)):
                    _text(mimic, tag, value)

    def add_loop(self, cut):
        """Add a joint that closes a loop."""
        if cut.type not in LOOP_JOINTS:
            raise self._error('cut_joints', cut, 'type',
                              'a joint that SDF has, not cylindrical or planar,', repr(cut.type))
        add_loop_joint(self.model, cut, {**self.links, GROUND: 'world'}, self.poses)

    def add_ball_constraints(self, cut):
        """Add Drake's constraint for a loop."""
        if cut.type not in BALLS:
            raise self._error('cut_joints', cut, 'type',
                              'spherical or revolute for Drake', repr(cut.type))
        self.drakes = True
        for ends in balls(cut):
            element = ElementTree.SubElement(self.model, 'drake:ball_constraint')
            for end, point, (body, place) in zip('AB', ('AP', 'BQ'), ends):
                _text(element, f'drake:ball_constraint_body_{end}',
                      'world' if body == GROUND else self.links[body])
                ElementTree.SubElement(
                    element, f'drake:ball_constraint_p_{point}').text = numbers(*place)

    def _error(self, section, record, key, expected, got):
        return MechanismError(f'{self.mechanism.name}: {section}.{record.name}.{key}: expected '
                              f'{expected} to write SDF, got {got}')


def add_loop_joint(model, cut, links, poses):
    """
    Add a joint of SDF that closes a loop, where its second body has it.

    ``cut`` is in space, its type one of LOOP_JOINTS; ``links``: names of the links of bodies and
    ground; ``poses`` of these, as they are drawn: with the loop closed.
    """
    # SDF has joints in the world only as parents.
    a, b = (cut.body_a, cut.point_a, cut.axis_a), (cut.body_b, cut.point_b, cut.axis_b)
    (parent, _, first), (child, point, second) = (a, b) if cut.body_b != GROUND else (b, a)
    element = _joint(model, cut.name, cut.type, links[parent], links[child])
    _add_pose(element, unturned(point), links[child])
    across = poses[child].rotation.T @ poses[parent].rotation
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


def balls(cut):
    """
    Return the ball joints that close a loop as a joint does: a hinge is two on its axis.

    Of each (body A, place on it [m]), (body B, place on it [m]); the joint is in space, of a type
    in BALLS.
    """
    return [tuple((body, np.array(place) + (along * np.array(axis) if along else 0.0))
                  for body, place, axis in ((cut.body_a, cut.point_a, cut.axis_a),
                                            (cut.body_b, cut.point_b, cut.axis_b)))
            for along in ((0.0, APART) if cut.type == REVOLUTE else (0.0,))]


def _joint(model, name, kind, parent, child):
    """Add an element joint with its ends."""
    element = ElementTree.SubElement(
        model, 'joint', name=name, type={SPHERICAL: 'ball', HELICAL: 'screw'}.get(kind, kind))
    for tag, link in (('parent', parent), ('child', child)):
        ElementTree.SubElement(element, tag).text = link
    return element


def _add_pose(element, pose, relative_to=None):
    """Add a pose, first of all children."""
    child = ElementTree.Element('pose')
    if relative_to:
        child.set('relative_to', relative_to)
    if np.array_equal(pose.rotation, np.eye(3)):
        child.text = numbers(*pose.position, 0, 0, 0)
    else:
        child.set('rotation_format', 'quat_xyzw')
        child.text = numbers(*pose.position, *quaternion_of(pose.rotation))
    element.insert(0, child)


def _add_axis(element, number, axis):
    child = ElementTree.SubElement(element, 'axis2' if number else 'axis')
    ElementTree.SubElement(child, 'xyz').text = numbers(*axis)
    return child


def _text(element, tag, value):
    """Add a child with a number or a word."""
    ElementTree.SubElement(element, tag).text = (
        value if isinstance(value, str) else numbers(value))
