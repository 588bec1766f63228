# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Faults around a simulator: rogue publishers, floods, nodes that go, clocks that jump."""

import math
import time

from closedloop_dynamics.ros.simulator_node import SimulatorNode
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
import pytest
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

SIMULATOR = 'closedloop_simulator'
# Place of the running number of the state in an entry of replay_log.
INDEX = 2


def applied(states, efforts):
    """Return whether the last state applies the efforts, of the actuated joints in order."""
    return bool(states) and [effort for effort in states[-1].effort if effort] == efforts


def spin(listener, duration):
    """Take in messages for a while."""
    end = time.monotonic() + duration
    listener.wait(lambda: time.monotonic() > end, 'end of time')


def test_flood_of_commands_delays_nothing_and_the_last_one_counts(run, listener):
    """More commands at once than may wait: each is taken, or counted as lost."""
    counts = run(SimulatorNode, scene='three_rrr').command.counts
    states = listener.listen('joint_states', JointState)
    publisher = listener.publisher('torque_command', Float64MultiArray)
    tried = 0
    # The node may discover the publisher after its first command, and restarts its counts then.
    for first in 3.0, 4.0:
        tried += listener.send(
            publisher, Float64MultiArray(data=[first, 2.0, 1.0]),
            lambda: applied(states, [first, 2.0, 1.0]), 'state with the first command')
    for _ in range(5000):
        publisher.publish(Float64MultiArray(data=[1.0, 1.0, 1.0]))
    # Commands are best effort: behind a flood a single one may be lost.
    last = listener.send(
        publisher, Float64MultiArray(data=[1.0, 2.0, 3.0]),
        lambda: applied(states, [1.0, 2.0, 3.0]), 'state with the last command')
    assert counts['rejected'] == 0 and counts['accepted'] > 10
    assert 5003 <= counts['accepted'] + counts['lost'] <= 5000 + tried + last


def test_rogue_publishers_change_nothing(run, listener, domain):
    counts = run(SimulatorNode, scene='three_rrr').command.counts
    states = listener.listen('joint_states', JointState)
    publisher = listener.publisher('torque_command', Float64MultiArray)
    listener.send(publisher, Float64MultiArray(data=[1.0, 2.0, 3.0]),
                  lambda: applied(states, [1.0, 2.0, 3.0]), 'state with the command')
    # Another type, on both topics, by a participant of its own: one cannot have two types on one.
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    rogue = rclpy.create_node('rogue', context=context)
    rogues = [rogue.create_publisher(String, 'torque_command', 10),
              rogue.create_publisher(String, 'joint_command', 10)]
    for _ in range(20):
        for each in rogues:
            each.publish(String(data='9.0 9.0 9.0'))
        spin(listener, 0.02)
    rogue.destroy_node()
    rclpy.try_shutdown(context=context)
    for data in ([9.0] * 1000, [math.nan] * 3, [math.inf, 0.0, 0.0], []):
        publisher.publish(Float64MultiArray(data=data))
    publisher.publish(Float64MultiArray(data=[4.0, 5.0, 6.0]))
    listener.wait(lambda: applied(states, [4.0, 5.0, 6.0]), 'state with the next command')
    assert not any(9.0 in message.effort for message in states)
    assert counts['rejected'] == 4


def findings(messages, part):
    """Return the texts of warnings of a part."""
    return [status.message for message in messages for status in message.status
            if status.name.endswith(f': {part}') and status.level == DiagnosticStatus.WARN]


def test_two_sources_of_commands_are_reported(run, listener, context):
    run(SimulatorNode, scene='three_rrr')
    sources = [rclpy.create_node(name, context=context) for name in ('one', 'two')]
    for source in sources:
        source.create_publisher(Float64MultiArray, 'torque_command', 10)
    messages = listener.listen('/diagnostics', DiagnosticArray)
    listener.wait(lambda: any('2 sources of commands (/one, /two)' in text
                              for text in findings(messages, 'commands')), 'finding')
    for source in sources:
        source.destroy_node()


def test_namesakes_and_a_clock_that_is_missing_are_reported(run, listener, capfd):
    for _ in range(2):
        run(SimulatorNode, '/left', scene='four_bar')
    run(SimulatorNode, scene='four_bar', use_sim_time=True)
    output = []

    def said(text, times):
        output.append(capfd.readouterr().err)
        return ''.join(output).count(text) >= times

    listener.wait(lambda: said('2 nodes are called /left/closedloop_simulator', 2), 'namesakes')
    listener.wait(lambda: said('use_sim_time is true, and nobody publishes /clock', 1), 'warning')
    spin(listener, 1.5)
    assert not said('nobody publishes /clock', 2) and not said('are called', 3)


def test_clock_that_jumps_and_stops_does_not_disturb_the_simulation(run, listener):
    clock = listener.node.create_publisher(Clock, '/clock', 10)
    run(SimulatorNode, scene='four_bar', use_sim_time=True)
    states = listener.listen('joint_states', JointState)
    # Forwards, backwards, and then it stands still.
    for seconds in (1000.0, 5000.0, 10.0):
        message = Clock()
        message.clock = Time(nanoseconds=round(seconds * 1e9)).to_msg()

        def follows():
            clock.publish(message)
            return states and states[-1].header.stamp == message.clock

        listener.wait(follows, f'state stamped {seconds}')
    seen = len(states)
    # The machine moves on whatever the clock says.
    listener.wait(lambda: len({tuple(message.position) for message in states[seen:]}) > 25,
                  'motion')


def test_flood_of_parameters_is_answered(run, listener):
    node = run(SimulatorNode, scene='four_bar')
    states = listener.listen('joint_states', JointState)
    # All at once: there is room for the answers to all, on both sides.
    answers = listener.call_all(SetParameters, f'{SIMULATOR}/set_parameters', [
        SetParameters.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in (
                ('publish_rate', 50.0 + k % 100), ('real_time_factor', -1.0),
                ('command_timeout', 0.01 * k), ('no_such', 1.0), ('', 1.0), ('step_count', k))])
        for k in range(300)])
    results = [[result.successful for result in answer.results] for answer in answers]
    assert results == [[True, False, True, False, False, k > 0] for k in range(300)]
    assert (node.values['publish_rate'], node.values['step_count']) == (149.0, 299)
    seen = len(states)
    listener.wait(lambda: len(states) > seen + 20, 'states')


@pytest.mark.parametrize('name, kind, request_', [
    ('pause', SetBool, SetBool.Request(data=True)), ('step', Trigger, Trigger.Request()),
    ('reset', Trigger, Trigger.Request())])
def test_flood_of_calls_is_answered(run, listener, name, kind, request_):
    run(SimulatorNode, scene='four_bar').pause(name == 'step')
    answers = listener.call_all(kind, f'{SIMULATOR}/{name}', [request_] * 300)
    assert all(answer.success for answer in answers)


def test_subscribers_that_come_and_go_cost_the_others_nothing(run, listener):
    run(SimulatorNode, scene='four_bar', publish_rate=200.0)
    entries = listener.listen('replay_log', Float64MultiArray)
    listener.wait(lambda: entries, 'an entry')
    for k in range(30):
        subscriptions = [
            listener.node.create_subscription(kind, topic, lambda message: None, QoSProfile(
                depth=1 + k % 3, reliability=reliability))
            for kind, topic in ((JointState, 'joint_states'),
                                (WrenchStamped, 'constraint_forces/cut_1'))
            for reliability in (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT)]
        spin(listener, 0.03)
        for subscription in subscriptions:
            listener.node.destroy_subscription(subscription)
    listener.wait(lambda: len(entries) > 100, 'a hundred entries')
    indices = [entry.data[INDEX] for entry in entries]
    assert indices == list(range(int(indices[0]), int(indices[0]) + len(indices)))
