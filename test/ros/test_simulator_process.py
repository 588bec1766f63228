# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the simulator as a process of its own, over DDS."""

import math
import signal
import time

from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger

SIMULATOR = 'closedloop_simulator'


def stamp(message):
    """Return the stamp of a message [s]."""
    return Time.from_msg(message.header.stamp).nanoseconds * 1e-9


def test_states_and_forces_come_at_the_rate_asked_for(processes, listener):
    # Stamped with simulated time, whatever else the machine does.
    simulator = processes.start(
        SIMULATOR, scene='three_rrr', publish_rate='50.0', publish_clock='true')
    states = listener.listen('joint_states', JointState)
    forces = [listener.listen(f'constraint_forces/cut_{i}', WrenchStamped) for i in (1, 2)]
    simulator.wait_until_ready()

    def both():
        stamps = {stamp(message) for message in states}
        return sum(stamp(message) in stamps for message in forces[0])

    listener.wait(lambda: min(map(len, [states, *forces])) > 100 and both() > 90,
                  '100 states with forces')
    assert states[0].name == [*(f'theta_{i}' for i in range(1, 8)), 'cut_1', 'cut_2']
    assert forces[0][0].header.frame_id == 'world'
    # On a busy machine a state may come early, after the steps there was time for, or not at all.
    periods = np.diff([stamp(message) for message in states]) * 50.0
    np.testing.assert_allclose(20.0 * periods, np.round(20.0 * periods), atol=1e-5)
    assert np.median(periods) == pytest.approx(1.0, abs=1e-6)
    # Falling under gravity, with no torque.
    assert not any(states[-1].effort)
    assert states[-1].position != states[0].position
    assert simulator.stop(signal.SIGTERM) == 0
    assert 'messages published' in simulator.output


def applied(states, efforts):
    """Return whether the last state applies the efforts, of the actuated joints in order."""
    return bool(states) and [e for e in states[-1].effort if e] == efforts


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


def test_simulators_side_by_side_have_their_names(processes, listener):
    first = processes.start(SIMULATOR, namespace='/left/arm', scene='three_rrr')
    second = processes.start(SIMULATOR, scene='four_bar', remap=[
        'joint_states:=robot/states', 'torque_command:=/drive', '__node:=other',
        'constraint_forces/cut_1:=pin'])
    left = listener.listen('/left/arm/joint_states', JointState)
    right = listener.listen('/robot/states', JointState)
    forces = listener.listen('/pin', WrenchStamped)
    first.wait_until_ready()
    second.wait_until_ready()
    publisher = listener.publisher('/drive', Float64MultiArray)
    listener.send(publisher, Float64MultiArray(data=[2.0]), lambda: applied(right, [2.0]),
                  'state with the torque')
    seen = len(left)
    listener.wait(lambda: len(left) > seen + 10 and forces, 'states of the other, and a force')
    assert len(left[0].name) == 9
    assert right[0].name == ['crank_joint', 'coupler_joint', 'rocker_joint', 'cut_1']
    assert not any(any(message.effort) for message in left)
    assert 'other' in listener.node.get_node_names()
    assert first.stop() == 0
    assert second.stop() == 0


@pytest.mark.parametrize('parameters, problem', [
    ({'publish_rate': '0.0'}, 'publish_rate'),
    pytest.param({'scene': 'no_such_scene'}, 'no_such_scene', marks=pytest.mark.slow),
    pytest.param({'real_time_factor': 'fast'}, 'real_time_factor', marks=pytest.mark.slow)])
def test_bad_parameter_is_one_line_and_an_exit_code(processes, parameters, problem):
    simulator = processes.start(SIMULATOR, **parameters)
    assert simulator.wait() == 2
    last = simulator.output.strip().splitlines()[-1]
    assert '[FATAL]' in last
    assert problem in last
    assert 'Traceback' not in simulator.output


def test_stray_argument_is_refused_with_the_right_way_to_say_it(processes):
    simulator = processes.start(SIMULATOR, arguments=['three_rrr'])
    assert simulator.wait() == 2
    assert "unexpected argument 'three_rrr'" in simulator.output
    assert '--ros-args -p NAME:=VALUE' in simulator.output


@pytest.mark.parametrize('executable, parameters', [
    (SIMULATOR, ('scene', 'marker_rate')), ('closedloop_torque_source', ('mode', 'kp')),
    ('closedloop_recorder', ('topics', 'max_size'))])
def test_help_lists_the_parameters(processes, executable, parameters):
    process = processes.start(executable, arguments=['--help'])
    assert process.wait() == 0
    for name in parameters:
        assert f'\n  {name}  (' in process.output
    assert process.output.startswith(f'usage: {executable} ')


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
