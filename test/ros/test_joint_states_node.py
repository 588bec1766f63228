# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The node that completes joint states: by its callbacks, and beside a simulator as a process."""

import math

from closedloop_dynamics import Simulation
from closedloop_dynamics.ros.auxiliary_publishers import LATCHED_QOS
from closedloop_dynamics.ros.joint_states_node import JointStatesNode, pose_finding
from closedloop_dynamics.ros.process import StartError
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import String

SIMULATOR, NODE = 'closedloop_simulator', 'closedloop_joint_states'
DRIVES = ['theta_7', 'theta_1', 'theta_6']


@pytest.fixture
def build(make_node, monkeypatch):
    """Return a function that builds a node, and keeps what it publishes."""
    def make(**parameters):
        node = make_node(JointStatesNode, **parameters)
        node.seen = []
        monkeypatch.setattr(node.states, 'publish', lambda *state: node.seen.append(state))
        return node
    return make


def measured(simulation, names, **others):
    """Return what a robot would send of some joints of a simulation, in any order."""
    index = [simulation.joint_names.index(name) for name in names]
    return JointState(name=names, position=simulation.position[index].tolist(),
                      velocity=simulation.velocity[index].tolist(), **others)


def test_all_joints_follow_from_the_driven_ones(build):
    node, simulation = build(scene='three_rrr_horizontal'), Simulation.from_scene(
        'three_rrr_horizontal')
    for _ in range(5):
        simulation.step([1.0, -2.0, 0.5], 0.01)
        message = measured(simulation, DRIVES, effort=[0.5, 1.0, -2.0])
        message.header.stamp = Time(nanoseconds=round(1e9 * simulation.time)).to_msg()
        node.on_joint_states(message)
    assert node.counts == {'completed': 5, 'not usable': 0, 'not closed': 0}
    stamp, position, velocity, effort, _, cuts = node.seen[-1]
    assert stamp == 50_000_000
    np.testing.assert_allclose(position, simulation.position, atol=1e-11)
    np.testing.assert_allclose(velocity, simulation.velocity, atol=1e-10)
    assert effort.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.5]
    np.testing.assert_allclose(cuts[0], simulation.cut_position, atol=1e-11)
    np.testing.assert_allclose(cuts[1], simulation.cut_velocity, atol=1e-10)


def test_forces_are_those_of_the_model_under_the_measured_efforts(build):
    node, simulation = build(scene='three_rrr', forces=True), Simulation.from_scene('three_rrr')
    for _ in range(3):
        simulation.step([1.0, -2.0, 0.5], 0.01)
        node.on_joint_states(measured(simulation, DRIVES, effort=[0.5, 1.0, -2.0]))
    assert np.abs(simulation.constraint_forces).max() > 0.1
    cuts = len(simulation.mechanism.cut_joints)
    np.testing.assert_allclose(node.seen[-1][4][:cuts], simulation.constraint_forces, rtol=1e-8)
    np.testing.assert_allclose(
        node.seen[-1][4][cuts:], simulation.joint_forces, rtol=1e-8, atol=1e-9)
    node.on_joint_states(measured(simulation, DRIVES))
    node.on_joint_states(measured(simulation, DRIVES, effort=[math.nan, 0.0, 0.0]))
    assert node.counts['not usable'] == 2 and len(node.seen) == 3


@pytest.mark.parametrize('change, kind', [
    ({'name': ['elbow']}, 'not usable'), ({'position': []}, 'not usable'),
    ({'velocity': [1.0, 2.0]}, 'not usable'), ({'position': [math.nan]}, 'not usable'),
    ({'position': [5.0]}, 'not closed'), ({'position': [1e9]}, 'not closed')])
def test_measurements_that_do_not_do_are_counted_and_nothing_is_published(build, change, kind):
    node = build(scene='slider_crank', joints=['slider_joint'])
    simulation = Simulation.from_scene('slider_crank')
    message = measured(simulation, ['slider_joint'])
    for key, value in change.items():
        setattr(message, key, value)
    node.on_joint_states(message)
    assert node.counts[kind] == 1 and not node.seen
    node.on_joint_states(measured(simulation, ['slider_joint']))
    assert len(node.seen) == 1


def test_currents_become_torques(build):
    node = build(scene='three_rrr', forces=True, joints=DRIVES, effort_factors=[0.5, 0.1, 10.0])
    simulation = Simulation.from_scene('three_rrr')
    simulation.step([1.0, -2.0, 0.5], 0.01)
    node.on_joint_states(measured(simulation, DRIVES, effort=[1.0, 10.0, -0.2]))
    assert node.seen[-1][3].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.5]
    np.testing.assert_allclose(
        node.seen[-1][4][:2], simulation.constraint_forces, rtol=1e-8)


class Pose:
    """What the finding looks at."""

    def __init__(self, residual=0.0, sine=0.5, passed=False):
        self.residual, self.sine, self.passed = residual, sine, passed


@pytest.mark.parametrize('pose, news, level, word', [
    (Pose(), {}, DiagnosticStatus.OK, 'closed'),
    (Pose(residual=0.01), {}, DiagnosticStatus.WARN, 'contradict one another by 0.01'),
    (Pose(sine=0.001), {}, DiagnosticStatus.WARN, 'near a singular position'),
    (Pose(passed=True), {}, DiagnosticStatus.ERROR, 'another branch'),
    (Pose(), {'not closed': 1}, DiagnosticStatus.ERROR, 'the reason'),
    (Pose(), {'not usable': 1}, DiagnosticStatus.WARN, 'the reason'),
    (Pose(), {'completed': 0}, DiagnosticStatus.WARN, 'no joint_states came')])
def test_health_of_a_pose_is_reported(pose, news, level, word):
    finding = pose_finding(
        pose, 1e-3, {'completed': 100, 'not usable': 0, 'not closed': 0, **news}, 'the reason')
    assert finding.level == level and word in finding.message


@pytest.mark.parametrize('parameters, problem', [
    ({}, "'scene': expected"), ({'scene': 'no_such'}, 'no_such'),
    ({'scene': 'four_bar', 'allow_code': ['none.py', 'no.py']},
     "'allow_code': .*none.py: FileNotF"),
    ({'scene': 'three_rrr', 'joints': ['theta_1']}, 'leave 2 of 3 degrees of freedom open'),
    ({'scene': 'four_bar', 'deviations': [0.0]}, 'positive'),
    ({'scene': 'four_bar', 'deviations': [1.0, 1.0]}, 'expected 1 positive'),
    ({'scene': 'four_bar', 'effort_factors': [1.0, 1.0]}, "'effort_factors': expected 1 value")])
def test_bad_parameters_are_refused(make_node, parameters, problem):
    with pytest.raises(StartError, match=problem):
        make_node(JointStatesNode, **parameters)


def test_process_completes_what_a_simulator_publishes(processes, listener):
    node = processes.start(NODE, scene='three_rrr_horizontal', forces='true', remap=[
        'constraint_forces/cut_1:=estimated']).wait_until_ready()
    completed = listener.listen('complete_joint_states', JointState)
    forces = listener.listen('estimated', WrenchStamped)
    findings = listener.listen('/diagnostics', DiagnosticArray)
    # Which needs no more than the driven joints of these states.
    simulator = processes.start(SIMULATOR, scene='three_rrr_horizontal')
    states = listener.listen('joint_states', JointState)

    def met():
        by_stamp = {stamp(message): message for message in states}
        return [(by_stamp[stamp(message)], message) for message in completed
                if stamp(message) in by_stamp]

    listener.wait(lambda: len(met()) > 30 and forces, '30 completed states')
    for state, message in met():
        assert message.name == state.name
        np.testing.assert_allclose(message.position, state.position, atol=1e-10)
        np.testing.assert_allclose(message.velocity, state.velocity, atol=1e-9)
    listener.wait(lambda: any(status.name.endswith(': pose') and status.message == 'closed'
                              for message in findings for status in message.status), 'a finding')
    description = []
    listener.node.create_subscription(
        String, 'robot_description', description.append, LATCHED_QOS)
    listener.wait(lambda: description, 'the description')
    assert simulator.stop() == 0
    assert node.stop() == 0
    assert ' completed, 0 not usable, 0 not closed' in node.output


def stamp(message):
    return Time.from_msg(message.header.stamp).nanoseconds
