# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The URDF says what the mechanism is, and puts the bodies where the simulation puts them."""

from dataclasses import replace
import math
from test.formats.test_writing import same_motion
from test.reference import cases, spatial_machines
from test.reference.spatial_maximal import matrix
from test.simulation.test_orientations import arm
from test.simulation.test_space import tilted_four_bar, TURN
from test.visual.test_drawing import EVERYTHING
from xml.etree import ElementTree

from closedloop_dynamics import Body, Joint, load_scene, Mechanism, read_mechanism, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.effects.end_stop import stops_of
from closedloop_dynamics.formats.in_space import in_space
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.mechanism.config import shipped_names, shipped_path
from closedloop_dynamics.mechanism.kinematics import body_poses
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.visual.srdf import srdf
from closedloop_dynamics.visual.urdf import urdf
import numpy as np
import pytest

MECHANISMS = [name for name in shipped_names('mechanisms')
              if read_mechanism(shipped_path('mechanisms', name)).planar]
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
            if joint.get('type') == 'floating':
                turn = position[joint.get('name')]
                frame = frame @ transform(matrix(turn[-4:]), (*turn[:-4], 0.0, 0.0, 0.0)[:3])
            elif joint.get('type') != 'fixed':
                axis, mimic = numbers(joint.find('axis').get('xyz')), joint.find('mimic')
                value = position[joint.get('name')] if mimic is None else (
                    float(mimic.get('multiplier')) * position[mimic.get('joint')])
                frame = frame @ (
                    transform(rotation(axis, value)) if joint.get('type') == 'continuous'
                    else transform(translation=value * np.array(axis)))
            frames[child] = frame
            left.remove(joint)
    return frames


def screw():
    """Return a nut on a screw about an oblique axis, a slide across it, and a body fixed there."""
    turn = tuple(np.array([0.4, -0.2, 0.5, 0.7]) / np.linalg.norm([0.4, -0.2, 0.5, 0.7]))
    quarter = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))
    moments = (0.02, 0.03, 0.04, 0.001, -0.002, 0.003)
    bodies = [Body(name, 1.5, (0.1, 0.2, 0.3), moments) for name in ('nut', 'slide', 'tool')]
    return validate_mechanism(Mechanism('screw', tuple(bodies), (
        Joint('thread', 'helical', 'ground', 'nut', (0.3, -0.2, 0.1), orientation=turn,
              axis=(0.6, 0.0, 0.8), lead=0.02, actuated=True),
        Joint('rail', 'prismatic', 'nut', 'slide', (0.0, 0.4, 0.2), orientation=quarter,
              axis=(0.0, -0.6, 0.8)),
        Joint('weld', 'fixed', 'slide', 'tool', (0.1, 0.0, 0.0), orientation=turn))))


SPATIAL = {
    'rssr_four_bar': lambda: spatial_machines.with_single_freedoms(
        spatial_machines.rssr_four_bar()[0]),
    'stewart_platform': lambda: spatial_machines.with_single_freedoms(
        spatial_machines.stewart_platform()[0]),
    'tilted': lambda: tilted_four_bar(TURN)[1],
    'screw': screw,
    'several': arm}


@pytest.mark.parametrize('name', SPATIAL)
def test_frames_of_the_links_in_space_are_the_poses_of_the_bodies(name):
    mechanism = SPATIAL[name]()
    names = mechanism.coordinates
    random, geometry = np.random.default_rng(4), Geometry(mechanism)
    for change in random.normal(size=(5, names.nv)):
        position = names.moved(names.start(), change)
        by_name = {name: position[place] for name, place in zip(names.names, names.place)}
        by_name.update((name, position[places]) for name, places in names.coordinates.items()
                       if name in names.with_orientation)
        frames = link_frames(urdf(mechanism), by_name)
        poses = geometry.poses_among(geometry.equations.move(position).work)
        for body, pose in zip(mechanism.bodies, poses):
            expected = transform(matrix(pose[3:]), pose[:3])
            np.testing.assert_allclose(frames[body.name], expected, atol=1e-12)


def test_description_in_space_is_complete():
    robot = ElementTree.fromstring(urdf(screw()))
    links = {link.get('name'): link for link in robot.findall('link')}
    joints = {joint.get('name'): joint for joint in robot.findall('joint')}
    assert set(joints) == {'world_to_ground', 'thread', 'thread_slide', 'rail', 'weld'}
    assert set(links) == {'world', 'ground', 'nut', 'thread_screw', 'slide', 'tool'}
    inertial = links['nut'].find('inertial')
    assert numbers(inertial.find('origin').get('xyz')) == [0.1, 0.2, 0.3]
    found = inertial.find('inertia')
    assert [float(found.get(key)) for key in ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')] == [
        0.02, 0.03, 0.04, 0.001, -0.002, 0.003]
    assert [joints[name].find('limit') is None for name in ('thread', 'thread_slide', 'rail')] == [
        True, False, False]
    control = robot.find('ros2_control')
    assert [joint.get('name') for joint in control.findall('joint')] == ['thread']


def test_bars_in_space_end_at_the_points_of_a_body():
    mechanism = SPATIAL['rssr_four_bar']()
    robot = ElementTree.fromstring(urdf(mechanism))
    rod = next(link for link in robot.findall('link') if link.get('name') == 'rod')
    bar, = (visual for visual in rod.findall('visual')
            if visual.find('geometry/cylinder') is not None)
    half = 0.5 * float(bar.find('geometry/cylinder').get('length'))
    ends = [(origin_of(bar) @ (0.0, 0.0, along, 1.0))[:3] for along in (-half, half)]
    np.testing.assert_allclose(
        ends, [(0.0, 0.0, 0.0), mechanism.cut_joints[0].point_a], atol=1e-14)


def test_names_that_the_urdf_needs_are_refused():
    several = arm()
    with pytest.raises(ValueError, match="'hip_part_1' for a link within the joint 'hip'"):
        urdf(replace(several, bodies=(
            *several.bodies, replace(several.bodies[0], name='hip_part_1'))))
    taken = screw()
    bodies = (replace(taken.bodies[0], name='thread_screw'), *taken.bodies[1:])
    joints = (replace(taken.joints[0], child='thread_screw'),
              replace(taken.joints[1], parent='thread_screw'), taken.joints[2])
    with pytest.raises(ValueError, match="'thread_screw' for a link"):
        urdf(replace(taken, bodies=bodies, joints=joints))


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


@pytest.mark.parametrize('form', ['constraint', 'loop', 'drake'])
@pytest.mark.parametrize('name', ['three_rrr', 'carpet_scraper', 'slider_crank', 'bennett'])
def test_description_is_the_whole_machine(name, form, tmp_path):
    mechanism = read_mechanism(shipped_path('mechanisms', name))
    path = tmp_path / 'machine.urdf'
    path.write_text(urdf(mechanism, loops=form))
    again = read_model(path).mechanism
    assert again.joint_names == mechanism.joint_names
    assert again.actuated_joints == mechanism.actuated_joints
    if form != 'drake':
        assert [cut.name for cut in again.cut_joints] == [
            cut.name for cut in mechanism.cut_joints]
    same_motion(in_space(mechanism), again)


def test_loops_that_have_no_form_are_comments():
    mechanism = read_mechanism(shipped_path('mechanisms', 'scissor_lift'))
    text = urdf(mechanism)
    assert text.count('<constraint ') == 5 and text.count('point_on_line between') == 2
    assert '<!-- slot_below: point_on_line between b_1 and ground' in text
    assert 'xmlns:drake' not in urdf(read_mechanism(shipped_path('mechanisms', 'cam_follower')),
                                     loops='drake')


def test_joints_with_two_stops_have_limits(tmp_path):
    scene = load_scene('delta_robot')
    path = tmp_path / 'delta.urdf'
    path.write_text(urdf(scene.mechanism, limits=stops_of(scene.effects)))
    hip, = (joint for joint in ElementTree.parse(path).getroot().findall('joint')
            if joint.get('name') == 'hip_2')
    assert hip.get('type') == 'revolute'
    limit = hip.find('limit').attrib
    assert [float(limit[key]) for key in ('lower', 'upper')] == pytest.approx(
        np.deg2rad([-60.0, 70.0]))
    assert read_model(path).limits['hip_1'] == pytest.approx(tuple(np.deg2rad([-60.0, 70.0])))


@pytest.mark.parametrize('name', cases.only(
    ('three_rrr', 'humanoid_ankle'),
    ('delta_robot', 'three_rrr', 'humanoid_ankle', 'excavator_arm')))
def test_semantic_description_names_every_joint_once(name):
    simulation = Simulation.from_scene(name)
    robot = ElementTree.fromstring(urdf(simulation.mechanism))
    # What MoveIt takes for joints with a position of their own.
    moving = [joint.get('name') for joint in robot.findall('joint')
              if joint.get('type') != 'fixed' and joint.find('mimic') is None]
    semantic = ElementTree.fromstring(srdf(
        simulation.mechanism, {'start': simulation.position}))
    assert semantic.get('name') == robot.get('name')
    group = [joint.get('name') for joint in semantic.findall('group/joint')]
    passive = [joint.get('name') for joint in semantic.findall('passive_joint')]
    assert group == list(simulation.actuated_joints)
    assert sorted(group + passive) == sorted(moving)
    state = {joint.get('name'): float(joint.get('value'))
             for joint in semantic.findall('group_state/joint')}
    names = simulation.coordinates.names
    assert state == {names[k]: simulation.position[simulation.coordinates.place[k]]
                     for k in simulation.coordinates.actuated}
    links = {link.get('name') for link in robot.findall('link')}
    pairs = [(one.get('link1'), one.get('link2')) for one in semantic.findall(
        'disable_collisions')]
    assert pairs and len(set(pairs)) == len(pairs) and {one for pair in pairs
                                                        for one in pair} <= links


def test_semantic_description_needs_something_to_plan_for():
    with pytest.raises(ValueError, match='rope_hoist: expected a driven joint'):
        mechanism = read_mechanism(shipped_path('mechanisms', 'rope_hoist'))
        srdf(replace(mechanism, joints=tuple(
            replace(joint, actuated=False) for joint in mechanism.joints)))


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
    assert {param.get('name'): param.text for param in control.findall('hardware/param')} == {
        'joint_commands_topic': '/left/joint_command', 'joint_states_topic': 'joint_states',
        'trigger_joint_command_threshold': '-1'}
    joints = control.findall('joint')
    assert tuple(joint.get('name') for joint in joints) == tuple(simulation.actuated_joints)
    for joint in joints:
        command, = joint.findall('command_interface')
        assert command.get('name') == 'effort'
        assert command.find("param[@name='initial_value']").text == '0.0'
        assert [one.get('name') for one in joint.findall('state_interface')] == [
            'position', 'velocity', 'effort']
