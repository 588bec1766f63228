# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Time of a simulator as a process of its own, over DDS."""

import math
from pathlib import Path
import signal

from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

SIMULATOR = 'closedloop_simulator'


def stamp(message):
    """Return the stamp of a message [ns]."""
    return Time.from_msg(message.header.stamp).nanoseconds


def children(process):
    """Return the numbers of the processes that a process has started."""
    number = process.popen.pid
    return Path(f'/proc/{number}/task/{number}/children').read_text().split()


@pytest.mark.parametrize('number', [
    pytest.param(signal.SIGTERM, marks=pytest.mark.slow), signal.SIGKILL])
def test_core_that_is_kept_awake_delays_nothing_and_nothing_stays_behind(
        processes, listener, number):
    simulator = processes.start(
        SIMULATOR, scene='four_bar', publish_rate='1000.0', keep_core_awake='true')
    simulator.wait_until_ready()
    states = listener.listen('joint_states', JointState)
    listener.wait(lambda: len(states) > 500, 'states')
    keeper, = children(simulator)
    assert listener.call(SetBool, f'{SIMULATOR}/pause', SetBool.Request(data=True)).success
    assert children(simulator) == []
    assert listener.call(SetBool, f'{SIMULATOR}/pause', SetBool.Request(data=False)).success
    keeper, = children(simulator)
    assert simulator.stop(number) == (0 if number == signal.SIGTERM else -signal.SIGKILL)
    listener.wait(lambda: not Path(f'/proc/{keeper}').exists(), 'end of the other process')


@pytest.mark.parametrize('waits', [
    {'mode': 'lockstep'}, pytest.param({'wait_for_command': 'true'}, marks=pytest.mark.slow)])
def test_controller_manager_that_waits_for_the_clock_gets_it(processes, listener, waits):
    """
    A loop like that of ros2_control_node.

    It waits for a clock above zero, then for a period; no command goes out before the hardware
    is active; then one a period, of nothing until a controller writes.
    """
    simulator = processes.start(SIMULATOR, scene='three_rrr', publish_clock='true', **waits)
    simulator.wait_until_ready()
    clocks, states = listener.listen('/clock', Clock), listener.listen('joint_states', JointState)
    commands = listener.publisher('joint_command', JointState)
    period, now = 10_000_000, 0
    for cycle in range(50):
        message = JointState(
            name=['theta_1', 'theta_6', 'theta_7'],
            effort=[math.nan] * 3 if cycle < 10 else [0.5, math.nan, math.nan])
        if cycle == 3:
            # Sent again where the simulator did not know this publisher yet.
            listener.send(commands, message, lambda: after(clocks, now, period), 'time')
        elif cycle > 3:
            commands.publish(message)
        now = listener.wait(lambda: after(clocks, now, period), 'time')
    listener.wait(lambda: list(states[-1].effort[:1]) == [0.5], 'the effort')
    assert simulator.stop() == 0
    assert ' 0 rejected' in simulator.output


def after(clocks, now, period):
    """Return the newest time of the clock if it is a period after ``now`` [ns], or None."""
    newest = Time.from_msg(clocks[-1].clock).nanoseconds if clocks else 0
    return newest if newest >= now + period else None


def run_in_lockstep(processes, listener, count, **parameters):
    """Drive a simulator in lockstep by a law of the state; return the bytes of all states."""
    simulator = processes.start(SIMULATOR, scene='three_rrr', mode='lockstep', **parameters)
    simulator.wait_until_ready()
    seen = {'states': [], 'forces': []}
    publisher = listener.publisher('torque_command', Float64MultiArray)
    # A command that is rejected advances nothing, but shows that commands are heard.
    listener.send(publisher, Float64MultiArray(),
                  lambda: 'torque_command rejected' in simulator.output, 'a rejection')

    def answer(message):
        if seen['states'] and stamp(message) == seen['states'][-1][0]:
            return
        numbers = np.concatenate([message.position, message.velocity, message.effort])
        seen['states'].append((stamp(message), numbers.tobytes()))
        torque = np.sin(5.0 * np.array(message.position)[[0, 5, 6]])
        publisher.publish(Float64MultiArray(data=torque.tolist()))

    subscriptions = [
        listener.node.create_subscription(JointState, 'joint_states', answer, 10),
        listener.node.create_subscription(
            WrenchStamped, 'constraint_forces/cut_1',
            lambda message: seen['forces'].append(message.wrench.force.x), 1000)]
    listener.wait(lambda: len(seen['states']) >= count, f'{count} states')
    assert simulator.stop() == 0
    for each in subscriptions:
        listener.node.destroy_subscription(each)
    listener.node.destroy_publisher(publisher)
    return seen['states'][:count]


def test_controller_in_lockstep_sees_the_same_run_every_time(processes, listener):
    first, second = (run_in_lockstep(processes, listener, 200) for _ in range(2))
    assert first == second
    assert [time for time, _ in first] == [10_000_000 * k for k in range(200)]
