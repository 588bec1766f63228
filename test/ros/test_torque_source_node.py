# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the torque source by calling its callbacks; nothing spins."""

from contextlib import nullcontext
import math
from types import SimpleNamespace

from builtin_interfaces.msg import Duration
from closedloop_dynamics import Simulation
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.torque_source_node import TorqueSourceNode
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint


@pytest.fixture
def make_source(make_node, monkeypatch):
    """Return a function that creates a torque source whose commands are kept."""
    def make(**parameters):
        parameters.setdefault('wait_for_subscribers', 0)
        node = make_node(TorqueSourceNode, **parameters)
        node.sent = []
        monkeypatch.setattr(node.publisher, 'publish', lambda message: node.sent.append(
            list(message.effort if isinstance(message, JointState) else message.data)))
        return node

    return make


def state(time, position, velocity, names=('a', 'b', 'c')):
    message = JointState(
        name=list(names), position=[float(value) for value in position],
        velocity=[float(value) for value in velocity])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(
        round(time * 1e9), 10 ** 9)
    return message


def test_constant_torques_go_to_the_joints_named(make_source):
    source = make_source(joints=['b', 'a'], torque=[1.0, 2.0])
    source.on_timer()
    assert source.command.name == ['b', 'a']
    assert source.sent == [[1.0, 2.0]]


def test_one_value_is_for_all_joints(make_source):
    source = make_source(joints=['b', 'a'], torque=[3.0])
    source.on_timer()
    assert source.sent == [[3.0, 3.0]]


def test_sine_is_about_the_torque(make_source, monkeypatch):
    source = make_source(
        mode='sine', joints=['a'], torque=[10.0], amplitude=[2.0], frequency=[0.5])
    now = [100.0]
    monkeypatch.setattr(
        'closedloop_dynamics.ros.torque_source_node.time.monotonic', lambda: now[0])
    for now[0] in (100.0, 100.5, 101.0, 101.5):
        source.on_timer()
    assert [values[0] for values in source.sent] == pytest.approx([10.0, 12.0, 10.0, 8.0])


def test_pd_reads_its_joints_by_name_in_any_order(make_source):
    source = make_source(
        mode='pd', joints=['c', 'a'], kp=[10.0, 20.0], kd=[1.0], target_position=[1.0, 2.0])
    source.on_joint_states(state(5.0, [0.5, 9.0, 0.8], [0.1, 9.0, -0.2]))
    expected = [10.0 * 0.2 + 0.2, 20.0 * 1.5 - 0.1]
    assert source.sent[0] == pytest.approx(expected)
    source.on_joint_states(state(5.1, [0.8, 0.5], [-0.2, 0.1], names=('c', 'a')))
    assert source.sent[1] == pytest.approx(expected)


def test_pd_without_target_holds_where_it_began(make_source):
    source = make_source(mode='pd', joints=['a'], kp=[10.0])
    source.on_joint_states(state(5.0, [0.5], [0.0], names=['a']))
    source.on_joint_states(state(5.1, [0.7], [0.0], names=['a']))
    assert source.sent == [[0.0], [pytest.approx(-2.0)]]


@pytest.mark.parametrize('parameters', [
    {'mode': 'pd', 'kp': [10.0]}, {'mode': 'constant', 'torque': [3.0]}])
def test_nothing_is_sent_until_all_that_are_to_hear_it_do(make_source, monkeypatch, parameters):
    source = make_source(joints=['a'], wait_for_subscribers=2, **parameters)
    count = [0]
    monkeypatch.setattr(source.publisher, 'get_subscription_count', lambda: count[0])

    def look(time):
        if source.values['mode'] == 'pd':
            source.on_joint_states(state(time, [time], [0.0], names=['a']))
        else:
            source.on_timer()

    for count[0] in (0, 1):
        look(1.0 + count[0])
    assert source.sent == []
    count[0] = 2
    look(3.0)
    # The reference begins where the joint is when the first command goes out.
    assert source.sent == [[0.0]] or source.sent == [[3.0]]
    # Once begun, it goes on whichever node leaves.
    count[0] = 0
    look(4.0)
    assert len(source.sent) == 2


def test_state_that_is_only_repeated_is_answered_once(make_source, monkeypatch):
    source = make_source(mode='pd', joints=['a'], kp=[10.0], target_position=[1.0])
    now = [100.0]
    monkeypatch.setattr(
        'closedloop_dynamics.ros.torque_source_node.time.monotonic', lambda: now[0])
    for now[0], time in ((100.0, 0.0), (100.1, 0.0), (100.2, 0.1), (100.3, 0.1), (101.3, 0.1)):
        source.on_joint_states(state(time, [0.5], [0.0], names=['a']))
    # Unless the answer seems to have been lost.
    assert len(source.sent) == 3


def test_answer_by_name_carries_the_stamp_of_the_state(make_source, monkeypatch):
    source = make_source(mode='pd', joints=['a'], kp=[10.0])
    source.on_joint_states(state(12.5, [0.5], [0.0], names=['a']))
    stamp = source.command.header.stamp
    assert (stamp.sec, stamp.nanosec) == (12, 500_000_000)


class Waiting(nullcontext):
    """A subscription's handle with messages that wait."""

    def take_message(self, kind, raw):
        return (self.enter_result.pop(0), {}) if self.enter_result else None


@pytest.mark.parametrize('message', [
    state(0.0, [1.0], [1.0], names=['b']),
    state(0.0, [1.0], [], names=['a']),
    state(0.0, [], [], names=['a']),
    state(0.0, [math.nan], [0.0], names=['a']),
    state(0.0, [1.0], [math.inf], names=['a']),
    JointState(),
])
def test_states_that_cannot_be_used_are_not_answered(make_source, monkeypatch, message):
    source = make_source(mode='pd', joints=['a'], kp=[10.0])
    source.on_joint_states(message)
    assert source.sent == []
    # Another one with its stamp is.
    source.on_joint_states(state(0.0, [0.7], [0.0], names=['a']))
    assert source.sent == [[0.0]]
    # Waiting in a queue they do not take the place of a state before them.
    waiting = [state(0.5, [0.6], [0.0], names=['a']), state(1.0, [0.8], [0.0], names=['a']),
               message]
    monkeypatch.setattr(source, 'states', SimpleNamespace(
        handle=Waiting(waiting[1:]), msg_type=JointState, raw=False))
    source.on_waiting_states(waiting[0])
    assert source.sent[1:] == [[pytest.approx(-1.0)]]


@pytest.mark.parametrize('parameters', [
    {'mode': 'pd', 'joints': ['theta_1'], 'ki': [50.0], 'move_amplitude': [0.3],
     'move_frequency': [1.0]},
    {'mode': 'computed_torque', 'scene': 'three_rrr', 'kd': [20.0], 'ki': [50.0],
     'circle_point': 'platform_center', 'circle_radius': 0.1, 'circle_frequency': 0.5}])
def test_lone_stamps_far_away_change_nothing(make_source, parameters):
    """Bit for bit: usable states whose stamps are of another time."""
    machine = Simulation.from_scene('three_rrr')
    alone, disturbed = (make_source(kp=[100.0], **parameters) for _ in range(2))
    position, names = machine.position, machine.joint_names

    def send(source, time):
        source.on_joint_states(state(time, position, 7 * [0.0], names))

    for k in range(40):
        send(alone, 100.0 + 0.01 * k)
        send(disturbed, 100.0 + 0.01 * k)
        for lone in (900.0, 1e-9, 99.9)[:k % 4]:
            send(disturbed, lone)
    assert disturbed.sent == alone.sent and disturbed.odd == 60
    # Two that go together are of another run: of a simulator that was reset, or stood still.
    for begin in 0.0, 500.0:
        again = make_source(kp=[100.0], **parameters)
        disturbed.sent.clear()
        send(disturbed, begin)
        assert not disturbed.sent
        for k in range(3):
            send(again, begin + 0.01 * k)
            send(disturbed, begin + 0.01 * k)
        assert disturbed.sent == again.sent


def test_state_that_closes_no_loops_changes_nothing(make_source):
    source = make_source(mode='computed_torque', scene='three_rrr', kp=[100.0], kd=[20.0])
    start = source.simulation
    names, rest = start.joint_names, start.velocity
    source.on_joint_states(state(1.0, start.position, rest, names))
    torque = source.sent[0]
    for time in 1.01, 9.0:
        assert not source.on_joint_states(state(time, start.position + 3.0, rest, names))
    source.on_joint_states(state(1.01, start.position, rest, names))
    assert source.sent == [torque, pytest.approx(torque, rel=1e-6)]


def test_computed_torque_drives_all_actuated_joints_of_its_scene(make_source):
    source = make_source(
        mode='computed_torque', scene='three_rrr', kp=[100.0], kd=[20.0])
    assert source.joints == ('theta_1', 'theta_6', 'theta_7')
    start = source.simulation
    source.on_joint_states(state(1.0, start.position, start.velocity, start.joint_names))
    # At rest where it is to stay: what holds the machine against gravity.
    held, _ = start.inverse_dynamics(start.position, [0.0] * 7, [0.0] * 7)
    assert source.sent[0] == pytest.approx(held.tolist(), rel=1e-6)


def test_state_that_knows_nothing_of_the_last_command_is_skipped(make_source):
    source = make_source(mode='pd', joints=['a'], kp=[10.0], target_position=[1.0])

    def answer(time, effort):
        message = state(time, [0.5, 0.0, 0.0], [0.0] * 3)
        message.effort = [effort, 0.0, 0.0]
        count = len(source.sent)
        source.on_joint_states(message)
        return source.sent[count:]

    assert answer(1.0, 0.0) == [[5.0]]
    # On its way; taken for lost; on its way again; in effect.
    assert [answer(1.0 + 0.1 * i, 0.0) for i in range(1, 5)] == [[], [], [[5.0]], []]
    assert answer(1.5, 5.0) == [[5.0]]
    # In lockstep nothing follows a state that is skipped, which comes again.
    assert [answer(1.6, 0.0) for _ in range(2)] == [[], [[5.0]]]


def test_torque_limit_is_that_of_the_actuator(make_source):
    source = make_source(mode='computed_torque', scene='carpet_scraper_dry', kp=[1e6])
    assert source.law.torque_limit.tolist() == [60.0]
    source = make_source(mode='computed_torque', scene='carpet_scraper_dry', kp=[1e6],
                         torque_limit=[7])
    assert source.law.torque_limit.tolist() == [7.0]


def test_gains_change_while_it_runs(make_source):
    source = make_source(mode='pd', joints=['a'], kp=[10.0], ki=[2.0], target_position=[1.0])
    source.on_joint_states(state(0.0, [0.5, 0.0, 0.0], [0.0] * 3))
    source.on_joint_states(state(1.0, [0.5, 0.0, 0.0], [0.0] * 3))
    # 10 * 0.5 and the integral of 0.5 over a second.
    assert source.sent[-1] == pytest.approx([5.0 + 1.0])
    results = source.set_parameters([
        Parameter('kp', value=[20]), Parameter('ki', value=[4.0]),
        Parameter('kp', value=[1.0, 2.0]), Parameter('kd', value=[-1.0]),
        Parameter('mode', value='sine'), Parameter('torque_limit', value=[10.5])])
    assert [result.successful for result in results] == [True, True, False, False, False, True]
    assert "'kp': expected 1 value" in results[2].reason
    # The torque of the integral goes on from 1 and grows with the new gain; the limit holds.
    source.on_joint_states(state(1.125, [0.5, 0.0, 0.0], [0.0] * 3))
    assert source.sent[-1] == pytest.approx([10.5])
    source.set_parameters([Parameter('torque_limit', value=[0.0])])
    source.on_joint_states(state(1.125 + 1e-9, [0.5, 0.0, 0.0], [0.0] * 3))
    assert source.sent[-1] == pytest.approx([10.0 + 1.0], abs=1e-6)


def test_constant_torque_changes_while_it_runs(make_source):
    source = make_source(joints=['a'], torque=[1.0])
    source.set_parameters([Parameter('torque', value=[2])])
    source.on_timer()
    assert source.sent == [[2.0]]
    result, = source.set_parameters([Parameter('torque', value=[math.inf])])
    assert not result.successful


def test_trajectory_from_a_topic_is_followed_from_the_next_state(make_source):
    source = make_source(mode='computed_torque', scene='three_rrr', kp=[100.0], kd=[20.0])
    machine = Simulation.from_scene('three_rrr')
    goal = machine.position[[0, 5, 6]] + [0.1, -0.1, 0.05]
    trajectory = JointTrajectory(
        joint_names=list(reversed(source.joints)),
        points=[JointTrajectoryPoint(positions=list(goal[::-1]),
                                     time_from_start=Duration(nanosec=500_000_000))])
    source.on_trajectory(trajectory)
    # One that is refused changes nothing.
    source.on_trajectory(JointTrajectory(joint_names=['theta_1'], points=trajectory.points))
    while machine.time < 0.8:
        source.on_joint_states(state(
            machine.time, machine.position, machine.velocity, machine.joint_names))
        machine.step(source.sent[-1], 0.01)
    assert machine.position[[0, 5, 6]] == pytest.approx(goal, abs=1e-3)
    assert machine.velocity[[0, 5, 6]] == pytest.approx([0.0] * 3, abs=2e-2)


@pytest.mark.parametrize('parameters, problem', [
    ({'mode': 'wild'},
     "'mode': expected one of constant, sine, pd, computed_torque, impedance, linear_regulator, "
     "predictive; got 'wild'"),
    ({'mode': 'pd'}, 'needs a gain'),
    ({'mode': 'computed_torque', 'kp': [1.0]}, "needs parameter 'scene'"),
    ({'mode': 'computed_torque', 'kp': [1.0], 'scene': 'nowhere'}, 'nowhere'),
    ({'mode': 'computed_torque', 'kp': [1.0], 'scene': 'four_bar', 'joints': ['a']}, 'leave'),
    ({'mode': 'computed_torque', 'kp': [1.0] * 2, 'scene': 'four_bar'}, "'kp': expected 1 value"),
    ({'torque': 5.0}, r'list of numbers \(write \[5.0\]'),
    ({'torque': ['a']}, 'list of numbers'),
    ({'torque': [math.nan]}, "'torque': expected finite"),
    ({'torque': [1.0, 2.0], 'joints': ['a', 'b', 'c']}, 'or 3 in the order a, b, c; got 2'),
    ({'mode': 'pd', 'kp': [-1.0]}, "'kp': expected no negative"),
    ({'mode': 'pd', 'kp': [1.0], 'target_position': [math.inf]}, 'no infinite numbers'),
    ({'mode': 'pd', 'kp': [1.0, 2.0], 'kd': [1.0, 2.0, 3.0]}, "'kp'"),
    ({'mode': 'sine', 'frequency': [-1.0]}, "'frequency': expected no negative"),
    ({'rate': 0.0}, 'rate out of range'),
])
def test_bad_parameters_are_named(make_source, parameters, problem):
    with pytest.raises(StartError, match=problem):
        make_source(**parameters)
