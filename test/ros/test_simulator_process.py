# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Simulator and torque source as processes of their own: traffic, signals, and being killed."""

import math
from pathlib import Path
import signal
import time

from closedloop_dynamics.recording.message_numbers import stamp_of
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from .test_faults import applied

SIMULATOR, SOURCE = 'closedloop_simulator', 'closedloop_torque_source'


def stamp(message):
    """Return the stamp of a message [s]."""
    return 1e-9 * stamp_of(message)


def ends_well(process, number=signal.SIGINT):
    """Check that a signal ends a process with exit code 0 and without a traceback."""
    assert process.stop(number) == 0, process.output
    assert 'Traceback' not in process.output


def test_others_command_and_change_it(processes, listener):
    simulator = processes.start(
        SIMULATOR, scene='three_rrr',
        **{'effects.gravity.enabled': False}).wait_until_ready()
    states = listener.listen('joint_states', JointState)
    torques = listener.publisher('torque_command', Float64MultiArray)
    joints = listener.publisher('joint_command', JointState)
    listener.wait(lambda: len(states) > 5, 'states')
    assert states[-1].position == states[0].position
    mover = listener.publisher(f'{SIMULATOR}/set_state', JointState)
    listener.send(
        mover, JointState(name=['theta_1', 'theta_6', 'theta_7'], position=[1.1, 4.1, 5.8]),
        lambda: states[-1].position[0] == 1.1, 'the state that was set')
    mover.publish(JointState(name=['theta_1'], position=[1.2]))
    simulator.wait_for('set_state refused: Holding theta_1 is not a complete choice')
    listener.send(
        torques, Float64MultiArray(data=[1.0, 2.0, 3.0]), lambda: applied(states, [1.0, 2.0, 3.0]),
        'state with these efforts')
    listener.send(
        joints, JointState(name=['theta_7'], effort=[3.5]),
        lambda: applied(states, [1.0, 2.0, 3.5]), 'state with the effort of one joint')
    bad = [(torques, Float64MultiArray(data=[9.0, math.nan, 9.0])),
           (torques, Float64MultiArray(data=[1e300, 0.0, 0.0])),
           (joints, JointState(name=['theta_2'], effort=[9.0]))]
    for publisher, message in bad:
        publisher.publish(message)
    joints.publish(JointState(name=['theta_7'], effort=[4.0]))
    listener.wait(lambda: applied(states, [1.0, 2.0, 4.0]), 'state with the last effort')
    torques.publish(Float64MultiArray(data=[0.0, 0.0, 0.0]))
    listener.wait(lambda: applied(states, []), 'state without torques')
    values = listener.call(
        GetParameters, f'{SIMULATOR}/get_parameters',
        GetParameters.Request(names=['actuated_joints', 'publish_rate'])).values
    assert values[0].string_array_value == ['theta_1', 'theta_6', 'theta_7']
    assert values[1].double_value == 100.0
    results = listener.call(
        SetParameters, f'{SIMULATOR}/set_parameters', SetParameters.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in (
                ('publish_rate', 20.0), ('scene', 'four_bar'), ('effects.gravity.enabled', True),
                ('effects.wind.enabled', True))])).results
    assert [result.successful for result in results] == [True, False, True, False]
    count = len(states)
    listener.wait(lambda: len(states) > count + 12, 'states at the new rate')
    assert (stamp(states[-1]) - stamp(states[count + 2])) / (len(states) - count - 3) > 0.04
    assert not any(9.0 in message.effort or 1e300 in message.effort for message in states)
    assert listener.call(SetBool, f'{SIMULATOR}/pause', SetBool.Request(data=True)).success
    assert listener.call(Trigger, f'{SIMULATOR}/step', Trigger.Request()).success
    assert simulator.stop() == 0
    # What the method cost is reported at the end, too.
    assert '% of real time (auto, projection' in simulator.output
    assert 'command rejected: ' in simulator.output
    # The first ones may have been heard twice.
    assert f' accepted, {len(bad)} rejected' in simulator.output
    assert 'Traceback' not in simulator.output


def test_simulator_is_killed_and_started_again_under_traffic(processes, listener):
    states = listener.listen('joint_states', JointState)
    source = processes.start('closedloop_torque_source', torque='[1.0, 2.0, 3.0]')
    for _ in range(2):
        simulator = processes.start(SIMULATOR, scene='three_rrr').wait_until_ready()
        states.clear()
        listener.wait(lambda: applied(states, [1.0, 2.0, 3.0]), 'state with the torques')
        simulator.stop(signal.SIGKILL)
    assert source.popen.poll() is None
    ends_well(source)


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
    another = processes.start(SOURCE, **settings).wait_until_ready()
    listener.wait(lambda: stamp_of(states[-1]) > stamp_of(states[count - 1]) + 10 ** 9, 'motion')
    assert another.stop() == simulator.stop() == 0
    assert 'states published again' in simulator.last_words()


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


@pytest.mark.parametrize('pause', [
    0.005, *(pytest.param(pause, marks=pytest.mark.slow) for pause in (0.0, 0.1))])
def test_more_signals_change_nothing(processes, pause):
    simulator = processes.start(SIMULATOR, scene='four_bar').wait_until_ready()
    for number in (signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGINT):
        if simulator.popen.poll() is None:
            simulator.send(number)
        time.sleep(pause)
    assert simulator.wait() == 0
    assert 'Traceback' not in simulator.output


def test_signal_while_starting_ends_the_process_at_once(processes):
    simulator = processes.start(SIMULATOR, scene='three_rrr').wait_for('loading scene')
    assert simulator.stop() == 0
    assert 'Traceback' not in simulator.output


@pytest.mark.slow
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_while_code_is_generated_ends_the_process(processes, number, tmp_path):
    for trial, delay in enumerate((0.0, 0.2, 0.5, 1.0)):
        processes.environment['CLOSEDLOOP_CACHE_DIR'] = str(tmp_path / f'cold_{trial}')
        simulator = processes.start(SIMULATOR, scene='three_rrr').wait_for('loading scene')
        time.sleep(delay)
        ends_well(simulator, number)


@pytest.mark.parametrize('number', [
    signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_services_answer_and_signals_are_heard_while_a_step_takes_long(
        processes, listener, number):
    # A thousand steps at once, of a crank that reaches 1e5 rad/s: tens of seconds.
    simulator = processes.start(
        SIMULATOR, scene='four_bar', mode='lockstep', publish_rate='1.0').wait_until_ready()
    findings = listener.listen('/diagnostics', DiagnosticArray)
    publisher = listener.publisher('torque_command', Float64MultiArray)
    listener.send(publisher, Float64MultiArray(data=[2e4]),
                  lambda: 'busy: a step at t = 0 s' in simulator.output, 'a long step')
    for name in ('pause', 'step', 'reset'):
        kind = SetBool if name == 'pause' else Trigger
        answer = listener.call(kind, f'{SIMULATOR}/{name}', kind.Request())
        assert not answer.success and answer.message.startswith('busy: ')
    result, = listener.call(
        SetParameters, f'{SIMULATOR}/set_parameters', SetParameters.Request(parameters=[
            Parameter('step_count', value=5).to_parameter_msg()])).results
    assert not result.successful and result.reason.startswith('busy: ')
    assert listener.call(GetParameters, f'{SIMULATOR}/get_parameters', GetParameters.Request(
        names=['step_count'])).values[0].integer_value == 1
    listener.wait(lambda: any(
        status.message.startswith('busy: ') and status.level == DiagnosticStatus.WARN
        for message in findings for status in message.status), 'a finding')
    ends_well(simulator, number)
    assert 'stopped in the midst of a step' in simulator.output
