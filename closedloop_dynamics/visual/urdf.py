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
The spanning tree of a mechanism as a URDF robot description.

URDF has no loops: the cut joints are left out, and the joint positions that
close them come from the simulation. The plane of the mechanism is the x-y plane
of ``world``, angles are about z, units are SI (REP 103). With it,
``joint_states`` alone moves the machine in RViz and Foxglove.

"""

from xml.etree import ElementTree

import numpy as np

from .appearance import body_colors, outline, rgb
from ..mechanism.mechanism import GROUND, PRISMATIC
from ..simulation.modeling import extent

WORLD = 'world'
# Of links and pins, as shares of the mechanism's size.
WIDTH, THICKNESS, PIN_RADIUS = 0.06, 0.025, 0.045
# Between bodies that a pin joins, so that they do not flicker where they overlap.
LAYER = 0.027
# URDF wants limits of a prismatic joint, a mechanism has none: these are beyond reach.
REACH, NO_LIMIT = 100.0, 1e9
# Of ros2_control: hardware that is reached by topics.
HARDWARE_PLUGIN = 'topic_based_ros2_control/TopicBasedSystem'
ALONG_X, ABOUT_Z = '1 0 0', '0 0 1'


def urdf(mechanism, command_topic='joint_command', state_topic='joint_states'):
    """
    Return the URDF of the spanning tree.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Its bodies become links of the same names, its joints joints. The actuated ones are those
        of a ``ros2_control`` element, if there are any.
    command_topic, state_topic : str
        Where the hardware interface of that element finds a simulator.

    Returns
    -------
    str
        XML. The root link is ``world``; ``ground`` is fixed to it.

    Raises
    ------
    ValueError
        Where a body has the name of the root link; a MechanismError for one in space.

    """
    mechanism.require_planar('URDF')
    if WORLD in {body.name for body in mechanism.bodies}:
        raise ValueError(
            f"the URDF of {mechanism.name} needs the name '{WORLD}' for its root link, and a "
            'body has it: rename the body')
    size = extent(mechanism)
    depth = _depths(mechanism)
    colors = body_colors(mechanism)
    robot = ElementTree.Element('robot', name=mechanism.name)
    for color in sorted(set(colors.values())):
        material = ElementTree.SubElement(robot, 'material', name=_material(color))
        ElementTree.SubElement(material, 'color', rgba=_numbers(*rgb(color), 1.0))
    ElementTree.SubElement(robot, 'link', name=WORLD)
    ElementTree.SubElement(robot, 'link', name=GROUND)
    fixed = ElementTree.SubElement(robot, 'joint', name=f'{WORLD}_to_{GROUND}', type='fixed')
    ElementTree.SubElement(fixed, 'parent', link=WORLD)
    ElementTree.SubElement(fixed, 'child', link=GROUND)
    for body in mechanism.bodies:
        link = ElementTree.SubElement(robot, 'link', name=body.name)
        _add_inertial(link, body)
        _add_visuals(link, outline(mechanism, body.name), _material(colors[body.name]),
                     size, depth[body.name] * LAYER * size)
    for joint in mechanism.joints:
        _add_joint(robot, joint, size)
    if mechanism.actuated_joints:
        _add_hardware(robot, mechanism, command_topic, state_topic)
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def _add_joint(robot, joint, size):
    slides = joint.type == PRISMATIC
    element = ElementTree.SubElement(
        robot, 'joint', name=joint.name, type='prismatic' if slides else 'continuous')
    ElementTree.SubElement(element, 'parent', link=joint.parent)
    ElementTree.SubElement(element, 'child', link=joint.child)
    _add_origin(element, joint.position, joint.angle)
    # Both frames agree here: the child is turned by the angle, and slides along its own x.
    ElementTree.SubElement(element, 'axis', xyz=ALONG_X if slides else ABOUT_Z)
    if slides:
        ElementTree.SubElement(
            element, 'limit', lower=_numbers(-REACH * size), upper=_numbers(REACH * size),
            effort=_numbers(NO_LIMIT), velocity=_numbers(NO_LIMIT))


def _add_hardware(robot, mechanism, command_topic, state_topic):
    """Add what ros2_control needs to take a simulator for hardware: efforts in, states out."""
    control = ElementTree.SubElement(
        robot, 'ros2_control', name=mechanism.name, type='system')
    hardware = ElementTree.SubElement(control, 'hardware')
    ElementTree.SubElement(hardware, 'plugin').text = HARDWARE_PLUGIN
    for key, value in (
            ('joint_commands_topic', command_topic), ('joint_states_topic', state_topic),
            # Compares commanded with measured positions, and there are no commanded ones: always.
            ('trigger_joint_command_threshold', '-1')):
        ElementTree.SubElement(hardware, 'param', name=key).text = value
    for name in mechanism.actuated_joints:
        joint = ElementTree.SubElement(control, 'joint', name=name)
        ElementTree.SubElement(joint, 'command_interface', name='effort')
        for key in ('position', 'velocity', 'effort'):
            ElementTree.SubElement(joint, 'state_interface', name=key)


def _add_inertial(link, body):
    """Add mass and inertia; the ones out of the plane are those of a flat body."""
    if body.massless:
        return
    inertial = ElementTree.SubElement(link, 'inertial')
    _add_origin(inertial, body.center_of_mass)
    ElementTree.SubElement(inertial, 'mass', value=_numbers(body.mass))
    half = _numbers(body.inertia / 2.0)
    ElementTree.SubElement(inertial, 'inertia', ixx=half, iyy=half, izz=_numbers(body.inertia),
                           ixy='0', ixz='0', iyz='0')


def _add_visuals(link, points, material, size, height):
    """Add a box along every edge of the outline, and a pin at every corner."""
    width, thickness = WIDTH * size, THICKNESS * size
    if len(points) == 1:
        box = _add_visual(link, points[0], 0.0, height, material)
        box.set('size', _numbers(2.0 * width, 1.2 * width, thickness))
        return
    ends = points if len(points) == 2 else [*points, points[0]]
    for start, end in zip(ends, ends[1:]):
        along = end - start
        box = _add_visual(
            link, (start + end) / 2.0, np.arctan2(along[1], along[0]), height, material)
        box.set('size', _numbers(np.hypot(*along), width, thickness))
    for place in points:
        pin = _add_visual(link, place, 0.0, height, material, 'cylinder')
        pin.set('radius', _numbers(PIN_RADIUS * size))
        pin.set('length', _numbers(thickness))


def _add_visual(link, place, angle, height, material, shape='box'):
    """Add a visual and return its shape, still without dimensions."""
    visual = ElementTree.SubElement(link, 'visual')
    _add_origin(visual, place, angle, height)
    geometry = ElementTree.SubElement(visual, 'geometry')
    ElementTree.SubElement(visual, 'material', name=material)
    return ElementTree.SubElement(geometry, shape)


def _add_origin(element, place, angle=0.0, height=0.0):
    ElementTree.SubElement(
        element, 'origin', xyz=_numbers(*place, height), rpy=_numbers(0.0, 0.0, angle))


def _depths(mechanism):
    """Return by body how many joints it is away from the ground."""
    depths = {GROUND: 0}
    left = list(mechanism.joints)
    while left:
        known = [joint for joint in left if joint.parent in depths]
        depths.update((joint.child, depths[joint.parent] + 1) for joint in known)
        left = [joint for joint in left if joint not in known]
    return depths


def _material(color):
    return f'subsystem_{color[1:].lower()}'


def _numbers(*values):
    """Write numbers with all their digits; whole ones without a point."""
    return ' '.join(repr(float(value)).removesuffix('.0') for value in values)
