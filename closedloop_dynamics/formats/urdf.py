# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
URDF, with the tags in which loops are written.

Read are ``<loop>`` and ``<coupling>`` (URDF+), ``<constraint>`` (proposed), ``<loop_joint>``
(Isaac) and ``<drake:ball_constraint>``; a YAML file beside it with ``closed_loop`` and others
(``parallel_yaml``). The root link stands on the ground.
"""

from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .model import (
    Connection, free_name, Link, Model, MOMENTS, NO_CONTACTS, ReadOptions, Relation)
from .parallel_yaml import add_parallel_yaml
from .pose import IDENTITY, Pose, unturned
from .programs import add_parameters, add_programs
from .sdf import add_parts
from .sdf_parts import FALSE, TRUE
from .visuals import color_in, places_of_packages, SEARCHED, visuals
from .xml_file import read_xml
from .xml_omissions import leave_out
from ..mechanism.extras import remedy
from ..mechanism.fields import among
from ..mechanism.inertia import inertia_matrix
from ..mechanism.mechanism import (
    CYLINDRICAL, FIXED, FREE, GROUND, MechanismError, PLANAR, PRISMATIC, REVOLUTE, SPHERICAL,
    UNIVERSAL)
from ..mechanism.rotations import of_angles

TYPES = {'revolute': REVOLUTE, 'continuous': REVOLUTE, 'prismatic': PRISMATIC, 'fixed': FIXED,
         'floating': FREE, 'planar': PLANAR}
LOOP_TYPES = {'revolute': REVOLUTE, 'continuous': REVOLUTE, 'prismatic': PRISMATIC,
              'fixed': FIXED, 'spherical': SPHERICAL, 'ball': SPHERICAL, 'planar': PLANAR,
              'universal': UNIVERSAL, 'cylindrical': CYLINDRICAL}
WITHOUT_AXIS = (FIXED, FREE, SPHERICAL)
# Why elements that are not read are not needed.
REASONS = {
    'visual': 'for pictures', 'material': 'for pictures', 'collision': NO_CONTACTS,
    'joint_properties': 'for another program',
    'safety_controller': 'for controllers', 'calibration': 'for controllers',
    'hardware': 'for controllers', 'sensor': 'for sensors',
    # In an element gazebo.
    **dict.fromkeys((
        'mu1', 'mu2', 'mu', 'fdir1', 'kp', 'kd', 'maxVel', 'minDepth', 'maxContacts',
        'max_contacts', 'selfCollide', 'self_collide', 'laserRetro'), NO_CONTACTS),
    **dict.fromkeys((
        'plugin', 'static', 'provideFeedback', 'implicitSpringDamper', 'stopCfm', 'stopErp',
        'fudgeFactor', 'preserveFixedJoint', 'disableFixedJointLumping', 'dampingFactor',
        'velocity_decay', 'enable_wind', 'allow_auto_disable', 'gazebo'), 'for a simulator')}


def read_urdf(path, options=ReadOptions()):
    """
    Return the Model in a URDF file; one that ends with .xacro goes through xacro first.

    Raises MechanismError with file, line and element.
    """
    path = Path(path)
    if options.arguments and path.suffix != '.xacro':
        raise MechanismError(f'{path}: expected a xacro file, which has arguments, got another')
    robot = read_xml(path, ('robot',), _expanded(
        path, options) if path.suffix == '.xacro' else None)
    model = Model(robot.get('name') or path.stem, path)
    _rename_ground(robot, model)
    colors = {material.get('name'): _color(material) for material in robot.all('material')}
    for link in robot.all('link'):
        model.add(_link(link))
        model.links[link.attributes['name']].visual = visuals(
            link, path.parent, lambda visual: _origin(visual.child('origin')), _attribute,
            lambda visual: _color_of(visual, colors), model.ignored)
    mimics = []
    for joint in robot.all('joint'):
        model.add(_joint(joint, mimics))
    for element in robot.all('loop'):
        model.add(_loop(element))
    for element in robot.all('constraint'):
        model.add(_constraint(element))
    for element in robot.all('loop_joint'):
        model.add(_loop_joint(element))
    for number, element in enumerate(robot.all('drake:ball_constraint'), 1):
        model.add(_ball_constraint(element, f'ball_constraint_{number}'))
    for joint, element in mimics:
        model.mimic(element, joint.name, element.word('joint'), element.number('multiplier', 1.0),
                    element.number('offset', 0.0))
    model.check()
    _stand(model, robot)
    _extend(model, robot)
    for element in robot.all('coupling'):
        model.relations.append(_coupling(model, element))
    _find_drives(model, robot)
    add_parallel_yaml(model)
    joints = model.joints.values()
    if all(joint.actuated is None for joint in joints):
        for joint in joints:
            joint.actuated = (joint.type in (REVOLUTE, PRISMATIC) and bool(joint.effort)
                              and joint.name not in model.followers)
    leave_out(model, robot, REASONS, options.ignore)
    return model


def _expanded(path, options):
    """Return the text of a file expanded by xacro."""
    read_xml(path, ('robot',))
    try:
        import xacro
        from xacro import substitution_args
    except (ImportError, OSError) as error:
        raise MechanismError(
            f'{path}: a xacro file needs {remedy("xacro", error)}, or, with ROS, its package '
            'xacro') from None
    try:
        with _packages_beside(path, substitution_args):
            return xacro.process_file(
                str(path), mappings=dict(options.arguments)).toxml(encoding='utf-8')
    except Exception as error:  # noqa: B902
        # Whatever the macros do: errors of a language of its own.
        raise MechanismError(f'{path}: expected what xacro can expand, got: {error}') from None


@contextmanager
def _packages_beside(path, xacro):
    """Have $(find PACKAGE) find packages that the file is in, or beside, where ROS has none."""
    of_ros = xacro._eval_find

    def find(package):
        try:
            return of_ros(package)
        except (ImportError, LookupError, OSError, ValueError):
            for place in places_of_packages(path.resolve().parent):
                if (place / package).is_dir():
                    return str(place / package)
            raise LookupError(f'no folder of the package {package!r} around the file, nor where '
                              f'{among(SEARCHED)} list folders') from None

    xacro._eval_find = find
    try:
        yield
    finally:
        xacro._eval_find = of_ros


def _link(element):
    """Return a link; one without an element inertial has no mass."""
    name, link = element.word('name'), Link(element.get('name'), element.where)
    if name == GROUND:
        # It is the world itself where it has no joint above it.
        link.name = name
    gravity = element.child('gravity')
    link.carried = float(gravity is not None and gravity.text in FALSE)
    inertial = element.child('inertial')
    if inertial is None:
        return link
    pose = _origin(inertial.child('origin'))
    mass = inertial.required('mass')
    link.mass = mass.number('value')
    if link.mass is None:
        raise mass.error('the attribute value', 'none')
    if link.mass < 0.0:
        raise mass.error('a mass that is zero or more', f'{link.mass:g}')
    inertia = inertial.required('inertia')
    link.center = pose.position
    link.inertia = pose.rotation @ inertia_matrix(
        [inertia.number(key, 0.0) for key in MOMENTS]) @ pose.rotation.T
    return link


def _attribute(element, key, count):
    """Return numbers, or text, of an attribute."""
    return element.get(key) if count is None else element.numbers(key, count)


def _color(material):
    color = material.child('color')
    return None if color is None else color_in(color.get('rgba'))


def _color_of(visual, colors):
    """Return the colour of a visual, its own or one that has a name."""
    material = visual.child('material')
    return material and (_color(material) or colors.get(material.get('name')))


def _origin(element):
    """Return the pose that an element origin gives, if there is one."""
    if element is None:
        return IDENTITY
    return Pose(of_angles(element.numbers('rpy', 3, np.zeros(3))),
                element.numbers('xyz', 3, np.zeros(3)))


def _joint(element, mimics):
    """Return a joint of the tree."""
    kind = TYPES[element.word('type', tuple(TYPES))]
    joint = Connection(
        element.word('name'), kind, element.required('parent').word('link'),
        element.required('child').word('link'), element.where,
        in_parent=_origin(element.child('origin')), axis=_axis(element, 'axis', kind))
    mimic = element.child('mimic')
    if mimic is not None:
        mimics.append((joint, mimic))
    dynamics, limit = element.child('dynamics'), element.child('limit')
    if dynamics is not None:
        joint.damping, joint.friction = (
            _not_negative(dynamics, key) for key in ('damping', 'friction'))
    if limit is not None:
        joint.effort, joint.speed = limit.number('effort'), limit.number('velocity')
        if element.attributes['type'] in ('revolute', 'prismatic'):
            joint.lower, joint.upper = limit.number('lower'), limit.number('upper')
            if joint.lower == joint.upper == 0.0:
                joint.lower = joint.upper = None
    joint.actuated = _independent(element)
    return joint


def _independent(element):
    """Return whether an element's attribute makes it driven; None where it does not say."""
    word = element.get('independent')
    if word is not None and word.lower() not in (*TRUE, *FALSE):
        raise element.error('independent to be true or false', repr(word))
    return None if word is None else word.lower() in TRUE


def _not_negative(element, key):
    value = element.number(key, 0.0)
    if value < 0.0:
        raise element.error(f'{key} to be zero or more', f'{value:g}')
    return value


def _axis(element, tag, kind):
    """Return the axis of a joint; None where its type has none."""
    axis = element.child(tag)
    if kind in WITHOUT_AXIS:
        if axis is not None:
            axis.get('xyz')
        return None
    if axis is None:
        return np.array([1.0, 0.0, 0.0])
    return axis.direction('xyz', (1.0, 0.0, 0.0))


def _coupling(model, element):
    """Return a coupling of URDF+, a ratio between the chains to two links."""
    above = {joint.child: joint for joint in model.joints.values() if not joint.closes}
    chains = []
    for tag in ('successor', 'predecessor'):
        link, chain = element.required(tag).word('link'), []
        if link not in model.links and link != GROUND:
            model.frame(link, element.where)
        while link in above:
            chain.append(above[link])
            link = above[link].parent
        chains.append(chain)
    ratio = element.required('ratio').number('value')
    if not ratio:
        raise element.error('a ratio that is not zero', repr(ratio))
    factors = {}
    for chain, other, factor in ((chains[0], chains[1], 1.0), (chains[1], chains[0], -ratio)):
        shared = [joint.name for joint in other]
        factors.update((joint.name, factor) for joint in chain
                       if joint.name not in shared and joint.type != FIXED)
    return Relation(element.word('name'), element.where, factors)


def _loop(element):
    """Return a loop as URDF+ writes it."""
    kind = LOOP_TYPES[element.word('type', tuple(LOOP_TYPES))]
    ends = [element.required(tag) for tag in ('predecessor', 'successor')]
    if kind == UNIVERSAL:
        raise element.error('a type of one axis', "'universal'")
    return Connection(
        element.word('name'), kind, *(end.word('link') for end in ends), element.where,
        *(_origin(end.child('origin')) for end in ends), axis=_axis(element, 'axis', kind),
        closes=True, actuated=_independent(element))


def _constraint(element):
    """Return a loop as it is proposed for URDF."""
    kind = LOOP_TYPES[element.word('type', tuple(LOOP_TYPES))]
    return Connection(
        element.word('name'), kind, element.required('parent').word('link'),
        element.required('child').word('link'), element.where,
        _origin(element.child('parent_origin')), _origin(element.child('child_origin')),
        axis=_axis(element, 'parent_axis', kind), child_axis=_axis(element, 'child_axis', kind),
        closes=True)


def _loop_joint(element):
    """Return a loop as Isaac writes it."""
    kind = LOOP_TYPES[element.word('type', tuple(LOOP_TYPES))]
    if kind == UNIVERSAL:
        raise element.error('a type of one axis', "'universal'")
    ends = [element.required(tag) for tag in ('link1', 'link2')]
    return Connection(
        element.word('name'), kind, *(end.word('link') for end in ends), element.where,
        *map(_origin, ends), axis=_axis(element, 'axis', kind), closes=True)


def _ball_constraint(element, name):
    """Return a loop as Drake writes it."""
    ends = [(element.required(f'drake:ball_constraint_body_{body}').word('name'),
             element.required(f'drake:ball_constraint_p_{point}'))
            for body, point in (('A', 'AP'), ('B', 'BQ'))]
    places = []
    for _, point in ends:
        place = point.numbers('value', 3)
        if place is None:
            raise point.error('the attribute value', 'none')
        places.append(unturned(place))
    return Connection(name, SPHERICAL, ends[0][0], ends[1][0], element.where, *places,
                      closes=True)


def _stand(model, robot):
    """Put the root link on the ground; raise where the links form no tree."""
    carried = {}
    for joint in model.joints.values():
        if joint.closes:
            continue
        first = carried.setdefault(joint.child, joint)
        if first is not joint:
            raise MechanismError(
                f'{joint.where}: expected a child that no other joint carries, got '
                f'{joint.child!r}, which joint {first.name!r} carries (close the loop by an '
                'element <loop> instead)')
    roots = [name for name in model.links if name not in carried]
    if len(roots) != 1:
        raise robot.error('one link that no joint carries',
                          'the roots ' + ', '.join(roots[:5]) if roots else
                          'a cycle of links' if model.links else 'none')
    seen = {roots[0]}
    children = {}
    for joint in carried.values():
        children.setdefault(joint.parent, []).append(joint.child)
    waiting = [roots[0]]
    while waiting:
        for child in children.get(waiting.pop(), ()):
            seen.add(child)
            waiting.append(child)
    for name, joint in carried.items():
        if name not in seen and joint.parent in model.links:
            raise MechanismError(f'{joint.where}: expected a chain of joints to the root link '
                                 f'{roots[0]!r}, got a cycle')
    if roots[0] != GROUND:
        model.add(Connection(free_name('to_ground', model.joints), FIXED, GROUND, roots[0]))
    else:
        del model.links[GROUND]


def _rename_ground(robot, model):
    """Call a link that is named as the ground otherwise, unless it is the root."""
    carried = [child.get('link') for joint in robot.all('joint') for child in joint.all('child')]
    if GROUND in carried:
        _rename(robot, model.link_name(GROUND, [link.get('name') for link in robot.all('link')]))


def _rename(element, new):
    """Put another name in the place of the ground's wherever an element refers to a link."""
    for key, value in element.attributes.items():
        if value == GROUND and (key in ('link', 'reference') or key == 'name' and (
                element.tag == 'link' or element.tag.startswith('drake:'))):
            element.attributes[key] = new
    if element.text == GROUND:
        element.text = new
    for child in element.children:
        _rename(child, new)


def _extend(model, robot):
    """Read Gazebo's extensions: links and joints of SDF, plugins, and springs of joints."""
    poses, elements = _drawn(model), robot.all('gazebo')
    alone = [element for element in elements if element.get('reference') is None]
    poses.update(add_parts(alone, model, poses))
    for element in elements:
        add_programs(element, model, poses)
        name = element.get('reference')
        if name in model.links:
            for tag, off in (('gravity', FALSE), ('turnGravityOff', TRUE)):
                child = element.child(tag)
                if child is not None:
                    model.links[name].carried = float(child.text in off)
        elif name in model.joints:
            joint = model.joints[name]
            for tag, key in (('springStiffness', 'stiffness'), ('springReference', 'rest')):
                child = element.child(tag)
                if child is not None:
                    setattr(joint, key, child.values(child.text, 1, tag)[0])
            if joint.stiffness < 0.0:
                raise element.error('springStiffness to be zero or more',
                                    f'{joint.stiffness:g}')


def _drawn(model):
    """Return the poses of the links in the frame of the ground, each joint at zero."""
    carried, found, waiting = {}, {GROUND: IDENTITY}, [GROUND]
    for joint in model.joints.values():
        if not joint.closes:
            carried.setdefault(joint.parent, []).append(joint)
    while waiting:
        parent = waiting.pop()
        for joint in carried.get(parent, ()):
            found[joint.child] = found[parent] @ joint.in_parent
            waiting.append(joint.child)
    return found


def _find_drives(model, robot):
    """Find the driven joints, from transmissions or ros2_control."""
    named = [joint.get('name') for transmission in robot.all('transmission')
             for joint in transmission.all('joint')]
    for control in robot.all('ros2_control'):
        named += [joint.get('name') for joint in control.all('joint')
                  if joint.all('command_interface')]
    for transmission in robot.all('transmission'):
        joints, drives = transmission.all('joint'), transmission.all('actuator')
        for joint, drive in zip(joints, drives):
            rotor, gear = (drive.child(f'drake:{key}') for key in ('rotor_inertia', 'gear_ratio'))
            if rotor is not None and joint.get('name') in model.joints:
                ratio = 1.0 if gear is None else gear.number('value', 1.0)
                model.joints[joint.get('name')].armature = _not_negative(
                    rotor, 'value') * ratio ** 2
    for name in named:
        if name in model.joints:
            model.joints[name].actuated = True
        else:
            model.ignored[f'the drive of {name}'] = 'there is no such joint'
    for control in robot.all('ros2_control'):
        for name in add_parameters(control, model):
            model.joints[name].actuated = False
