# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Simulator, torque source and those that drive them over DDS, all in this process."""

from functools import partial
import math
from test.ros.test_faults import applied, spin
import time
import warnings

from closedloop_dynamics.recording.message_numbers import stamp_of
from closedloop_dynamics.ros.recorder_node import RecorderNode
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.torque_source_node import TorqueSourceNode
from closedloop_dynamics.simulation.signals import SignalWatch
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


def test_states_and_forces_come_at_the_rate_asked_for(run, listener):
    # Stamped with simulated time, whatever else the machine does.
    run(SimulatorNode, scene='three_rrr', publish_rate=50.0, publish_clock=True)
    states = listener.listen('joint_states', JointState)
    forces = [listener.listen(f'constraint_forces/cut_{i}', WrenchStamped) for i in (1, 2)]

    def both():
        stamps = set(map(stamp_of, states))
        return sum(stamp_of(message) in stamps for message in forces[0])

    listener.wait(lambda: min(map(len, [states, *forces])) > 100 and both() > 90,
                  '100 states with forces')
    assert states[0].name == [*(f'theta_{i}' for i in range(1, 8)), 'cut_1', 'cut_2']
    assert forces[0][0].header.frame_id == 'world'
    # On a busy machine a state may come early, after the steps there was time for, or not at all.
    periods = np.diff(list(map(stamp_of, states))) * 50e-9
    np.testing.assert_allclose(20.0 * periods, np.round(20.0 * periods), atol=1e-5)
    assert np.median(periods) == pytest.approx(1.0, abs=1e-6)
    # Falling under gravity, with no torque.
    assert not any(states[-1].effort)
    assert states[-1].position != states[0].position


def test_simulators_side_by_side_have_their_names(run, listener):
    run(SimulatorNode, '/left/arm', scene='three_rrr')
    run(SimulatorNode, scene='four_bar', arguments=[
        '-r', 'joint_states:=robot/states', '-r', 'torque_command:=/drive', '-r', '__node:=other',
        '-r', 'constraint_forces/cut_1:=pin'])
    left = listener.listen('/left/arm/joint_states', JointState)
    right = listener.listen('/robot/states', JointState)
    forces = listener.listen('/pin', WrenchStamped)
    publisher = listener.publisher('/drive', Float64MultiArray)
    listener.send(publisher, Float64MultiArray(data=[2.0]), lambda: applied(right, [2.0]),
                  'state with the torque')
    seen = len(left)
    listener.wait(lambda: len(left) > seen + 10 and forces, 'states of the other, and a force')
    assert len(left[0].name) == 9
    assert right[0].name == ['crank_joint', 'coupler_joint', 'rocker_joint', 'cut_1']
    assert not any(any(message.effort) for message in left)
    assert 'other' in listener.node.get_node_names()


@pytest.fixture
def main(domain, monkeypatch, capfd):
    """Return a function that runs a program here; it returns the exit code, and what was said."""
    # Signals go on being those of the tests.
    monkeypatch.setattr(SignalWatch, 'ignore', lambda self: None)
    monkeypatch.setattr(warnings, 'showwarning', warnings.showwarning)

    def called(node_class, *arguments):
        code = node_class.main([node_class.NAME, *arguments])
        return code, ''.join(capfd.readouterr())

    return called


@pytest.mark.parametrize('arguments, problem', [
    (['-p', 'publish_rate:=0.0'], 'publish_rate'),
    (['-p', 'scene:=no_such_scene'], 'no_such_scene'),
    (['-p', 'real_time_factor:=fast'], 'real_time_factor')])
def test_bad_parameter_is_one_line_and_an_exit_code(main, arguments, problem):
    code, output = main(SimulatorNode, '--ros-args', *arguments)
    last = output.strip().splitlines()[-1]
    assert code == 2 and '[FATAL]' in last and problem in last
    assert 'Traceback' not in output


def test_stray_argument_is_refused_with_the_right_way_to_say_it(main):
    code, output = main(SimulatorNode, 'three_rrr')
    assert code == 2 and "unexpected argument 'three_rrr'" in output
    assert '--ros-args -p NAME:=VALUE' in output


@pytest.mark.parametrize('node_class, parameters', [
    (SimulatorNode, ('scene', 'marker_rate')), (TorqueSourceNode, ('mode', 'kp')),
    (RecorderNode, ('topics', 'max_size'))])
def test_help_lists_the_parameters(main, node_class, parameters):
    code, output = main(node_class, '--help')
    assert code == 0 and output.startswith(f'usage: {node_class.NAME} ')
    for name in parameters:
        assert f'\n  {name}  (' in output


@pytest.mark.parametrize('waits', [{'mode': 'lockstep'}, {'wait_for_command': True}])
def test_controller_manager_that_waits_for_the_clock_gets_it(run, listener, waits):
    """
    A loop like that of ros2_control_node.

    It waits for a clock above zero, then for a period; no command goes out before the hardware
    is active; then one a period, of nothing until a controller writes.
    """
    counts = run(SimulatorNode, scene='three_rrr', publish_clock=True, **waits).command.counts
    clocks, states = listener.listen('/clock', Clock), listener.listen('joint_states', JointState)
    commands = listener.publisher('joint_command', JointState)
    period, now = 10_000_000, 0

    def later():
        """Return the newest time of the clock if a period has passed [ns], or None."""
        newest = clocks[-1].clock.sec * 10 ** 9 + clocks[-1].clock.nanosec
        return newest if newest >= now + period else None

    for cycle in range(50):
        message = JointState(
            name=['theta_1', 'theta_6', 'theta_7'],
            effort=[math.nan] * 3 if cycle < 10 else [0.5, math.nan, math.nan])
        if cycle == 3:
            # Sent again where the simulator did not know this publisher yet.
            listener.send(commands, message, later, 'time')
        elif cycle > 3:
            commands.publish(message)
        now = listener.wait(later, 'time')
    listener.wait(lambda: list(states[-1].effort[:1]) == [0.5], 'the effort')
    assert counts['rejected'] == 0


def test_controller_in_lockstep_sees_the_same_run_every_time(run, listener):
    """Two simulators under a law of the state, bit for bit."""
    runs = {name: {} for name in ('/first', '/second')}

    def answer(publisher, seen, message):
        numbers = np.concatenate([message.position, message.velocity, message.effort])
        if stamp_of(message) not in seen:
            seen[stamp_of(message)] = numbers.tobytes()
            torque = np.sin(5.0 * np.array(message.position)[[0, 5, 6]])
            publisher.publish(Float64MultiArray(data=torque.tolist()))

    for name, seen in runs.items():
        run(SimulatorNode, name, scene='three_rrr', mode='lockstep')
        publisher = listener.publisher(f'{name}/torque_command', Float64MultiArray)
        listener.node.create_subscription(
            JointState, f'{name}/joint_states', partial(answer, publisher, seen), 10)
    listener.wait(lambda: all(len(seen) >= 200 for seen in runs.values()), '200 states')
    first, second = (list(seen.items())[:200] for seen in runs.values())
    assert first == second
    assert [stamp for stamp, _ in first] == [10_000_000 * k for k in range(200)]


def test_source_finds_the_joints_of_the_simulator_in_its_namespace(run, listener):
    source = run(TorqueSourceNode, '/cell', torque=[1.0, 2.0, 3.0])
    # It asks for the joints before there is anyone to answer.
    spin(listener, 1.0)
    assert source.joints == ()
    counts = run(SimulatorNode, '/cell', scene='three_rrr').command.counts
    states = listener.listen('/cell/joint_states', JointState)
    # Behind the joints of the tree are the cut ones.
    listener.wait(lambda: states[-1].effort.tolist() == [
        1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 3.0, 0.0, 0.0], 'state with the torque')
    assert source.joints == ('theta_1', 'theta_6', 'theta_7') and counts['rejected'] == 0


def test_parameters_that_do_not_fit_the_simulator_end_the_source(run, listener, capfd):
    run(SimulatorNode, scene='three_rrr')
    source = run(TorqueSourceNode, torque=[1.0, 2.0])
    listener.wait(lambda: source.exit_code is not None, 'end')
    assert source.exit_code == 2
    assert "'torque': expected 1 value, or 3" in capfd.readouterr().err


def test_commands_come_without_a_simulator_and_no_faster_than_asked_for(run, listener):
    commands, begin = listener.listen('joint_command', JointState), time.monotonic()
    run(TorqueSourceNode, joints=['a'], mode='sine', rate=100.0)
    listener.wait(lambda: len(commands) >= 200, '200 commands')
    # A busy machine makes them fewer, none makes them more.
    assert len(commands) <= 100.0 * (time.monotonic() - begin)
    assert commands[0].name == ['a']
