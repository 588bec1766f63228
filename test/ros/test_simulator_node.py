# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the simulator node by calling its callbacks; nothing spins."""

import math
from pathlib import Path
from test.ros.test_control import advance, FakeClock

from closedloop_dynamics import Simulation
from closedloop_dynamics.mechanism import validation
from closedloop_dynamics.mechanism.document import Document
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.simulator_node import SimulatorNode
import numpy as np
import pytest
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

ACTUATED = ['theta_1', 'theta_6', 'theta_7']


@pytest.fixture
def node(make_node, monkeypatch):
    """Return a node of the 3-RRR whose time stands still, and what it publishes."""
    node = make_node(SimulatorNode, scene='three_rrr')
    node.clock = FakeClock()
    node.pacer.clock = node.clock
    node.pacer.start()
    node.seen, node.warnings = [], []
    publish = node.states.publish
    node.wrenches = []

    def note(stamp, position, velocity, effort, forces, cuts):
        node.seen.append((position.tolist(), velocity.tolist(), effort.tolist()))
        node.wrenches = forces.tolist()
        publish(stamp, position, velocity, effort, forces, cuts)

    monkeypatch.setattr(node.states, 'publish', note)
    monkeypatch.setattr(node, 'warn', lambda throttle, text: node.warnings.append(text))
    return node


def test_tick_gives_the_same_motion_as_the_library(node):
    torque = [5.0, -3.0, 2.0]
    node.on_torque_command(Float64MultiArray(data=torque))
    advance(node, 0.1, ticks=10)
    simulation = Simulation.from_scene('three_rrr')
    simulation.step(torque, 0.1)
    assert node.simulation.time == pytest.approx(0.1, abs=1e-12)
    position, velocity, effort = node.seen[-1]
    assert position == simulation.position.tolist()
    assert velocity == simulation.velocity.tolist()
    assert effort == [5.0, 0.0, 0.0, 0.0, 0.0, -3.0, 2.0]
    assert node.wrenches == simulation.constraint_forces.tolist()
    assert node.states.published == 10 * 3


def test_state_is_published_though_no_step_was_due(node):
    advance(node, 0.0)
    assert len(node.seen) == 1
    assert node.simulation.time == 0.0


def test_named_command_drives_the_joints_it_names(node):
    node.on_joint_command(JointState(name=['theta_7', 'theta_1'], effort=[2.0, 1.0]))
    node.on_joint_command(JointState(name=['theta_6'], effort=[3.0]))
    advance(node, 0.01)
    assert node.seen[-1][2] == [1.0, 0.0, 0.0, 0.0, 0.0, 3.0, 2.0]


@pytest.mark.parametrize('data', [
    [], [1.0], [1.0] * 4, [math.nan, 0.0, 0.0], [0.0, math.inf, 0.0], [1.0] * 100000])
def test_bad_torque_command_is_refused_by_name_and_the_last_one_stays(node, data):
    node.on_torque_command(Float64MultiArray(data=[1.0, 2.0, 3.0]))
    node.on_torque_command(Float64MultiArray(data=data))
    advance(node, 0.01)
    assert node.seen[-1][2] == [1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 3.0]
    assert len(node.warnings) == 1
    assert node.warnings[0].startswith('torque_command rejected: ')
    assert [node.command.counts[key] for key in ('accepted', 'rejected')] == [1, 1]


@pytest.mark.parametrize('name, effort, problem', [
    (['theta_1'], [], 'one effort per name'),
    ([], [], 'no joint'),
    (['theta_2'], [1.0], "'theta_2' is not actuated"),
    (['wheel'], [1.0], "'wheel' is not a joint"),
    (['theta_1'], [math.inf], 'inf'),
])
def test_bad_joint_command_is_refused_by_name_and_the_last_one_stays(
        node, name, effort, problem):
    node.on_torque_command(Float64MultiArray(data=[1.0, 2.0, 3.0]))
    node.on_joint_command(JointState(name=name, effort=effort))
    advance(node, 0.01)
    assert node.seen[-1][2] == [1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 3.0]
    assert node.warnings[0].startswith('joint_command rejected: ')
    assert problem in node.warnings[0]


@pytest.mark.parametrize('torque', [1e308, -1e200, 1e20])
def test_torques_that_no_step_can_follow_are_refused_and_nothing_changes(node, torque):
    node.on_torque_command(Float64MultiArray(data=[1.0, 2.0, 3.0]))
    advance(node, 0.01)
    node.on_torque_command(Float64MultiArray(data=[0.0, torque, 0.0]))
    node.on_joint_command(JointState(name=['theta_6'], effort=[torque]))
    assert len(node.warnings) == 2
    assert all('rejected: torque: expected torques that a step of' in text
               for text in node.warnings)
    assert node.command.torque.tolist() == [1.0, 2.0, 3.0]
    advance(node, 0.01)
    assert node.exit_code is None
    assert np.abs(node.simulation.velocity).max() < 1.0


def test_state_that_leaves_the_finite_numbers_stops_and_publishes_nothing_false(node):
    advance(node, 0.01)
    node.command.torque[0] = 1e300
    advance(node, 0.01)
    assert node.exit_code == 1
    assert len(node.seen) == 1
    assert np.isfinite(node.seen[0][0]).all()


def test_forces_that_are_not_finite_are_not_published(node, monkeypatch):
    monkeypatch.setattr(
        type(node.simulation.data), 'constraint_forces', np.full((2, 3), np.nan))
    advance(node, 0.01)
    assert node.exit_code == 1
    assert node.seen == []


def test_overload_is_reported_with_the_factor_and_does_not_spiral(node, monkeypatch):
    messages = []
    node.throttles['overload'].period = 0.0
    monkeypatch.setattr(
        node.pacer, 'overload', lambda: messages.append(node.pacer.achieved) or '')
    steps = node.simulation.advance

    def slow(tau, count):
        node.clock.now += 0.003 * count
        steps(tau, count)

    monkeypatch.setattr(node.simulation, 'advance', slow)
    for _ in range(50):
        before = node.clock.now
        node.clock.now += 0.002
        node.tick()
        assert node.clock.now - before < 0.02
    assert messages[-1] == pytest.approx(0.3, abs=0.15)
    assert node.pacer.dropped > 0.0


def test_time_can_wait_for_the_first_command(make_node):
    node = make_node(SimulatorNode, scene='three_rrr', wait_for_command=True)
    clock = node.pacer.clock = FakeClock()
    clock.now += 1.0
    node.tick()
    node.on_torque_command(Float64MultiArray(data=[1.0]))
    clock.now += 1.0
    node.tick()
    assert node.simulation.time == 0.0
    assert node.states.published == 2 * 3
    node.on_torque_command(Float64MultiArray(data=[1.0, 2.0, 3.0]))
    clock.now += 0.01
    node.tick()
    assert node.simulation.time == pytest.approx(0.01)
    assert node.pacer.elapsed == pytest.approx(0.01)


def test_no_command_for_too_long_means_no_torque(node, monkeypatch):
    node.set_parameters([Parameter('command_timeout', value=0.5)])
    assert node.command.timeout == 0.5
    steady = FakeClock()
    monkeypatch.setattr('closedloop_dynamics.ros.simulator_node.time.monotonic', steady)
    node.on_torque_command(Float64MultiArray(data=[1.0, 2.0, 3.0]))
    steady.now += 0.4
    advance(node, 0.01)
    assert any(node.seen[-1][2])
    steady.now += 0.2
    advance(node, 0.01)
    assert not any(node.seen[-1][2])
    assert node.command.counts['timed out'] == 1


def test_late_tick_holds_no_command_longer_than_the_timeout(node):
    node.set_parameters([Parameter('command_timeout', value=0.025)])
    advance(node, 0.0)
    node.on_torque_command(Float64MultiArray(data=[1.0, 2.0, 3.0]))
    # Six ticks were slept through; the command was taken in just now. It ends in the third period.
    advance(node, 0.06)
    assert [any(effort) for _, _, effort in node.seen[-6:]] == 2 * [True] + 4 * [False]


def test_parameters_that_can_change_take_effect(node):
    results = node.set_parameters([
        Parameter('publish_rate', value=200.0), Parameter('real_time_factor', value=0.5)])
    assert all(result.successful for result in results)
    assert node.timer.timer_period_ns == 5_000_000
    advance(node, 0.02)
    assert node.simulation.time == pytest.approx(0.01)


@pytest.mark.parametrize('name, value', [
    ('scene', 'four_bar'), ('mode', 'lockstep'), ('actuated_joints', ['theta_1']),
    ('step_size', -0.002), ('step_size', 1e-320), ('integrator', 'magic'),
    ('integrator', 'scipy_radau'),
    ('stabilisation', 'glue'), ('step_count', 0),
    ('publish_rate', 0.0), ('publish_rate', 1e9), ('real_time_factor', -1.0),
    ('real_time_factor', math.nan), ('command_timeout', -0.1), ('command_timeout', 'long')])
def test_parameters_that_cannot_change_are_refused_with_a_reason(node, name, value):
    before = node.get_parameter(name).value
    result, = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert name in result.reason or 'type' in result.reason
    assert node.get_parameter(name).value == before


@pytest.mark.parametrize('name', ['', 'no_such'])
def test_undeclared_parameters_are_refused_by_name(node, name):
    with pytest.raises(ParameterNotDeclaredException, match=repr(name)):
        node.set_parameters([Parameter(name, value=1.0)])
    assert not node.has_parameter(name)


def test_parameters_are_described(node):
    for name in ('scene', 'publish_rate', 'step_size', 'real_time_factor', 'command_timeout',
                 'actuated_joints'):
        descriptor = node.describe_parameter(name)
        assert len(descriptor.description) > 20
        if name not in ('scene', 'actuated_joints'):
            assert '[' in descriptor.description
            assert descriptor.floating_point_range[0].to_value > 0.0
    assert node.get_parameter('actuated_joints').value == ACTUATED


@pytest.mark.parametrize('parameters, problem', [
    ({'scene': 'no_such'}, 'no_such'),
    ({'scene': '/no/such/file.yaml'}, '/no/such/file.yaml'),
    ({'scene': 3}, "'scene': expected a string"),
    ({'publish_rate': '100'}, "'publish_rate': expected a number"),
    ({'publish_rate': True}, "'publish_rate': expected a number"),
    ({'publish_rate': 0}, 'publish_rate out of range'),
    ({'publish_rate': 0.0}, 'publish_rate out of range'),
    ({'step_size': -0.001}, 'step_size out of range'),
    ({'step_size': 1e-320}, 'step_size: expected a number of at least 1e-09'),
    ({'real_time_factor': math.inf}, 'real_time_factor out of range'),
])
def test_node_with_a_bad_parameter_does_not_start(make_node, parameters, problem):
    with pytest.raises(StartError, match=problem):
        make_node(SimulatorNode, **parameters)


def test_whole_numbers_serve_as_floating_point_ones(make_node):
    node = make_node(SimulatorNode, scene='four_bar', publish_rate=200, marker_rate=0)
    assert node.get_parameter('publish_rate').value == 200.0
    for value in (50, 50.5):
        result, = node.set_parameters([Parameter('publish_rate', value=value)])
        assert result.successful, result.reason
        assert node.get_parameter('publish_rate').value == value
        assert node.get_parameter('publish_rate').type_ == Parameter.Type.DOUBLE
    result, = node.set_parameters([Parameter('publish_rate', value=0)])
    assert not result.successful and node.get_parameter('publish_rate').value == 50.5
    # The other way round nothing is rounded.
    result, = node.set_parameters([Parameter('step_count', value=2.0)])
    assert not result.successful


def test_scene_is_read_and_validated_once(make_node, monkeypatch):
    read, checked = [], []
    begin, check = Document.__init__, validation.check_tree
    monkeypatch.setattr(Document, '__init__', lambda self, path, *more: (
        read.append(Path(path).parent.name), begin(self, path, *more))[1])
    monkeypatch.setattr(validation, 'check_tree', lambda mechanism: (
        checked.append(mechanism.name), check(mechanism)))
    make_node(SimulatorNode, scene='four_bar', step_size=0.002, integrator='rk4')
    assert (read, checked) == (['scenes', 'mechanisms'], ['four_bar'])


def test_step_size_of_the_parameter_is_used(make_node):
    node = make_node(SimulatorNode, scene='four_bar', step_size=0.002)
    assert node.simulation.step_size == node.pacer.step_size == 0.002


@pytest.mark.parametrize('scene', [
    'carpet_scraper', 'hoeken_pantograph_leg', 'four_bar', 'slider_crank'])
def test_every_shipped_scene_runs(make_node, scene):
    node = make_node(SimulatorNode, scene=scene)
    clock = node.pacer.clock = FakeClock()
    node.pacer.start()
    clock.now += 0.01
    node.tick()
    assert node.exit_code is None
    assert node.simulation.time == pytest.approx(0.01)
    assert node.states.published == 1 + len(node.simulation.mechanism.cut_joints)


def test_steps_in_a_pause_are_in_the_summary(node, capfd):
    advance(node, 0.05, ticks=5)
    node.pause(True)
    node.make_steps(7)
    assert node.simulation.time == pytest.approx(0.057)
    node.close()
    assert 'simulated 0.057 s' in capfd.readouterr().err
