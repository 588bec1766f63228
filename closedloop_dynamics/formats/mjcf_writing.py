# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms as MJCF, for MuJoCo: its equalities close the loops."""

from xml.etree import ElementTree

import numpy as np

from .in_space import in_space
from .mjcf import START
from .pose import IDENTITY, joint_frame, Pose
from .writing import (
    APART, chain, gravity_of, JOINT_EFFECTS, JointEffects, moments_of, numbers, reflected,
    Single, written)
from ..mechanism.inertia import inertia_matrix, moments_in
from ..mechanism.mechanism import (
    FIXED, FREE, GROUND, HELICAL, MechanismError, PRISMATIC, REVOLUTE, SPHERICAL)
from ..mechanism.rotations import of_quaternion, quaternion_of

# Coefficients of a polynomial between joints.
MOST_COEFFICIENTS = 5
# Attribute of a joint by the type of effect that acts on it.
ATTRIBUTES = {
    'joint_damping': 'damping', 'joint_friction': 'frictionloss', 'joint_spring': 'stiffness'}

# Key of the number, and attribute of a fixed tendon, by the type of effect along joints.
ALONG = {'tendon_friction': ('coulomb', 'frictionloss'),
         'tendon_inertia': ('inertia', 'armature')}
# Powers of springs and dampers that MuJoCo has.
MOST_POWERS = 3
# The least moment of inertia that it compiles, twice [kg m^2].
LEAST_MOMENT = 2e-14
# By which the largest moment is less than the sum of the others, so that it is after rounding.
SLACK = 1e-12


def mjcf(mechanism, effects=None, start=None, left_out=None, limits=None):
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
    left_out : dict, optional
        Filled with the names of effects that are not written, or in part: ``JointEffects.left``.
    limits : dict of str to tuple of 2, optional
        Least and largest coordinate of joints of one degree of freedom, None where there is none.

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
    ElementTree.SubElement(root, 'option', gravity=numbers(*gravity_of(effects)))
    bodies = {GROUND: ElementTree.SubElement(root, 'worldbody')}
    sections = {tag: ElementTree.SubElement(root, tag)
                for tag in ('tendon', 'equality', 'actuator')}
    joint_effects = JointEffects(
        mechanism, effects, lambda joint: _singles(mechanism, joint), limits)
    _add_bodies(mechanism, bodies, sections, joint_effects)
    for point in mechanism.points:
        ElementTree.SubElement(bodies[point.body], 'site', name=point.name,
                               pos=numbers(*point.position))
    for cut in mechanism.cut_joints:
        _equalities(mechanism, cut, bodies, sections['equality'])
    for coupling in mechanism.couplings:
        if coupling.law is not None:
            _polynomial(mechanism, sections['equality'], coupling)
            continue
        _gear(sections, coupling.name, coupling.joints, coupling.offset)
    for name, values in (effects or {}).items():
        if _along(name, values, bodies[GROUND], sections['tendon'], joint_effects):
            del joint_effects.left[name]
    for joint in mechanism.joints:
        if joint.actuated:
            for single in _singles(mechanism, joint):
                _add_motors(sections['actuator'], single, joint_effects)
    for tag, section in sections.items():
        if not len(section):
            root.remove(section)
    if start is not None:
        _add_key_frame(root, mechanism, start)
    if left_out is not None:
        left_out.update(joint_effects.left)
    return written(root)


def _along(name, values, world, section, joint_effects):
    """Add the tendon that an effect is; return whether there is one."""
    kind, more = values['type'], {}
    places = [values[key] for key in ('point_a', 'point_b') if values.get(key)]
    if kind == 'tendon':
        rest, stiffness, damping = (np.ravel(values.get(key) or 0.0) for key in (
            'rest', 'stiffness', 'damping'))
        # For lengths of -1 MuJoCo takes those of the position drawn.
        if max(len(stiffness), len(damping)) > MOST_POWERS or np.all(rest == -1.0):
            return False
        tendon = _fixed(section, values['arms'], joint_effects)
        more = {'stiffness': stiffness, 'damping': damping, 'springlength': rest}
    elif kind in ALONG:
        key, attribute = ALONG[kind]
        tendon = _fixed(section, values['arms'], joint_effects)
        more = {attribute: [values.get(key, 0.0)]}
    elif kind == 'point_spring' or kind == 'cable' and not (
            values.get('damping') or any(values.get('radii') or ())):
        rope = kind == 'cable'
        more = {'stiffness': [values.get('stiffness', 0.0)],
                'damping': [0.0 if rope else values.get('damping', 0.0)],
                'springlength': ([0.0] if rope else []) + [values.get('free_length', 0.0)]}
        tendon = ElementTree.SubElement(section, 'spatial')
        if values.get('anchor'):
            ElementTree.SubElement(world, 'site', name=f'{name}_anchor',
                                   pos=numbers(*(*values['anchor'], 0.0)[:3]))
            places.append(f'{name}_anchor')
        for place in values['points'] if rope else places:
            ElementTree.SubElement(tendon, 'site', site=place)
    else:
        return False
    tendon.set('name', name)
    for key, found in more.items():
        tendon.set(key, numbers(*found))
    return True


def _fixed(section, arms, joint_effects):
    """Add a tendon of joints."""
    tendon = ElementTree.SubElement(section, 'fixed')
    for joint, arm in arms.items():
        ElementTree.SubElement(tendon, 'joint', joint=joint_effects.freedoms[joint][0],
                               coef=numbers(arm))
    return tendon


def _singles(mechanism, joint):
    """Return the joints of MJCF for a joint; a free one is allowed in the world only."""
    carrier = {one.name for one in mechanism.bodies if not one.massless}
    if joint.type == FREE and joint.parent == GROUND and joint.child in carrier:
        return [Single(joint.name, FREE)]
    return chain(mechanism, joint, balls=True)


def _add_motors(section, single, joint_effects):
    """Add a motor for each freedom of a joint."""
    count = {SPHERICAL: 3, FREE: 6}.get(single.type, 1)
    for number in range(count):
        motor = ElementTree.SubElement(section, 'motor', joint=single.name)
        torque, _ = joint_effects.drive(single.name, speeds=False) if count == 1 else (None, None)
        if torque is not None:
            motor.set('ctrlrange', numbers(-torque, torque))
            motor.set('ctrllimited', 'true')
        if count > 1:
            motor.set('gear', ' '.join('1' if number == k else '0' for k in range(count)))


def _add_bodies(mechanism, bodies, sections, joint_effects):
    """Add all bodies, each in the one that it moves against, with the joints between them."""
    carried, records = {}, {body.name: body for body in mechanism.bodies}
    for joint in mechanism.joints:
        carried.setdefault(joint.parent, []).append(joint)
    waiting = [(joint, GROUND, (), IDENTITY) for joint in carried[GROUND]]
    while waiting:
        joint, parent, before, place = waiting.pop(0)
        body, below, place = records[joint.child], carried.get(joint.child, ()), (
            place @ joint_frame(joint))
        singles = [*before, *((single, place) for single in _singles(mechanism, joint))]
        if joint.type == HELICAL:
            _gear(sections, joint.name, {f'{joint.name}_slide': 1.0, joint.name: -joint.lead}, 0.0)
        if body.massless and joint.type != FIXED:
            # Its joints move with the body that it carries.
            if len(below) != 1 or any(
                    body.name in (cut.body_a, cut.body_b) for cut in mechanism.cut_joints):
                raise MechanismError(
                    f'{mechanism.name}: bodies.{body.name}: expected a mass, or one body that '
                    'it carries and no cut joint on it, to write MJCF')
            waiting.append((below[0], parent, singles, place))
            continue
        _add_body(bodies, parent, body, singles, place, joint_effects)
        waiting += [(one, body.name, (), IDENTITY) for one in below]


def _add_key_frame(root, mechanism, start):
    """Add a position, its coordinates in the order in which MuJoCo has the joints."""
    values = {}
    for joint in mechanism.joints:
        some = np.asarray(start, dtype=float)[mechanism.coordinates.coordinates[joint.name]]
        if joint.type == HELICAL:
            some = np.array([some[0], joint.lead * some[0]])
        for single in _singles(mechanism, joint):
            if single.type == FREE:
                there = joint_frame(joint) @ Pose(of_quaternion(some[3:]), some[:3])
                x, y, z, w = quaternion_of(there.rotation)
                values[single.name] = (*there.position, w, x, y, z)
                continue
            count = 4 if single.type == SPHERICAL else 1
            values[single.name] = np.roll(some[:count], 1) if count == 4 else some[:1]
            some = some[count:]
    order = [joint.get('name') for joint in root.find('worldbody').iter()
             if joint.tag in ('joint', 'freejoint')]
    frame = ElementTree.SubElement(root, 'keyframe')
    ElementTree.SubElement(frame, 'key', name=START,
                           qpos=numbers(*(one for name in order for one in values[name])))


def _add_body(bodies, parent, body, singles, place, joint_effects):
    """Add a body with the joints before it, which are given in frames along the way."""
    element = ElementTree.SubElement(
        bodies[parent], 'body', name=body.name, pos=numbers(*place.position),
        quat=_quaternion(place.rotation))
    bodies[body.name] = element
    if not body.massless:
        ElementTree.SubElement(
            element, 'inertial', pos=numbers(*body.center_of_mass), mass=numbers(body.mass),
            fullinertia=numbers(*_moments(body)))
    for single, at in singles:
        there = place.inverse @ at
        attributes = _attributes_of(single, joint_effects)
        if single.type == FREE:
            tag, kind = ('joint', {'type': 'free'}) if attributes else ('freejoint', {})
            ElementTree.SubElement(element, tag, name=single.name, **kind, **attributes)
            continue
        added = ElementTree.SubElement(
            element, 'joint', name=single.name, pos=numbers(*there.position),
            type={REVOLUTE: 'hinge', PRISMATIC: 'slide', SPHERICAL: 'ball'}[single.type])
        if single.axis is not None:
            added.set('axis', numbers(*(there.rotation @ single.axis)))
        added.attrib.update(attributes)


def _moments(body):
    """
    Return the moments of inertia of a body, as MuJoCo compiles them.

    It refuses those of points and bars, and by rounding those of plates, whose largest moment is
    the sum of the others: the smaller ones grow by as little as it takes.
    """
    moments, axes = np.linalg.eigh(inertia_matrix(moments_of(body)))
    grown = np.maximum(moments, LEAST_MOMENT)
    missing = (1.0 + SLACK) * grown[2] - grown[0] - grown[1]
    grown[:2] += max(missing, 0.0) / 2.0
    if np.array_equal(grown, moments):
        return moments_of(body)
    whole = axes @ np.diag(grown) @ axes.T
    return moments_in(whole)


def _attributes_of(single, joint_effects):
    found = {}
    for kind, attribute in ATTRIBUTES.items():
        values = joint_effects.same(single.name, kind)
        if values is not None:
            found[attribute] = numbers(values[JOINT_EFFECTS[kind]])
            if values.get('rest'):
                found['springref'] = numbers(values['rest'])
    limits = joint_effects.limits(single.name)
    if limits is not None:
        found.update(range=numbers(*limits), limited='true')
    rotor = joint_effects.same(single.name, 'rotor')
    if rotor is not None:
        found['armature'] = numbers(reflected(rotor))
    return found


def _equalities(mechanism, cut, bodies, section):
    """Add the constraint that closes a loop."""
    if cut.type not in (SPHERICAL, REVOLUTE, FIXED):
        raise MechanismError(
            f'{mechanism.name}: cut_joints.{cut.name}.type: expected spherical, revolute or fixed '
            f'to write MJCF, got {cut.type!r} (cut the loop at another joint)')
    # A hinge is a ball at each of two points of its axis.
    for number, along in enumerate((0.0, APART) if cut.type == REVOLUTE else (0.0,)):
        name = f'{cut.name}_{number + 1}' if cut.type == REVOLUTE else cut.name
        held = of_quaternion(cut.orientation).T if cut.type == FIXED else np.eye(3)
        for body, point, axis, end, turn in (
                (cut.body_a, cut.point_a, cut.axis_a, 'a', held),
                (cut.body_b, cut.point_b, cut.axis_b, 'b', np.eye(3))):
            place = np.array(point) + (along * np.array(axis) if along else 0.0)
            ElementTree.SubElement(bodies[body], 'site', name=f'{name}_{end}',
                                   pos=numbers(*place), quat=_quaternion(turn))
        ElementTree.SubElement(section, 'weld' if cut.type == FIXED else 'connect', name=name,
                               site1=f'{name}_a', site2=f'{name}_b')


def _gear(sections, name, factors, offset):
    """Add a linear equation between joints."""
    tendon = ElementTree.SubElement(sections['tendon'], 'fixed', name=f'{name}_sum')
    for joint, factor in factors.items():
        ElementTree.SubElement(tendon, 'joint', joint=joint, coef=numbers(factor))
    ElementTree.SubElement(sections['equality'], 'tendon', name=f'{name}_held',
                           tendon1=f'{name}_sum', polycoef=numbers(offset, 0, 0, 0, 0))


def _polynomial(mechanism, section, coupling):
    """Add an equation by which one joint is a polynomial of another one's coordinate."""
    law = coupling.law
    if len(coupling.joints) != 1 or law.polynomial is None or law.period is not None or (
            len(law.polynomial) > MOST_COEFFICIENTS):
        raise MechanismError(
            f'{mechanism.name}: couplings.{coupling.name}.law: expected one joint that is a '
            f'polynomial of {MOST_COEFFICIENTS} coefficients at most, without a period, to write '
            'MJCF')
    (name, factor), = coupling.joints.items()
    coefficients = np.zeros(MOST_COEFFICIENTS)
    coefficients[:len(law.polynomial)] = law.polynomial
    coefficients[0] += coupling.offset
    ElementTree.SubElement(section, 'joint', name=f'{coupling.name}_held', joint1=name,
                           joint2=law.joint, polycoef=numbers(*coefficients / factor))


def _quaternion(rotation):
    """Return a rotation as MuJoCo writes it, w first."""
    x, y, z, w = quaternion_of(rotation)
    return numbers(w, x, y, z)
