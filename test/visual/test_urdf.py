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

"""The URDF says what the mechanism is, and puts the bodies where the simulation puts them."""

import math
from test.visual.test_drawing import EVERYTHING
from xml.etree import ElementTree

from closedloop_dynamics.cli import main
from closedloop_dynamics.mechanism.config import shipped_names, shipped_path
from closedloop_dynamics.mechanism.reader import read_mechanism
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.motion import body_poses
from closedloop_dynamics.visual.urdf import urdf
import numpy as np
import pytest

MECHANISMS = shipped_names('mechanisms')
SCENES = ('carpet_scraper', 'four_bar', 'hoeken_pantograph_leg', 'slider_crank', 'three_rrr')


@pytest.fixture
def everything(tmp_path):
    path = tmp_path / 'everything.yaml'
    path.write_text(EVERYTHING)
    return read_mechanism(path)


def numbers(text):
    return [float(word) for word in text.split()]


def rotation(axis, angle):
    """Return a rotation matrix in space (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def transform(rotation_matrix=None, translation=(0.0, 0.0, 0.0)):
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) if rotation_matrix is None else rotation_matrix
    matrix[:3, 3] = translation
    return matrix


def origin_of(element):
    origin = element.find('origin')
    if origin is None:
        return np.eye(4)
    roll, pitch, yaw = numbers(origin.get('rpy', '0 0 0'))
    turned = (rotation((0, 0, 1), yaw) @ rotation((0, 1, 0), pitch) @ rotation((1, 0, 0), roll))
    return transform(turned, numbers(origin.get('xyz', '0 0 0')))


def link_frames(text, position):
    """Return the frames of all links, by the rules of URDF alone, in space."""
    robot = ElementTree.fromstring(text)
    frames = {'world': np.eye(4)}
    left = robot.findall('joint')
    while left:
        for joint in list(left):
            parent, child = joint.find('parent').get('link'), joint.find('child').get('link')
            if parent not in frames:
                continue
            frame = frames[parent] @ origin_of(joint)
            if joint.get('type') != 'fixed':
                axis = numbers(joint.find('axis').get('xyz'))
                value = position[joint.get('name')]
                frame = frame @ (
                    transform(rotation(axis, value)) if joint.get('type') == 'continuous'
                    else transform(translation=value * np.array(axis)))
            frames[child] = frame
            left.remove(joint)
    return frames


def check_frames(mechanism, position, poses):
    frames = link_frames(urdf(mechanism), dict(zip(mechanism.joint_names, position)))
    assert set(frames) == {'world', 'ground', *(body.name for body in mechanism.bodies)}
    for body, (x, y, angle) in zip(mechanism.bodies, poses):
        expected = transform(rotation((0, 0, 1), angle), (x, y, 0.0))
        np.testing.assert_allclose(frames[body.name], expected, atol=1e-13)


@pytest.mark.parametrize('scene', SCENES)
def test_frames_of_the_links_are_the_poses_of_the_bodies(scene):
    simulation = Simulation.from_scene(scene)
    for _ in range(3):
        simulation.step(duration=0.05)
        check_frames(simulation.mechanism, simulation.position, simulation.body_poses)


def test_every_kind_of_joint_is_placed(everything):
    random = np.random.default_rng(7)
    for position in random.normal(size=(5, len(everything.joints))):
        check_frames(everything, position, body_poses(everything, position))


@pytest.mark.parametrize('name', MECHANISMS)
def test_description_is_complete(name):
    mechanism = read_mechanism(shipped_path('mechanisms', name))
    robot = ElementTree.fromstring(urdf(mechanism))
    links = {link.get('name'): link for link in robot.findall('link')}
    materials = {material.get('name') for material in robot.findall('material')}
    joints = {joint.get('name'): joint for joint in robot.findall('joint')}
    assert set(joints) == {'world_to_ground', *mechanism.joint_names}
    for body in mechanism.bodies:
        link = links[body.name]
        inertial = link.find('inertial')
        if body.massless:
            assert inertial is None
        else:
            assert float(inertial.find('mass').get('value')) == body.mass
            inertia = {key: float(value) for key, value in inertial.find('inertia').items()}
            assert inertia['izz'] == body.inertia
            # What a solid can have.
            assert inertia['ixx'] + inertia['iyy'] >= inertia['izz'] * (1.0 - 1e-15)
            x, y, _ = numbers(inertial.find('origin').get('xyz'))
            assert (x, y) == body.center_of_mass
        visuals = link.findall('visual')
        assert visuals
        for visual in visuals:
            assert visual.find('material').get('name') in materials
            shape, = visual.find('geometry')
            sizes = numbers(' '.join(shape.attrib.values()))
            assert all(size > 0.0 for size in sizes)


def test_prismatic_joints_have_limits_far_beyond_the_motion(everything):
    robot = ElementTree.fromstring(urdf(everything))
    slides = [joint for joint in robot.findall('joint') if joint.get('type') == 'prismatic']
    assert {joint.get('name') for joint in slides} == {'slide', 'drive'}
    for joint in slides:
        limit = joint.find('limit')
        assert float(limit.get('lower')) < -10.0 and float(limit.get('upper')) > 10.0
        assert float(limit.get('effort')) > 0.0 and float(limit.get('velocity')) > 0.0


def test_a_body_may_not_be_called_world(tmp_path):
    path = tmp_path / 'odd.yaml'
    path.write_text('name: odd\nbodies: {world: {mass: 1, center_of_mass: [0, 0], inertia: 1}}\n'
                    'joints: {j: {type: revolute, parent: ground, child: world, '
                    'position: [0, 0]}}\n')
    with pytest.raises(ValueError, match='rename the body'):
        urdf(read_mechanism(path))


def test_command_writes_what_the_function_returns(tmp_path, capsys):
    expected = urdf(read_mechanism(shipped_path('mechanisms', 'three_rrr')))
    assert main(['urdf', 'three_rrr']) == 0
    assert capsys.readouterr().out == expected
    output = tmp_path / 'machine.urdf'
    assert main(['urdf', 'three_rrr', '--output', str(output)]) == 0
    assert output.read_text() == expected
    assert main(['urdf', 'three_rrr', '--output', str(output)]) == 2
    assert '--overwrite' in capsys.readouterr().err


@pytest.mark.parametrize('scene', SCENES)
def test_an_independent_reader_agrees(scene, tmp_path):
    yourdfpy = pytest.importorskip('yourdfpy', reason='needs yourdfpy, for a second opinion')
    simulation = Simulation.from_scene(scene)
    simulation.step(duration=0.1)
    path = tmp_path / 'machine.urdf'
    path.write_text(urdf(simulation.mechanism))
    robot = yourdfpy.URDF.load(str(path))
    assert robot.validate()
    robot.update_cfg(dict(zip(simulation.joint_names, simulation.position)))
    for body, (x, y, angle) in zip(simulation.mechanism.bodies, simulation.body_poses):
        expected = transform(rotation((0, 0, 1), angle), (x, y, 0.0))
        np.testing.assert_allclose(
            robot.get_transform(body.name, 'world'), expected, atol=1e-9)


def test_actuated_joints_can_be_controlled_by_topics():
    simulation = Simulation.from_scene('three_rrr')
    robot = ElementTree.fromstring(urdf(simulation.mechanism, '/left/joint_command'))
    control = robot.find('ros2_control')
    assert control.get('type') == 'system'
    assert {param.get('name'): param.text for param in control.iter('param')} == {
        'joint_commands_topic': '/left/joint_command', 'joint_states_topic': 'joint_states',
        'trigger_joint_command_threshold': '-1'}
    joints = control.findall('joint')
    assert tuple(joint.get('name') for joint in joints) == tuple(simulation.actuated_joints)
    for joint in joints:
        assert [one.get('name') for one in joint.findall('command_interface')] == ['effort']
        assert [one.get('name') for one in joint.findall('state_interface')] == [
            'position', 'velocity', 'effort']
