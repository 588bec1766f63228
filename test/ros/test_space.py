# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The simulator runs mechanisms in space: states, forces of six components, frames, bags."""

from dataclasses import replace
import json
from test.reference import cases
from test.reference.spatial_maximal import matrix
from test.ros.test_frames import broadcast  # noqa: F401
from test.simulation.test_space import machine, scene, tilted_four_bar, TURN
from xml.etree import ElementTree

from builtin_interfaces.msg import Time
from closedloop_dynamics.mechanism.mechanism import Point
from closedloop_dynamics.ros.auxiliary_publishers import LATCHED_QOS
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.torque_source_node import TorqueSourceNode
from closedloop_dynamics.simulation.scene import load_scene
from closedloop_dynamics.simulation.scene_text import scene_text
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.appearance import marked_points
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from sensor_msgs.msg import MultiDOFJointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import String
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger


def file_of(made, directory):
    """Write a scene and its mechanism, and return the scene's path."""
    told = json.loads(scene_text(made))
    path = directory / f'{made.name}.yaml'
    path.write_text(json.dumps(told['scene']))
    (directory / 'mechanism.yaml').write_text(json.dumps(told['mechanism']))
    return str(path)


def made(name):
    """Return the scene of a machine in space."""
    if name == 'tilted':
        _, mechanism, axes = tilted_four_bar(TURN)
        return replace(scene(mechanism, tuple(axes @ (0.0, -9.81, 0.0))),
                       initial=load_scene('four_bar').initial)
    mechanism, _ = machine(name)
    first, *others = mechanism.joints
    return scene(replace(mechanism, joints=(replace(first, actuated=True), *others)),
                 gravity=(0.0, -9.81, 1.0))


def stepped_node(make_node, path, **parameters):
    """Return a node that only moves when asked to."""
    node = make_node(SimulatorNode, scene=path, step_count=20, **parameters)
    node.timer.cancel()
    node.on_pause(SetBool.Request(data=True), SetBool.Response())
    return node


def step(node):
    assert node.on_step(Trigger.Request(), Trigger.Response()).success


# A ball, which hands over no moment; a pin with an equation that repeats others.
@pytest.mark.parametrize('name', cases.first(1, ('rssr_four_bar', 'bricard')))
def test_published_states_and_forces_are_those_of_the_library(make_node, listener, tmp_path, name):
    path = file_of(made(name), tmp_path)
    node = stepped_node(make_node, path)
    mechanism = node.simulation.mechanism
    cut = mechanism.cut_joints[0].name
    states = listener.listen('joint_states', JointState)
    forces = listener.listen(f'constraint_forces/{cut}', WrenchStamped)
    turned = listener.listen('multi_dof_joint_states', MultiDOFJointState)
    # Publishers and subscribers have found each other.
    listener.wait(lambda: not step_back(node) and states and forces, 'a first state')
    node.on_torque_command(Float64MultiArray(data=[0.05]))
    library = Simulation.from_scene(path)
    for _ in range(3):
        step(node)
        library.step([0.05], 20 * library.step_size)
        stamp = node.states.stamp
        listener.wait(lambda: states[-1].header.stamp == stamp
                      and forces[-1].header.stamp == stamp, 'the state after the steps')
        cuts = mechanism.cut_coordinates
        numbers = cuts.place[cuts.single]
        assert states[-1].name == [*mechanism.joint_names, *cuts.single_names]
        assert list(states[-1].position) == [*library.position, *library.cut_position[numbers]]
        assert list(states[-1].velocity) == [*library.velocity, *library.cut_velocity[cuts.single]]
        assert list(states[-1].effort) == [*library.effort, *library.cut_effort[cuts.single]]
        if cuts.with_orientation:
            listener.wait(lambda: turned and turned[-1].header.stamp == stamp, 'orientations')
            assert turned[-1].joint_names == list(cuts.with_orientation)
            (pose,), (twist,) = turned[-1].transforms, turned[-1].twist
            turn, rate = pose.rotation, twist.angular
            assert [turn.x, turn.y, turn.z, turn.w] == library.cut_position.tolist()
            assert [rate.x, rate.y, rate.z] == library.cut_velocity.tolist()
        force, torque = forces[-1].wrench.force, forces[-1].wrench.torque
        assert [torque.x, torque.y, torque.z, force.x, force.y, force.z] == (
            library.constraint_forces[0].tolist())
    assert min(abs(part) for part in (force.x, force.y, force.z)) > 1e-3
    assert (max(map(abs, (torque.x, torque.y, torque.z))) > 1e-3) == (name == 'bricard')
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


def test_description_of_the_robot_is_that_of_the_mechanism(make_node, listener, tmp_path):
    node = stepped_node(make_node, file_of(made('rssr_four_bar'), tmp_path))
    told = []
    listener.node.create_subscription(String, 'robot_description', told.append, LATCHED_QOS)
    listener.wait(lambda: told, 'the description')
    robot = ElementTree.fromstring(told[0].data)
    assert {joint.get('name') for joint in robot.findall('joint')} == {
        'world_to_ground', *node.simulation.joint_names}


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


@pytest.mark.parametrize('name', ['bricard', 'tilted'])
def test_frames_are_where_cut_points_and_links_are(broadcast, tmp_path, name):  # noqa: F811
    one = made(name)
    mechanism = one.mechanism
    cut = mechanism.cut_joints[0]
    points = [Point('cut_point', cut.body_a, cut.point_a)]
    points += [Point(f'{body.name}_{k}', body.name, tuple(place)) for body in mechanism.bodies
               for k, place in enumerate([np.zeros(3), *np.eye(3)])]
    path = file_of(replace(one, mechanism=replace(mechanism, points=tuple(points))), tmp_path)
    node, found = broadcast(scene=path, publish_tf=True)
    places = dict(zip([point.name for point in points], node.simulation.points))
    # Those that move, then those that do not.
    assert list(found) == [
        f'constraint_forces/{cut.name}', *(body.name for body in mechanism.bodies), 'ground']
    expected = {f'constraint_forces/{cut.name}': (places['cut_point'], np.eye(3)),
                'ground': (np.zeros(3), np.eye(3))}
    for body in mechanism.bodies:
        origin, *ends = (places[f'{body.name}_{k}'] for k in range(4))
        expected[body.name] = origin, (np.array(ends) - origin).T
    for frame, (origin, axes) in expected.items():
        place, turn = found[frame].transform.translation, found[frame].transform.rotation
        np.testing.assert_allclose([place.x, place.y, place.z], origin, atol=1e-14)
        np.testing.assert_allclose(matrix((turn.x, turn.y, turn.z, turn.w)), axes, atol=1e-14)


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
