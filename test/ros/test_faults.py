# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Faults around a simulator, with real processes: rogue publishers, floods, deaths, jumps."""

import math
import signal
from test.ros.soak import memory
import time

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
import pytest
from rcl_interfaces.srv import GetParameters
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import String
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger

SIMULATOR = 'closedloop_simulator'
# Place of the running number of the state in an entry of replay_log.
INDEX = 2


def ends_well(process, number=signal.SIGINT):
    """Check that a signal ends a process with exit code 0 and without a traceback."""
    assert process.stop(number) == 0, process.output
    assert 'Traceback' not in process.output


def applied(states, efforts):
    """Return whether the last state applies the efforts, of the actuated joints in order."""
    return bool(states) and [effort for effort in states[-1].effort if effort] == efforts


def spin(listener, duration):
    """Take in messages for a while."""
    end = time.monotonic() + duration
    listener.wait(lambda: time.monotonic() > end, 'end of time')


def test_flood_of_commands_delays_nothing_and_the_last_one_counts(processes, listener):
    simulator = processes.start(SIMULATOR, scene='three_rrr').wait_until_ready()
    states = listener.listen('joint_states', JointState)
    publisher = listener.publisher('torque_command', Float64MultiArray)
    message = Float64MultiArray(data=[1.0, 1.0, 1.0])
    listener.wait(lambda: len(states) > 10, 'states')
    tried = listener.send(
        publisher, Float64MultiArray(data=[3.0, 2.0, 1.0]),
        lambda: applied(states, [3.0, 2.0, 1.0]), 'state with the first command')
    before, sent = memory(simulator), 0
    begin = time.monotonic()
    while time.monotonic() - begin < 2.0:
        # Ten thousand a second, if this machine can.
        while sent < 10000 * (time.monotonic() - begin):
            publisher.publish(message)
            sent += 1
        time.sleep(0.001)
    # Commands are best effort: behind a flood a single one may be lost.
    last = listener.send(
        publisher, Float64MultiArray(data=[1.0, 2.0, 3.0]),
        lambda: applied(states, [1.0, 2.0, 3.0]), 'state with the last command')
    assert memory(simulator) - before < 30e6
    assert '0 rejected' in last_words(simulator)
    accepted = int(last_words(simulator).split('commands: ')[1].split()[0])
    # Each was taken or counted as lost; the first ones may have come too early.
    lost = int(last_words(simulator).split(' lost')[0].split()[-1])
    assert sent + 2 <= accepted + lost <= sent + tried + last and accepted > 10


def last_words(simulator):
    """End a simulator well, and return what it said last."""
    if simulator.popen.poll() is None:
        ends_well(simulator)
    return simulator.output.splitlines()[-1]


@pytest.fixture
def rogue(domain):
    """Return a node of a participant of its own: one cannot have two types on a topic."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node('rogue', context=context)
    yield node
    node.destroy_node()
    rclpy.try_shutdown(context=context)


@pytest.mark.slow
def test_rogue_publishers_change_nothing(processes, listener, rogue):
    simulator = processes.start(SIMULATOR, scene='three_rrr').wait_until_ready()
    states = listener.listen('joint_states', JointState)
    publisher = listener.publisher('torque_command', Float64MultiArray)
    listener.send(publisher, Float64MultiArray(data=[1.0, 2.0, 3.0]),
                  lambda: applied(states, [1.0, 2.0, 3.0]), 'state with the command')
    # Another type, on both topics.
    rogues = [rogue.create_publisher(String, 'torque_command', 10),
              rogue.create_publisher(String, 'joint_command', 10)]
    for _ in range(20):
        for each in rogues:
            each.publish(String(data='9.0 9.0 9.0'))
        spin(listener, 0.02)
    for data in ([9.0] * 1000, [math.nan] * 3, [math.inf, 0.0, 0.0], []):
        publisher.publish(Float64MultiArray(data=data))
    simulator.wait_for('torque_command rejected: expected 3 values')
    publisher.publish(Float64MultiArray(data=[4.0, 5.0, 6.0]))
    listener.wait(lambda: applied(states, [4.0, 5.0, 6.0]), 'state with the next command')
    assert not any(9.0 in message.effort for message in states)
    # The first one may have been heard twice.
    assert ' accepted, 4 rejected' in last_words(simulator)


def test_two_sources_of_commands_are_reported(processes, listener, context):
    simulator = processes.start(SIMULATOR, scene='three_rrr').wait_until_ready()
    sources = [rclpy.create_node(name, context=context) for name in ('one', 'two')]
    for source in sources:
        source.create_publisher(Float64MultiArray, 'torque_command', 10)
    simulator.wait_for('2 sources of commands (/one, /two)')
    findings = listener.listen('/diagnostics', DiagnosticArray)

    def reported():
        return any(status.name.endswith(': commands') and status.level == DiagnosticStatus.WARN
                   and '2 sources' in status.message
                   for message in findings for status in message.status)

    listener.wait(reported, 'diagnosis of two sources')
    for source in sources:
        source.destroy_node()
    ends_well(simulator)


def test_namesakes_and_a_clock_that_is_missing_are_reported(processes):
    simulators = [processes.start(SIMULATOR, namespace='/left', scene='four_bar')
                  for _ in range(2)]
    late = processes.start(SIMULATOR, scene='four_bar', use_sim_time='true')
    for simulator in simulators:
        simulator.wait_for('2 nodes are called /left/closedloop_simulator')
    for simulator in simulators:
        ends_well(simulator)
    late.wait_for('use_sim_time is true, and nobody publishes /clock')
    ends_well(late)
    assert late.output.count('nobody publishes /clock') == 1
    assert 'are called' not in late.output


def test_simulator_is_killed_and_started_again_under_traffic(processes, listener):
    states = listener.listen('joint_states', JointState)
    source = processes.start('closedloop_torque_source', torque='[1.0, 2.0, 3.0]')
    for _ in range(2):
        simulator = processes.start(SIMULATOR, scene='three_rrr').wait_until_ready()
        states.clear()
        listener.wait(lambda: applied(states, [1.0, 2.0, 3.0]), 'state with the torques')
        simulator.send(signal.SIGKILL)
        simulator.wait()
    assert source.popen.poll() is None
    ends_well(source)


@pytest.mark.slow
def test_clock_that_jumps_and_stops_does_not_disturb_the_simulation(processes, listener):
    clock = listener.node.create_publisher(Clock, '/clock', 10)
    simulator = processes.start(SIMULATOR, scene='four_bar', use_sim_time='true')
    simulator.wait_until_ready()
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
    ends_well(simulator)


@pytest.mark.slow
def test_flood_of_parameters_is_answered(processes, listener):
    simulator = processes.start(SIMULATOR, scene='four_bar').wait_until_ready()
    states = listener.listen('joint_states', JointState)
    before = memory(simulator)
    # All at once: there is room for the answers to all, on both sides.
    answers = listener.call_all(SetParameters, f'{SIMULATOR}/set_parameters', [
        SetParameters.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in (
                ('publish_rate', 50.0 + k % 100), ('real_time_factor', -1.0),
                ('command_timeout', 0.01 * k), ('no_such', 1.0), ('', 1.0), ('step_count', k))])
        for k in range(300)])
    results = [[result.successful for result in answer.results] for answer in answers]
    assert results == [[True, False, True, False, False, k > 0] for k in range(300)]
    assert memory(simulator) - before < 30e6
    values = listener.call(GetParameters, f'{SIMULATOR}/get_parameters',
                           GetParameters.Request(names=['publish_rate', 'step_count'])).values
    assert (values[0].double_value, values[1].integer_value) == (149.0, 299)
    seen = len(states)
    listener.wait(lambda: len(states) > seen + 20, 'states')
    ends_well(simulator)


@pytest.mark.parametrize('name, request_', [
    pytest.param('pause', SetBool.Request(data=True), marks=pytest.mark.slow),
    pytest.param('step', Trigger.Request(), marks=pytest.mark.slow),
    ('reset', Trigger.Request())])
def test_flood_of_calls_is_answered(processes, listener, name, request_):
    simulator = processes.start(SIMULATOR, scene='four_bar').wait_until_ready()
    if name == 'step':
        listener.call(SetBool, f'{SIMULATOR}/pause', SetBool.Request(data=True))
    kind = SetBool if name == 'pause' else Trigger
    answers = listener.call_all(kind, f'{SIMULATOR}/{name}', [request_] * 300)
    assert all(answer.success for answer in answers)
    ends_well(simulator)


@pytest.mark.slow
def test_subscribers_that_come_and_go_cost_the_others_nothing(processes, listener):
    simulator = processes.start(SIMULATOR, scene='four_bar', publish_rate='200.0')
    simulator.wait_until_ready()
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
    ends_well(simulator)


@pytest.mark.parametrize('number', [
    signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
@pytest.mark.parametrize('delay', [
    1.0, *(pytest.param(delay, marks=pytest.mark.slow) for delay in (0.3, 2.0))])
def test_signal_at_any_moment_of_the_start_ends_the_process(processes, number, delay):
    simulator = processes.start(SIMULATOR, scene='four_bar')
    time.sleep(delay)
    code = simulator.stop(number)
    # Before a line of this package has run, Python ends as it does by itself.
    if simulator.output and 'KeyboardInterrupt' not in simulator.output:
        assert code == 0
        assert 'Traceback' not in simulator.output


@pytest.mark.slow
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_while_code_is_generated_ends_the_process(processes, number, tmp_path):
    for trial, delay in enumerate((0.0, 0.2, 0.5, 1.0)):
        processes.environment['CLOSEDLOOP_CACHE_DIR'] = str(tmp_path / f'cold_{trial}')
        simulator = processes.start(SIMULATOR, scene='three_rrr').wait_for('loading scene')
        time.sleep(delay)
        ends_well(simulator, number)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_twenty_simulators_in_one_domain(processes, listener):
    names = [f'/cell_{k}' for k in range(20)]
    simulators = [processes.start(SIMULATOR, namespace=name, scene='four_bar',
                                  publish_rate='20.0') for name in names]
    for simulator in simulators:
        simulator.wait_until_ready()
    states = [listener.listen(f'{name}/joint_states', JointState) for name in names]
    publishers = [listener.publisher(f'{name}/torque_command', Float64MultiArray)
                  for name in names]
    for k, (publisher, received) in enumerate(zip(publishers, states)):
        listener.send(publisher, Float64MultiArray(data=[1.0 + k]),
                      lambda: applied(received, [1.0 + k]), f'state with torque {1.0 + k}')
    for simulator in simulators:
        simulator.send(signal.SIGINT)
    for simulator in simulators:
        assert simulator.wait() == 0


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
