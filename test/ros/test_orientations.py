# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The simulator runs joints with an orientation: their states, commands, frames, bags."""

from test.reference import spatial_machines
from test.reference.spatial_maximal import matrix
from test.ros.test_frames import broadcast  # noqa: F401
from test.ros.test_space import file_of, step, step_back, stepped_node
from test.simulation.test_orientations import scene
from xml.etree import ElementTree

from closedloop_dynamics.mechanism.mechanism import Body, Joint, Mechanism
from closedloop_dynamics.ros.auxiliary_publishers import LATCHED_QOS
from closedloop_dynamics.simulation.simulation import Simulation
from geometry_msgs.msg import Transform
from geometry_msgs.msg import Twist
import numpy as np
from sensor_msgs.msg import JointState
from sensor_msgs.msg import MultiDOFJointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import String


def machine():
    """Return a driven universal joint and a driven ball on a floating body."""
    bodies = tuple(Body(name, 1.0, (0.1, 0.0, 0.05), (0.02, 0.03, 0.04))
                   for name in ('hull', 'arm', 'hand'))
    return Mechanism('floater', bodies, (
        Joint('hull', 'free', 'ground', 'hull', (0.0, 0.0, 1.0)),
        Joint('hip', 'universal', 'hull', 'arm', (0.2, 0.0, 0.0), axis=(1.0, 0.0, 0.0),
              second_axis=(0.0, 1.0, 0.0), actuated=True),
        Joint('ball', 'spherical', 'arm', 'hand', (0.3, 0.0, 0.0), actuated=True)))


MOVING = {'velocity': {'hull': {'velocity': (0.1, 0.2, 0.3), 'angular_velocity': (1.0, 2.0, 3.0)}},
          'gravity': (0.0, 0.0, -1.0)}


def numbers(vector):
    return [vector.x, vector.y, vector.z]


def test_published_states_are_those_of_the_library(make_node, listener, tmp_path):
    path = file_of(scene(machine(), **MOVING), tmp_path)
    node = stepped_node(make_node, path)
    states = listener.listen('joint_states', JointState)
    turned = listener.listen('multi_dof_joint_states', MultiDOFJointState)
    listener.wait(lambda: not step_back(node) and states and turned, 'a first state')
    command = [0.1, -0.2, 0.3, 0.2, 0.1]
    node.on_torque_command(Float64MultiArray(data=command))
    library = Simulation.from_scene(path)
    for _ in range(2):
        step(node)
        library.step(command, 20 * library.step_size)
        stamp = node.states.stamp
        listener.wait(lambda: states[-1].header.stamp == stamp
                      and turned[-1].header.stamp == stamp, 'the state after the steps')
        state, other = states[-1], turned[-1]
        assert list(state.name) == ['hip.1', 'hip.2']
        assert list(state.position) == library.position[7:9].tolist()
        assert list(state.velocity) == library.velocity[6:8].tolist()
        assert list(state.effort) == command[:2]
        assert list(other.joint_names) == ['hull', 'ball']
        (hull, ball), (moving, turning), (force, torque) = (
            other.transforms, other.twist, other.wrench)
        found = [*numbers(hull.translation), *numbers(hull.rotation), hull.rotation.w,
                 *state.position, *numbers(ball.rotation), ball.rotation.w]
        assert found == library.position.tolist()
        rates = [*numbers(moving.linear), *numbers(moving.angular), *state.velocity,
                 *numbers(turning.angular)]
        assert rates == library.velocity.tolist()
        assert numbers(ball.translation) == numbers(turning.linear) == 3 * [0.0]
        assert numbers(torque.torque) == command[2:]
        assert numbers(force.force) == numbers(force.torque) == 3 * [0.0]
    # Efforts by name.
    node.on_joint_command(JointState(name=['ball.rz', 'hip.1'], effort=[0.5, 0.7]))
    assert node.command.torque.tolist() == [0.7, -0.2, 0.3, 0.2, 0.5]
    assert node.exit_code is None


def test_orientations_are_set_from_a_topic(make_node, tmp_path):
    node = stepped_node(make_node, file_of(scene(machine(), **MOVING), tmp_path))
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
    node = stepped_node(make_node, file_of(scene(mechanism), tmp_path))
    node.on_set_state(JointState(name=['crank'], position=[0.3]))
    assert node.counts == {'states set': 1, 'states refused': 0}
    assert node.simulation.position[0] == 0.3
    assert node.simulation.closure < 1e-12


def test_links_on_orientations_are_among_the_frames(broadcast, tmp_path):  # noqa: F811
    node, found = broadcast(scene=file_of(scene(machine(), **MOVING), tmp_path))
    assert list(found) == ['hull', 'hand']
    poses = dict(zip(('hull', 'arm', 'hand'), node.simulation.body_poses))
    for frame, transform in found.items():
        assert transform.header.frame_id == 'world'
        place, turn = transform.transform.translation, transform.transform.rotation
        np.testing.assert_allclose(numbers(place), poses[frame][:3], atol=1e-14)
        np.testing.assert_allclose(
            matrix((*numbers(turn), turn.w)), matrix(poses[frame][3:]), atol=1e-14)


def test_description_of_the_robot_has_floating_joints_and_chains(make_node, listener, tmp_path):
    node = stepped_node(make_node, file_of(scene(machine()), tmp_path))
    told = []
    listener.node.create_subscription(String, 'robot_description', told.append, LATCHED_QOS)
    listener.wait(lambda: told, 'the description')
    assert node.exit_code is None
    robot = ElementTree.fromstring(told[0].data)
    assert {joint.get('name'): joint.get('type') for joint in robot.findall('joint')} == {
        'world_to_ground': 'fixed', 'hull': 'floating', 'hip.1': 'continuous',
        'hip.2': 'continuous', 'ball': 'floating'}
    driven = robot.find('ros2_control').findall('joint')
    assert [joint.get('name') for joint in driven] == ['hip.1', 'hip.2']
