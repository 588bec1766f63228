# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The spanning tree of a mechanism as a URDF robot description, with its loops.

URDF has no loops: the cut joints are elements beside the tree that some programs read and all
others pass over (``formats.urdf_loops``). Joint positions that close them come from the
simulation. The plane of a planar mechanism is the x-y plane of ``world``, angles are about z,
units are SI (REP 103). With it, ``joint_states`` alone moves the machine in RViz and Foxglove.

URDF has no screws: a helical joint becomes one that turns, under its own name, and one that slides
with it (``mimic``). Universal, cylindrical and planar joints are chains of joints of one freedom,
called as their coordinates are; spherical and free ones are ``floating``: their links are on
``/tf``.
"""

import math
from xml.etree import ElementTree

import numpy as np

from .appearance import body_colors, marked_points, outline, rgb
from ..formats.in_space import cuts_in_space
from ..formats.model import MOMENTS
from ..formats.urdf_loops import add_loops, CONSTRAINT, FORMS
from ..formats.writing import numbers, written
from ..kinematics.modeling import extent
from ..mechanism.coordinates import WITH_ORIENTATION
from ..mechanism.mechanism import CYLINDRICAL, FIXED, GROUND, HELICAL, PLANAR, PRISMATIC, UNIVERSAL
from ..mechanism.rotations import angles_of, of_quaternion

WORLD = 'world'
# Sizes of links and pins, as shares of the mechanism's size.
WIDTH, THICKNESS, PIN_RADIUS = 0.06, 0.025, 0.045
# Between bodies that a pin joins, so that they do not flicker where they overlap.
LAYER = 0.027
# URDF wants limits of a prismatic joint, a mechanism has none: these are beyond reach.
REACH, NO_LIMIT = 100.0, 1e9
# Hardware of ros2_control that is reached by topics.
HARDWARE_PLUGIN = 'joint_state_topic_hardware_interface/JointStateTopicSystem'
# Hardware that is the mechanism itself, and the bandwidth of its servos times the step size.
MECHANISM_PLUGIN, PROMPTNESS = 'closedloop_hardware/MechanismSystem', 0.1
# State interfaces of a sensor of the force in a joint.
WRENCH = ('force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z')
PLANAR_WRENCH = ('force.x', 'force.y', 'torque.z')
ALONG_X, ALONG_Y, ABOUT_Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
# Appended to the name of a helical joint: the link between its two joints, and the sliding joint.
SCREW, SLIDE = '_screw', '_slide'
# The same for the links within a joint of several numbers, before their own.
PART = '_part'


def urdf(mechanism, command_topic='joint_command', state_topic='joint_states', loops=CONSTRAINT,
         limits=None, hardware=None):
    """
    Return the URDF of the spanning tree, with its loops.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Its bodies become links of the same names, its joints joints. The actuated ones are those
        of a ``ros2_control`` element, if there are any.
    command_topic, state_topic : str
        Where the hardware interface of that element finds a simulator.
    loops : str
        How loops are written: ``constraint``, ``loop`` or ``drake`` (``formats.urdf_loops``). A
        cut joint that the form has no word for becomes a comment.
    limits : dict of str to tuple of 2, optional
        Least and largest coordinate of freedoms [rad or m]; of those that are not named there is
        none.
    hardware : tuple of 3, optional
        Library of the exported C, step size [s], and whether forces of cut joints are sensors,
        where ``closedloop_hardware`` is what the ``ros2_control`` element names, in the place of
        a simulator that is reached by topics.

    Returns
    -------
    str
        XML. The root link is ``world``; ``ground`` is fixed to it.

    Raises
    ------
    ValueError
        Where a body or joint has a name that is needed otherwise.

    """
    _require_names(mechanism)
    size = extent(mechanism)
    depth = depths(mechanism)
    colors = body_colors(mechanism)
    robot = ElementTree.Element('robot', name=mechanism.name)
    for color in sorted(set(colors.values())):
        material = ElementTree.SubElement(robot, 'material', name=_material(color))
        ElementTree.SubElement(material, 'color', rgba=numbers(*rgb(color), 1.0))
    ElementTree.SubElement(robot, 'link', name=WORLD)
    ElementTree.SubElement(robot, 'link', name=GROUND)
    fixed = ElementTree.SubElement(robot, 'joint', name=f'{WORLD}_to_{GROUND}', type='fixed')
    ElementTree.SubElement(fixed, 'parent', link=WORLD)
    ElementTree.SubElement(fixed, 'child', link=GROUND)
    for body in mechanism.bodies:
        link = ElementTree.SubElement(robot, 'link', name=body.name)
        _add_inertial(link, body)
        material = _material(colors[body.name])
        if mechanism.planar:
            _add_visuals(link, outline(mechanism, body.name), material, size,
                         depth[body.name] * LAYER * size)
        else:
            _add_bars(link, marked_points(mechanism, body.name), material, size)
    for joint in mechanism.joints:
        (_add_joint if mechanism.planar else _add_spatial_joint)(robot, joint, size)
    _limit(robot, limits or {})
    _add_loops(robot, mechanism, loops)
    if hardware is not None:
        _add_mechanism(robot, mechanism, *hardware)
    elif mechanism.actuated_joints:
        _add_hardware(robot, mechanism, command_topic, state_topic)
    return f'<?xml version="1.0"?>\n{written(robot)}'


def _limit(robot, limits):
    """Give joints their ends: where they turn, they become revolute ones."""
    for element in robot.findall('joint'):
        if element.get('name') not in limits:
            continue
        limit = element.find('limit')
        if limit is None:
            element.set('type', 'revolute')
            limit = ElementTree.SubElement(
                element, 'limit', effort=numbers(NO_LIMIT), velocity=numbers(NO_LIMIT))
        for key, value in zip(('lower', 'upper'), limits[element.get('name')]):
            limit.set(key, numbers(value))


def joint_names(mechanism):
    """Return the names of the joints of the URDF that move, and follow from no other."""
    return [name for joint in mechanism.joints if joint.type != FIXED
            for name in ([step[0] for _, step in _chain(joint)] or [joint.name])]


def _add_loops(robot, mechanism, form):
    """Add loop closures, and a comment for each cut joint that has no element."""
    cuts = cuts_in_space(mechanism)
    for cut in cuts:
        if cut.type not in FORMS[form]:
            robot.append(ElementTree.Comment(
                f' {cut.name}: {cut.type} between {cut.body_a} and {cut.body_b}, which no '
                f'{form} is '))
    add_loops(robot, [cut for cut in cuts if cut.type in FORMS[form]], form)


def _require_names(mechanism):
    """Raise where links or joints cannot be named or written."""
    bodies = {body.name for body in mechanism.bodies}
    if WORLD in bodies:
        raise ValueError(
            f"the URDF of {mechanism.name} needs the name '{WORLD}' for its root link, and a "
            'body has it: rename the body')
    for joint in mechanism.joints:
        for link, _ in _chain(joint)[:-1]:
            if link in bodies:
                raise ValueError(
                    f"the URDF of {mechanism.name} needs the name '{link}' for a link within the "
                    f"joint '{joint.name}', and a body has it: rename the body")
        if joint.type == HELICAL and (joint.name + SCREW in bodies
                                      or joint.name + SLIDE in mechanism.joint_names):
            raise ValueError(
                f"the URDF of {mechanism.name} needs the names '{joint.name}{SCREW}' for a link "
                f"and '{joint.name}{SLIDE}' for a joint, and one of them is taken: rename it")


def _add_joint(robot, joint, size):
    slides = joint.type == PRISMATIC
    element = _add_moving(robot, joint.name, slides, joint.parent, joint.child)
    _add_origin(element, joint.position, joint.angle)
    # Both frames agree here: the child is turned by the angle, and slides along its own x.
    _add_axis(element, ALONG_X if slides else ABOUT_Z, size if slides else None)


def _chain(joint):
    """
    Return the single joints of a joint of two or three coordinates, outward; none of others.

    (link, (name, whether it slides, axis)) of each joint of one freedom in its place.
    """
    steps = {
        UNIVERSAL: (('.1', False, joint.axis), ('.2', False, joint.second_axis)),
        CYLINDRICAL: (('.1', False, joint.axis), ('.2', True, joint.axis)),
        PLANAR: (('.x', True, ALONG_X), ('.y', True, ALONG_Y), ('.angle', False, ABOUT_Z)),
    }.get(joint.type, ())
    links = [f'{joint.name}{PART}_{k}' for k in range(1, len(steps))] + [joint.child]
    return [(link, (joint.name + suffix, *step)) for link, (suffix, *step) in zip(links, steps)]


def _add_chain(robot, joint, size):
    parent = joint.parent
    for link, (name, slides, axis) in _chain(joint):
        if link != joint.child:
            ElementTree.SubElement(robot, 'link', name=link)
        element = _add_moving(robot, name, slides, parent, link)
        if parent == joint.parent:
            _add_pose(element, joint.position, _angles(joint.orientation))
        _add_axis(element, axis, size if slides else None)
        parent = link


def _add_spatial_joint(robot, joint, size):
    if joint.type in (FIXED, *WITH_ORIENTATION):
        element = ElementTree.SubElement(
            robot, 'joint', name=joint.name,
            type='fixed' if joint.type == FIXED else 'floating')
        ElementTree.SubElement(element, 'parent', link=joint.parent)
        ElementTree.SubElement(element, 'child', link=joint.child)
        _add_pose(element, joint.position, _angles(joint.orientation))
        return
    if _chain(joint):
        _add_chain(robot, joint, size)
        return
    slides, screw = joint.type == PRISMATIC, joint.type == HELICAL
    between = joint.name + SCREW if screw else joint.child
    element = _add_moving(robot, joint.name, slides, joint.parent, between)
    _add_pose(element, joint.position, _angles(joint.orientation))
    _add_axis(element, joint.axis, size if slides else None)
    if screw:
        ElementTree.SubElement(robot, 'link', name=between)
        element = _add_moving(robot, joint.name + SLIDE, True, between, joint.child)
        _add_axis(element, joint.axis, size)
        ElementTree.SubElement(
            element, 'mimic', joint=joint.name, multiplier=numbers(joint.lead))


def _add_moving(robot, name, slides, parent, child):
    """Add a joint that slides or turns, and return it, still without origin and axis."""
    element = ElementTree.SubElement(
        robot, 'joint', name=name, type='prismatic' if slides else 'continuous')
    ElementTree.SubElement(element, 'parent', link=parent)
    ElementTree.SubElement(element, 'child', link=child)
    return element


def _add_axis(element, axis, size):
    """Add an axis, and limits of sliding joints by the mechanism's size [m]."""
    ElementTree.SubElement(element, 'axis', xyz=numbers(*axis))
    if size is not None:
        ElementTree.SubElement(
            element, 'limit', lower=numbers(-REACH * size), upper=numbers(REACH * size),
            effort=numbers(NO_LIMIT), velocity=numbers(NO_LIMIT))


def _angles(quaternion):
    """Return roll, pitch and yaw of a unit quaternion x, y, z, w [rad]."""
    return angles_of(of_quaternion(quaternion))


def _add_hardware(robot, mechanism, command_topic, state_topic):
    """Add the ros2_control element of a simulator as hardware: efforts in, states out."""
    # Compares commanded with measured positions, and there are no commanded ones: always.
    control = _add_control(robot, mechanism, HARDWARE_PLUGIN, {
        'joint_commands_topic': command_topic, 'joint_states_topic': state_topic,
        'trigger_joint_command_threshold': '-1'})
    for name in _driven(mechanism):
        joint = ElementTree.SubElement(control, 'joint', name=name)
        command = ElementTree.SubElement(joint, 'command_interface', name='effort')
        # Until a controller writes one: without it, NaN.
        ElementTree.SubElement(command, 'param', name='initial_value').text = '0.0'
        for key in ('position', 'velocity', 'effort'):
            ElementTree.SubElement(joint, 'state_interface', name=key)


def _add_mechanism(robot, mechanism, model, step_size, sensors):
    """Add the ros2_control element of exported C as hardware: all single joints."""
    control = _add_control(robot, mechanism, MECHANISM_PLUGIN, {
        'model': str(model), 'step_size': numbers(step_size),
        'bandwidth': numbers(PROMPTNESS / step_size)})
    driven, single = _driven(mechanism), mechanism.coordinates.single_names
    # Limits of the joints that the URDF has.
    for name in (name for name in joint_names(mechanism) if name in single):
        joint = ElementTree.SubElement(control, 'joint', name=name)
        for key in ('effort', 'position', 'velocity') if name in driven else ():
            ElementTree.SubElement(joint, 'command_interface', name=key)
        for key in ('position', 'velocity', 'acceleration', 'effort'):
            ElementTree.SubElement(joint, 'state_interface', name=key)
    for cut in mechanism.cut_joints if sensors else ():
        sensor = ElementTree.SubElement(control, 'sensor', name=cut.name)
        ElementTree.SubElement(sensor, 'param', name='joint').text = cut.name
        for key in PLANAR_WRENCH if mechanism.planar else WRENCH:
            ElementTree.SubElement(sensor, 'state_interface', name=key)


def _add_control(robot, mechanism, plugin, parameters):
    control = ElementTree.SubElement(
        robot, 'ros2_control', name=mechanism.name, type='system')
    hardware = ElementTree.SubElement(control, 'hardware')
    ElementTree.SubElement(hardware, 'plugin').text = plugin
    for key, value in parameters.items():
        ElementTree.SubElement(hardware, 'param', name=key).text = value
    return control


def _driven(mechanism):
    """Return names of actuated coordinates; orientations have none."""
    single = set(mechanism.coordinates.single)
    return [mechanism.coordinates.names[place] for place in mechanism.coordinates.actuated
            if place in single]


def _add_inertial(link, body):
    """Add mass and inertia; in the plane the ones out of it are those of a flat body."""
    if body.massless:
        return
    inertial = ElementTree.SubElement(link, 'inertial')
    if isinstance(body.inertia, tuple):
        _add_pose(inertial, body.center_of_mass)
        moments = (*body.inertia, 0.0, 0.0, 0.0)[:6]
    else:
        _add_origin(inertial, body.center_of_mass)
        moments = (body.inertia / 2.0, body.inertia / 2.0, body.inertia, 0.0, 0.0, 0.0)
    ElementTree.SubElement(inertial, 'mass', value=numbers(body.mass))
    ElementTree.SubElement(inertial, 'inertia', dict(zip(MOMENTS, map(numbers, moments))))


def _add_visuals(link, points, material, size, height):
    """Add a box along every edge of the outline, and a pin at every corner."""
    width, thickness = WIDTH * size, THICKNESS * size
    if len(points) == 1:
        box = _add_visual(link, points[0], 0.0, height, material)
        box.set('size', numbers(2.0 * width, 1.2 * width, thickness))
        return
    ends = points if len(points) == 2 else [*points, points[0]]
    for start, end in zip(ends, ends[1:]):
        along = end - start
        box = _add_visual(
            link, (start + end) / 2.0, np.arctan2(along[1], along[0]), height, material)
        box.set('size', numbers(np.hypot(*along), width, thickness))
    for place in points:
        pin = _add_visual(link, place, 0.0, height, material, 'cylinder')
        pin.set('radius', numbers(PIN_RADIUS * size))
        pin.set('length', numbers(thickness))


def _add_bars(link, points, material, size):
    """Add a round bar from the body's own joint to each of its other points, and balls there."""
    for point in points:
        length = float(np.linalg.norm(point))
        if length > 0.0:
            x, y, z = point.tolist()
            # The turn that leads from z to the point.
            bar = _add_visual_at(link, 0.5 * point, (
                0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x)), material, 'cylinder')
            bar.set('radius', numbers(0.3 * WIDTH * size))
            bar.set('length', numbers(length))
        ball = _add_visual_at(link, point, (0.0, 0.0, 0.0), material, 'sphere')
        ball.set('radius', numbers(PIN_RADIUS * size))


def _add_visual(link, place, angle, height, material, shape='box'):
    """Add a visual in the plane and return its shape, still without dimensions."""
    return _add_visual_at(link, (*place, height), (0.0, 0.0, angle), material, shape)


def _add_visual_at(link, place, angles, material, shape):
    visual = ElementTree.SubElement(link, 'visual')
    _add_pose(visual, place, angles)
    geometry = ElementTree.SubElement(visual, 'geometry')
    ElementTree.SubElement(visual, 'material', name=material)
    return ElementTree.SubElement(geometry, shape)


def _add_origin(element, place, angle=0.0):
    """Add an origin in the plane."""
    _add_pose(element, (*place, 0.0), (0.0, 0.0, angle))


def _add_pose(element, place, angles=(0.0, 0.0, 0.0)):
    """Add an origin in space: its place [m], and turns about x, y and z [rad]."""
    ElementTree.SubElement(
        element, 'origin', xyz=numbers(*place), rpy=numbers(*angles))


def depths(mechanism):
    """Return by body how many joints it is away from the ground."""
    found = {GROUND: 0}
    left = list(mechanism.joints)
    while left:
        known = [joint for joint in left if joint.parent in found]
        found.update((joint.child, found[joint.parent] + 1) for joint in known)
        left = [joint for joint in left if joint not in known]
    return found


def _material(color):
    return f'subsystem_{color[1:].lower()}'
