# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The simulator runs mechanisms in space: states, orientations, wrenches, frames, markers."""

from dataclasses import replace
import json
from test.reference import cases, spatial_machines
from test.reference.scenes import scene_in_space
from test.reference.spatial_maximal import matrix
from test.ros.test_frames import broadcast  # noqa: F401
from test.simulation.test_space import machine, tilted_four_bar, TURN
from xml.etree import ElementTree

from builtin_interfaces.msg import Time
from closedloop_dynamics import Body, Joint, load_scene, Mechanism, Point, Simulation
from closedloop_dynamics.ros.auxiliary_publishers import LATCHED_QOS
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.torque_source_node import TorqueSourceNode
from closedloop_dynamics.scene.text import scene_text
from closedloop_dynamics.visual.appearance import marked_points
from geometry_msgs.msg import Transform, Twist, WrenchStamped
import numpy as np
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, MultiDOFJointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger


def file_of(made, directory):
    """Write a scene and its mechanism, and return the scene's path."""
    reported = json.loads(scene_text(made))
    path = directory / f'{made.name}.yaml'
    path.write_text(json.dumps(reported['scene']))
    (directory / 'mechanism.yaml').write_text(json.dumps(reported['mechanism']))
    return str(path)


def floater():
    """Return a driven universal joint and a driven ball on a floating body."""
    bodies = tuple(Body(name, 1.0, (0.1, 0.0, 0.05), (0.02, 0.03, 0.04))
                   for name in ('hull', 'arm', 'hand'))
    return Mechanism('floater', bodies, (
        Joint('hull', 'free', 'ground', 'hull', (0.0, 0.0, 1.0)),
        Joint('hip', 'universal', 'hull', 'arm', (0.2, 0.0, 0.0), axis=(1.0, 0.0, 0.0),
              second_axis=(0.0, 1.0, 0.0), actuated=True),
        Joint('ball', 'spherical', 'arm', 'hand', (0.3, 0.0, 0.0), actuated=True)))


def made(name):
    """Return the scene of a machine in space."""
    if name == 'floater':
        return scene_in_space(floater(), velocity={'hull': {
            'velocity': (0.1, 0.2, 0.3), 'angular_velocity': (1.0, 2.0, 3.0)}},
            gravity=(0.0, 0.0, -1.0))
    if name == 'tilted':
        _, mechanism, axes = tilted_four_bar(TURN)
        return replace(scene_in_space(mechanism, gravity=axes @ (0.0, -9.81, 0.0)),
                       initial=load_scene('four_bar').initial)
    mechanism, _ = machine(name)
    first, *others = mechanism.joints
    return scene_in_space(replace(mechanism, joints=(replace(first, actuated=True), *others)),
                          gravity=(0.0, -9.81, 1.0))


def stepped_node(make_node, path, **parameters):
    """Return a node that only moves when asked to."""
    node = make_node(SimulatorNode, scene=path, step_count=20, **parameters)
    node.timer.cancel()
    node.on_pause(SetBool.Request(data=True), SetBool.Response())
    return node


def step(node):
    assert node.on_step(Trigger.Request(), Trigger.Response()).success


def numbers(vector):
    return [getattr(vector, axis) for axis in 'xyzw' if hasattr(vector, axis)]


def quantities(coordinates, state, turned):
    """Return position, velocity and effort of joints as a simulation has them, from messages."""
    q, qd, effort = coordinates.start(), np.zeros(coordinates.nv), np.zeros(coordinates.nv)
    index = {name: k for k, name in enumerate(state.name)}
    for name in coordinates.single_names:
        rate, k = coordinates.index[name], index[name]
        q[coordinates.place[rate]] = state.position[k]
        qd[rate], effort[rate] = state.velocity[k], state.effort[k]
    for k, name in enumerate(coordinates.with_orientation):
        one = turned.joint_names.index(name)
        for values, places, given in (
                (q, coordinates.pose[k], (turned.transforms[one].translation,
                                          turned.transforms[one].rotation)),
                (qd, coordinates.twist[k], (turned.twist[one].linear, turned.twist[one].angular)),
                (effort, coordinates.twist[k], (turned.wrench[one].force,
                                                turned.wrench[one].torque))):
            reported = np.array([*numbers(given[0]), *numbers(given[1])])
            values[places[places >= 0]] = reported[places >= 0]
            assert not reported[places < 0].any()
    return q, qd, effort


# A ball, which hands over no moment; a pin with an equation that repeats others; joints of
# several freedoms in the tree.
@pytest.mark.parametrize('name', cases.only(
    ('rssr_four_bar', 'floater'), ('rssr_four_bar', 'bricard', 'floater')))
def test_published_states_and_forces_are_those_of_the_library(make_node, listener, tmp_path, name):
    path = file_of(made(name), tmp_path)
    node = stepped_node(make_node, path)
    mechanism = node.simulation.mechanism
    trees, cuts = mechanism.coordinates, mechanism.cut_coordinates
    states = listener.listen('joint_states', JointState)
    forces = [listener.listen(f'constraint_forces/{cut.name}', WrenchStamped)
              for cut in mechanism.cut_joints]
    turned = listener.listen('multi_dof_joint_states', MultiDOFJointState)
    heard = [states, *forces, *([turned] if (
        trees.with_orientation or cuts.with_orientation) else [])]
    # Publishers and subscribers have found each other.
    listener.wait(lambda: not step_back(node) and all(heard), 'a first state')
    command = [0.1, -0.2, 0.3, 0.2, 0.1] if name == 'floater' else [0.05]
    node.on_torque_command(Float64MultiArray(data=command))
    library = Simulation.from_scene(path)
    for _ in range(3):
        step(node)
        library.step(command, 20 * library.step_size)
        stamp = node.states.stamp
        listener.wait(lambda: all(each[-1].header.stamp == stamp for each in heard),
                      'the state after the steps')
        latest = turned[-1] if turned else None
        assert states[-1].name == [*trees.single_names, *cuts.single_names]
        assert not turned or latest.joint_names == [*trees.with_orientation,
                                                    *cuts.with_orientation]
        for found, expected in zip(
                (*quantities(trees, states[-1], latest), *quantities(cuts, states[-1], latest)),
                (library.position, library.velocity, library.effort, library.cut_position,
                 library.cut_velocity, library.cut_effort)):
            assert found.tolist() == expected.tolist()
        for each, expected in zip(forces, library.constraint_forces):
            wrench = each[-1].wrench
            assert [*numbers(wrench.torque), *numbers(wrench.force)] == expected.tolist()
    for wrench in library.constraint_forces:
        assert min(map(abs, wrench[3:])) > 1e-3
        assert (max(map(abs, wrench[:3])) > 1e-3) == (name == 'bricard')
    if name == 'floater':
        # Efforts by name.
        node.on_joint_command(JointState(name=['ball.rz', 'hip.1'], effort=[0.5, 0.7]))
        assert node.command.torque.tolist() == [0.7, -0.2, 0.3, 0.2, 0.5]
    assert node.exit_code is None


def step_back(node):
    """Reset a node, which publishes its state; return whether that failed."""
    return not node.on_reset(Trigger.Request(), Trigger.Response()).success


def test_states_are_set_and_the_start_is_come_back_to(make_node, tmp_path):
    node = stepped_node(make_node, file_of(made('rssr_four_bar'), tmp_path))
    start = node.simulation.position
    step(node)
    node.on_set_state(JointState(name=['crank', 'tip_3'], position=[0.4, 0.1]))
    assert node.counts == {'states set': 1, 'states refused': 0}
    position = dict(zip(node.simulation.joint_names, node.simulation.position))
    assert (position['crank'], position['tip_3']) == pytest.approx((0.4, 0.1), abs=1e-12)
    assert node.simulation.closure < 1e-12
    # The rod does not reach.
    node.on_set_state(JointState(name=['crank', 'rocker'], position=[3.0, 3.0]))
    assert node.counts == {'states set': 1, 'states refused': 1}
    assert not step_back(node)
    assert node.simulation.position.tolist() == start.tolist()


def test_orientations_are_set_from_a_topic(make_node, tmp_path):
    node = stepped_node(make_node, file_of(made('floater'), tmp_path))
    pose, twist = Transform(), Twist()
    pose.rotation.x, pose.rotation.w = 0.6, 0.8
    twist.angular.y = 2.0
    message = MultiDOFJointState(joint_names=['ball'], transforms=[pose], twist=[twist])
    before = node.simulation.position
    node.on_set_multi_dof_state(message)
    assert node.counts == {'states set': 1, 'states refused': 0}
    assert node.simulation.position.tolist() == [*before[:-4], 0.6, 0.0, 0.0, 0.8]
    assert node.simulation.velocity[-3:].tolist() == [0.0, 2.0, 0.0]
    # One number of a universal joint.
    node.on_set_state(JointState(name=['hip.2'], position=[0.4]))
    assert node.simulation.position[8] == 0.4
    pose.rotation.w = 0.9
    node.on_set_multi_dof_state(message)
    pose.rotation.w, pose.translation.z = 0.8, 0.1
    node.on_set_multi_dof_state(message)
    node.on_set_state(JointState(name=['ball'], position=[0.4]))
    node.on_set_multi_dof_state(MultiDOFJointState(joint_names=['hip'], transforms=[pose]))
    assert node.counts == {'states set': 2, 'states refused': 4}


def test_an_idle_spin_needs_no_number(make_node, tmp_path):
    mechanism, _ = spatial_machines.rssr_four_bar()
    node = stepped_node(make_node, file_of(scene_in_space(mechanism), tmp_path))
    node.on_set_state(JointState(name=['crank'], position=[0.3]))
    assert node.counts == {'states set': 1, 'states refused': 0}
    assert node.simulation.position[0] == 0.3
    assert node.simulation.closure < 1e-12


def test_effects_are_changed_by_vectors_of_three_numbers(make_node, tmp_path):
    node = stepped_node(make_node, file_of(made('rssr_four_bar'), tmp_path))
    name, moon = 'effects.gravity.acceleration', [0.0, 0.0, -1.62]
    refused, taken = (node.set_parameters([Parameter(name, value=value)])[0]
                      for value in ([0.0, -1.62], moon))
    assert not refused.successful and '3 finite numbers' in refused.reason
    assert taken.successful
    assert node.simulation.effects['gravity'].acceleration == tuple(moon)


@pytest.mark.parametrize('name, unique', [('rssr_four_bar', True), ('bricard', False)])
def test_diagnostics_tell_whether_forces_are_unique(
        make_node, tmp_path, monkeypatch, name, unique):
    node = stepped_node(make_node, file_of(made(name), tmp_path))
    step(node)
    sent = []
    monkeypatch.setattr(node.diagnostics, 'report', sent.append)
    node.publish_diagnostics()
    findings, = sent
    messages = {key: finding.message for key, finding in findings.items()}
    assert messages['closure'] == 'closed'
    assert messages['energy'] == 'balanced'
    assert messages['elimination'] == ('well posed' if unique else (
        '1 of 5 closure equations depend on the others: the constraint forces are not unique, the '
        'least ones are shown'))


def points_of(marker):
    return np.array([(each.x, each.y, each.z) for each in marker.points])


@pytest.mark.parametrize('name', ['rssr_four_bar', 'bricard'])
def test_markers_are_where_the_machine_is(make_node, tmp_path, name):
    one = made(name)
    mechanism = one.mechanism
    point = Point('tip', mechanism.bodies[2].name, mechanism.bodies[2].center_of_mass)
    path = file_of(replace(one, mechanism=replace(mechanism, points=(point,))), tmp_path)
    node = stepped_node(make_node, path)
    for _ in range(25):
        node.simulation.step(duration=0.02)
        by_name = {}
        for marker in node.markers.array(Time(sec=3)).markers:
            by_name.setdefault(marker.ns, []).append(marker)
    poses = node.simulation.body_poses
    names = [body.name for body in mechanism.bodies]
    links = [marker for marker, _ in node.markers.links]
    assert links == by_name['links'] + by_name['joint_axes']
    # Bars have all that the description places on them, and axes go through their joints.
    assert len(by_name['links']) == sum(not body.massless for body in mechanism.bodies)
    for marker, body in node.markers.links:
        pose = marker.pose
        np.testing.assert_array_equal(poses[body], [
            getattr(part, key) for part, keys in (
                (pose.position, 'xyz'), (pose.orientation, 'xyzw')) for key in keys])
        ends = points_of(marker)
        if marker.ns == 'joint_axes':
            assert np.abs(np.cross(ends[0] - ends[1], ends[0])).max() < 1e-12 or (
                marker is by_name['joint_axes'][-1])
        else:
            marked = marked_points(mechanism, names[body])
            assert {tuple(end) for end in ends} <= {tuple(place) for place in marked}
    cut, = mechanism.cut_joints
    place = node.markers.cut_place(cut, poses)
    np.testing.assert_allclose(points_of(by_name['cut_joints'][0]), [place])
    start, end = points_of(by_name['constraint_forces'][0])
    np.testing.assert_allclose(start, place)
    force = node.simulation.constraint_forces[0, 3:]
    np.testing.assert_allclose(
        (end - start) / np.linalg.norm(end - start), force / np.linalg.norm(force), atol=1e-12)
    trail = points_of(by_name['path'][0])
    assert len(trail) > 3
    assert np.linalg.norm(trail[-1] - node.simulation.point('tip')) < 0.02


# Of the last, bodies on joints without an orientation have no frames unless all links are asked
# for.
@pytest.mark.parametrize('name', ['bricard', 'tilted', 'floater'])
def test_frames_are_where_cut_points_and_links_are(broadcast, tmp_path, name):  # noqa: F811
    one = made(name)
    mechanism, everything = one.mechanism, name != 'floater'
    points = [Point(f'at_{cut.name}', cut.body_a, cut.point_a) for cut in mechanism.cut_joints]
    points += [Point(f'{body.name}_{k}', body.name, tuple(place)) for body in mechanism.bodies
               for k, place in enumerate([np.zeros(3), *np.eye(3)])]
    path = file_of(replace(one, mechanism=replace(mechanism, points=tuple(points))), tmp_path)
    node, found = broadcast(scene=path, **({'publish_tf': True} if everything else {}))
    places = dict(zip([point.name for point in points], node.simulation.points))
    bodies = [body.name for body in mechanism.bodies]
    expected = {f'constraint_forces/{cut.name}': (places[f'at_{cut.name}'], np.eye(3))
                for cut in mechanism.cut_joints}
    for body in bodies if everything else ('hull', 'hand'):
        origin, *ends = (places[f'{body}_{k}'] for k in range(4))
        expected[body] = origin, (np.array(ends) - origin).T
    if everything:
        expected['ground'] = np.zeros(3), np.eye(3)
    # Those that move, then those that do not.
    assert list(found) == list(expected)
    for frame, (origin, axes) in expected.items():
        assert everything or found[frame].header.frame_id == 'world'
        place, turn = found[frame].transform.translation, found[frame].transform.rotation
        np.testing.assert_allclose(numbers(place), origin, atol=1e-14)
        np.testing.assert_allclose(matrix(numbers(turn)), axes, atol=1e-14)


def test_computed_torque_leads_a_machine_in_space(make_node, tmp_path):
    path = file_of(made('rssr_four_bar'), tmp_path)
    values = {'mode': 'computed_torque', 'scene': path, 'kp': [100.0], 'kd': [20.0],
              'wait_for_subscribers': 0}
    node = make_node(TorqueSourceNode, **values, target_position=[0.2])
    one = Simulation(made('rssr_four_bar'))
    state = JointState(name=list(one.joint_names), position=one.position.tolist(),
                       velocity=one.velocity.tolist(), effort=[0.0] * len(one.joint_names))
    sent = []
    node.publisher.publish = sent.append
    node.on_joint_states(state)
    # From rest: kp times the distance.
    acceleration, _ = one.forward_dynamics(one.position, one.velocity, sent[-1].data)
    np.testing.assert_allclose(acceleration[0], 100.0 * 0.2, rtol=1e-9)


def test_description_of_the_robot_has_floating_joints_and_chains(make_node, listener, tmp_path):
    node = stepped_node(make_node, file_of(made('floater'), tmp_path))
    reported = []
    listener.node.create_subscription(String, 'robot_description', reported.append, LATCHED_QOS)
    listener.wait(lambda: reported, 'the description')
    assert node.exit_code is None
    robot = ElementTree.fromstring(reported[0].data)
    assert {joint.get('name'): joint.get('type') for joint in robot.findall('joint')} == {
        'world_to_ground': 'fixed', 'hull': 'floating', 'hip.1': 'continuous',
        'hip.2': 'continuous', 'ball': 'floating'}
    driven = robot.find('ros2_control').findall('joint')
    assert [joint.get('name') for joint in driven] == ['hip.1', 'hip.2']
