# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the torque source and the simulator as processes that know each other by topics."""

import signal
import time

from closedloop_dynamics.recording.message_numbers import stamp_of
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

SIMULATOR = 'closedloop_simulator'
SOURCE = 'closedloop_torque_source'
# A hundred states in a simulated second, within four of the clock: what a busy machine delays is
# a small part of a period then, as it is on a calm one without that.
SLOWLY = {'publish_clock': 'true', 'real_time_factor': '0.25', 'publish_rate': '25.0'}


def test_source_finds_the_joints_of_the_simulator_in_its_namespace(processes, listener):
    source = processes.start(SOURCE, namespace='/cell', torque='[1.0, 2.0, 3.0]')
    source.wait_for('waiting for node')
    simulator = processes.start(SIMULATOR, namespace='/cell', scene='three_rrr')
    states = listener.listen('/cell/joint_states', JointState)
    source.wait_for('driving theta_1, theta_6, theta_7')
    listener.wait(lambda: states and states[-1].effort[0] == 1.0, 'state with the torque')
    # Behind the joints of the tree are the cut ones.
    assert states[-1].effort.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 3.0, 0.0, 0.0]
    assert simulator.stop() == 0
    assert source.stop() == 0
    assert '0 rejected' in simulator.output


def test_parameters_that_do_not_fit_the_simulator_end_the_source(processes):
    processes.start(SIMULATOR, scene='three_rrr')
    source = processes.start(SOURCE, torque='[1.0, 2.0]')
    assert source.wait() == 2
    assert "'torque': expected 1 value, or 3" in source.output
    assert 'Traceback' not in source.output


def test_commands_come_without_a_simulator_and_no_faster_than_asked_for(processes, listener):
    commands, begin = listener.listen('joint_command', JointState), time.monotonic()
    source = processes.start(SOURCE, joints='[a]', mode='sine', rate='100.0')
    listener.wait(lambda: len(commands) >= 200, '200 commands')
    # A busy machine makes them fewer, none makes them more.
    assert len(commands) <= 100.0 * (time.monotonic() - begin)
    assert commands[0].name == ['a']
    assert source.stop() == 0


def drive(processes, listener, simulated, duration, time=None, **parameters):
    """
    Return the states of a scene under a torque source, after both have stopped.

    ``time`` are parameters of the simulator.
    """
    states = listener.listen('joint_states', JointState)
    commands = listener.listen('torque_command', Float64MultiArray)
    simulator = processes.start(SIMULATOR, scene=simulated, wait_for_command='true',
                                **(time or {}))
    simulator.wait_until_ready()
    source = processes.start(SOURCE, **parameters).wait_until_ready()
    listener.wait(lambda: commands, 'a command')
    start = len(states)
    listener.wait(lambda: len(states) > start + 100 * duration, f'states of {duration} s')
    assert source.stop() == 0
    assert simulator.stop() == 0
    assert '0 rejected' in simulator.output
    return (np.array([message.position for message in states[start:]]),
            np.array([message.velocity for message in states[start:]]))


@pytest.mark.slow
def test_crank_of_the_scraper_holds_45_rpm(processes, listener):
    _, velocity = drive(
        processes, listener, 'carpet_scraper', 8, time=SLOWLY, mode='computed_torque',
        kp='[100.0]', kd='[20.0]', scene='carpet_scraper', target_velocity='[4.7124]')
    # A hundred states a second: the last five seconds.
    crank = velocity[-500:, 0]
    assert crank.mean() == pytest.approx(4.7124, rel=0.01)
    # A state that was late by a period may cost a little.
    assert np.percentile(np.abs(crank - 4.7124), 95) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize('move', [0.0, 0.15])
def test_platform_of_the_3_rrr_is_held_and_moved_under_gravity(processes, listener, move):
    position, _ = drive(
        processes, listener, 'three_rrr', 8, time=SLOWLY, mode='pd', kp='[600.0]', kd='[50.0]',
        ki='[1000.0]', move_amplitude=f'[{move}]', move_phase='[0.0, 2.0944, 4.1888]')
    base = position[-400:][:, [0, 5, 6]]
    assert np.ptp(base, axis=0) == pytest.approx([2 * move] * 3, abs=0.02)
    middle = (base.max(axis=0) + base.min(axis=0)) / 2
    offset = -move * np.sin([0.0, 2.0944, 4.1888])
    assert middle == pytest.approx(np.array([1.0467, 4.1883, 5.7637]) + offset, abs=0.02)


def test_in_lockstep_another_source_goes_on_where_one_was_killed(processes, listener):
    """A state that was sent to it has no answer, and is published again."""
    simulator = processes.start(SIMULATOR, scene='three_rrr', mode='lockstep').wait_until_ready()
    settings = {'mode': 'pd', 'kp': '[100.0]', 'kd': '[10.0]'}
    states = listener.listen('joint_states', JointState)
    source = processes.start(SOURCE, **settings)
    listener.wait(lambda: len(states) > 50, 'motion')
    source.stop(signal.SIGKILL)
    simulator.wait_for('published again')
    count = len(states)
    another = processes.start(SOURCE, **settings)
    listener.wait(lambda: stamp_of(states[-1]) > stamp_of(states[count - 1]) + 10 ** 9, 'motion')
    assert another.stop() == simulator.stop() == 0
    assert 'states published again' in simulator.last_words()
