# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The node that estimates: by its callbacks, and beside a simulator as a process."""

from copy import copy
import math
from test.estimation.recorded import MACHINE, SENSORS, states
from types import SimpleNamespace

from closedloop_dynamics.estimation.results import Alarm, Estimated
from closedloop_dynamics.recording.message_numbers import stamp_of
from closedloop_dynamics.ros.estimator_node import (
    EstimatorNode, LOST, measurements_finding, model_finding, NOT_USABLE, ODD, RESTARTS, SEVERAL,
    USED)
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.torque_source_node import TorqueSourceNode
from closedloop_dynamics.simulation.simulation import Simulation
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
from rclpy.time import Time
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

NODE, SIMULATOR, SOURCE = (
    'closedloop_estimator', 'closedloop_simulator', 'closedloop_torque_source')
BEGIN = 10 ** 18
DRIVEN = ('theta_1', 'theta_6', 'theta_7')


@pytest.fixture
def build(make_node, monkeypatch):
    """Return a function that builds a node, and keeps what it publishes."""
    def make(**parameters):
        node = make_node(EstimatorNode, **{
            'scene': 'three_rrr', 'sensors': str(SENSORS), 'mode': 'lockstep', **parameters})
        node.seen, node.unknown = [], []
        monkeypatch.setattr(node.states, 'publish', lambda *state: node.seen.append(state))
        node.send_unknowns = lambda stamp, values: node.unknown.append(values)
        return node
    return make


def measured(k, names=None, begin=BEGIN, **changes):
    """Return what the machine publishes at its k-th state, of some joints or of all."""
    known, found = states(120)
    time, q, qd, effort, _ = found[k]
    message = JointState(name=list(known), position=q.tolist(), velocity=qd.tolist(),
                         effort=effort.tolist())
    if names is not None:
        places = [known.index(name) for name in names]
        for key in ('name', 'position', 'velocity', 'effort'):
            setattr(message, key, [getattr(message, key)[place] for place in places])
    message.header.stamp = Time(nanoseconds=begin + round(1e9 * time)).to_msg()
    for key, value in changes.items():
        setattr(message, key, value)
    return message


def feed(node, first, last, **more):
    for k in range(first, last):
        node.on_measurement('joint_states', measured(k, **more))


def test_state_and_load_follow_from_three_noisy_encoders(build):
    node = build()
    feed(node, 0, 120, names=DRIVEN)
    assert node.counts == {USED: 120, NOT_USABLE: 0, ODD: 0, LOST: 0, RESTARTS: 1}
    stamp, q, qd, effort, forces, cuts = node.seen[-1]
    _, found = states(120)
    time, _, _, torque, true = found[-1]
    assert stamp == BEGIN + round(1e9 * time)
    # Encoders are good to 1.5e-4 rad, and the filter makes more of them.
    np.testing.assert_allclose(q, true, atol=5e-4)
    np.testing.assert_allclose(qd, (true - found[-2][-1]) / 0.01, atol=0.02)
    assert effort.tolist() == torque.tolist() and cuts[0].shape == (2,)
    mass, deviation = node.unknown[-1]
    assert abs(mass - 5.0) < 4.0 * deviation < 0.25
    assert len(forces) == len(node.estimator.estimate().joint_forces.names)
    # Of half a second it is enough for 5 %.
    assert abs(node.unknown[50][0] - 5.0) < 0.25


def test_partial_messages_and_other_names_do_and_give_the_same(build, tmp_path):
    path = tmp_path / 'sensors.yaml'
    path.write_text(SENSORS.read_text() + 'names: {motor: theta_1}\n')
    whole, partial = build(), build(sensors=str(path))
    for k in range(40):
        whole.on_measurement('joint_states', measured(k, names=DRIVEN))
        message = measured(k, names=DRIVEN[::-1])
        message.name = ['motor' if name == 'theta_1' else name for name in message.name]
        partial.on_measurement('joint_states', message)
    np.testing.assert_allclose(partial.seen[-1][1], whole.seen[-1][1], atol=1e-9)
    # Without one of the encoders the others go on.
    for k in range(40, 60):
        message = measured(k, names=DRIVEN)
        message.position = [math.nan, *message.position[1:]]
        whole.on_measurement('joint_states', message)
    assert whole.counts[NOT_USABLE] == 0
    np.testing.assert_allclose(whole.seen[-1][1], states(120)[1][59][-1], atol=2e-3)


HAND = '  hand: {type: imu, body: platform, gyroscope: 0.01, accelerometer: 0.1}\n'


def test_topics_of_sensors_are_parameters(build, tmp_path):
    path = tmp_path / 'sensors.yaml'
    path.write_text(SENSORS.read_text().replace('\nunknowns', f'{HAND}\nunknowns', 1))
    node = build(**{'sensors': str(path), 'topics.hand': '/hand/imu'})
    topics = {one.topic_name: one.msg_type for one in node.subscriptions}
    assert topics['/hand/imu'] is Imu and topics['/joint_states'] is JointState
    assert node.get_parameter('topics.encoder_1').value == 'joint_states'
    assert 'hand' in node.describe_parameter('topics.hand').description
    for topic in 'joint_states', '':
        with pytest.raises(StartError, match='parameter topics.hand: expected a topic of .*Imu'):
            build(**{'sensors': str(path), 'topics.hand': topic})


BAD = [
    {'name': ['elbow', 'knee', 'hip']}, {'position': [0.0]}, {'velocity': [0.0]},
    {'position': [math.inf] * 3}, {'effort': [-math.inf] * 3}, {'name': ['theta_1'] * 3}]


def test_bad_messages_are_counted_and_change_nothing(build):
    """Bit for bit: another mechanism's names, lengths, infinite numbers, stamps far away."""
    node, other = build(), build()
    for k in range(20):
        node.on_measurement('joint_states', measured(k, names=DRIVEN))
        other.on_measurement('joint_states', measured(k, names=DRIVEN))
        for change in BAD:
            # With the stamp of the next good one, a while ahead, and far away, again and again.
            for begin in BEGIN + 10 ** 7, BEGIN + 9 * 10 ** 8, BEGIN + 10 ** 12:
                other.on_measurement('joint_states', measured(
                    k, names=DRIVEN, begin=begin, **change))
        for begin in BEGIN + 10 ** 7, BEGIN + 9 * 10 ** 8:
            other.on_measurement('joint_states', measured(
                k, names=DRIVEN, begin=begin, **dict.fromkeys(
                    ('position', 'velocity', 'effort'), 3 * [math.nan])))
        other.on_measurement('joint_states', measured(k, names=DRIVEN, begin=BEGIN + 10 ** 12))
        other.on_measurement('joint_states', measured(k, names=DRIVEN, begin=0))
    assert other.counts == {USED: 20, NOT_USABLE: 60 * len(BAD), ODD: 40, LOST: 0, RESTARTS: 1}
    for one, two in zip(node.seen, other.seen):
        assert (one[1] == two[1]).all() and (one[2] == two[2]).all()
    assert len(node.seen) == len(other.seen)


def test_late_messages_within_a_while_are_put_in_order(build):
    node, late = build(), build()
    order = [*range(20), 21, 22, 20, *range(23, 40)]
    for k, other in enumerate(order):
        node.on_measurement('joint_states', measured(k, names=DRIVEN))
        late.on_measurement('joint_states', measured(other, names=DRIVEN))
    assert late.counts[USED] == 40 and late.counts[NOT_USABLE] == 0
    np.testing.assert_allclose(late.seen[-1][1], node.seen[-1][1], atol=1e-4)


def test_started_in_mid_motion_it_finds_the_motion(build):
    node = build()
    feed(node, 80, 120, names=DRIVEN)
    assert node.counts[RESTARTS] == 1 and node.counts[NOT_USABLE] == 0
    np.testing.assert_allclose(node.seen[-1][1], states(120)[1][119][-1], atol=1e-3)
    mass, deviation = node.unknown[-1]
    assert abs(mass - 5.0) < 4.0 * deviation


def test_jumps_in_time_begin_another_run(build):
    node = build()
    feed(node, 0, 30, names=DRIVEN)
    feed(node, 0, 30, names=DRIVEN, begin=BEGIN // 2)
    # As many as make a jump are not used.
    assert node.counts[RESTARTS] == 2 and node.counts[ODD] == SEVERAL - 1
    assert node.seen[-1][0] == BEGIN // 2 + round(1e9 * states(120)[1][29][0])
    np.testing.assert_allclose(node.seen[-1][1], states(120)[1][29][-1], atol=1e-3)


def test_pause_and_reset(build):
    node = build()
    feed(node, 0, 10, names=DRIVEN)
    assert node.on_pause(SetBool.Request(data=True), SetBool.Response()).success
    feed(node, 10, 20, names=DRIVEN)
    assert node.counts[USED] == 10 and len(node.seen) == 10
    node.on_pause(SetBool.Request(data=False), SetBool.Response())
    feed(node, 60, 70, names=DRIVEN)
    assert node.counts[RESTARTS] == 2
    np.testing.assert_allclose(node.seen[-1][1], states(120)[1][69][-1], atol=2e-3)
    assert node.on_reset(Trigger.Request(), Trigger.Response()).success and node.estimator is None
    # Nothing stays of the run before.
    other = build()
    node.seen.clear()
    for each in node, other:
        feed(each, 70, 100, names=DRIVEN)
    for one, two in zip(node.seen, other.seen, strict=True):
        assert one[0] == two[0] and (one[1] == two[1]).all() and (one[2] == two[2]).all()
    assert node.unknown[-1] == other.unknown[-1]


def test_many_states_that_are_lost_begin_another_run(build):
    """They had the torques."""
    node, other = build(), build()
    feed(node, 0, 40, names=DRIVEN)
    node.on_lost('joint_states', 3)
    feed(node, 43, 60, names=DRIVEN)
    assert node.counts[LOST] == 3 and node.counts[RESTARTS] == 1
    node.on_lost('joint_states', 20)
    node.seen.clear()
    for each in node, other:
        feed(each, 80, 110, names=DRIVEN)
    assert node.counts[LOST] == 23 and node.counts[RESTARTS] == 2
    assert (node.seen[-1][1] == other.seen[-1][1]).all()


def test_estimate_is_found_again_where_the_clock_went_on_without_the_machine(build):
    """Some readings go on to fit."""
    node = build()
    feed(node, 0, 60, names=DRIVEN)
    feed(node, 60, 120, names=DRIVEN, begin=BEGIN + 9 * 10 ** 8)
    assert node.counts[RESTARTS] == 2
    np.testing.assert_allclose(node.seen[-1][1], states(120)[1][119][-1], atol=2e-3)
    mass, deviation = node.unknown[-1]
    assert abs(mass - 5.0) < 4.0 * deviation


def test_one_sensor_that_is_wrong_does_not_end_the_run(build):
    node = build()
    feed(node, 0, 40, names=DRIVEN)
    for k in range(40, 120):
        message = measured(k, names=DRIVEN)
        message.position[0] += 0.2
        node.on_measurement('joint_states', message)
    assert node.counts[RESTARTS] == 1
    assert [alarm.name for alarm in node.estimator.alarms] == ['encoder_1']
    np.testing.assert_allclose(node.seen[-1][1], states(120)[1][119][-1], atol=1e-3)


def test_commands_in_the_place_of_efforts(build, tmp_path):
    path = tmp_path / 'sensors.yaml'
    path.write_text(SENSORS.read_text() + 'torques: command\n')
    node = build(sensors=str(path))
    names, found = states(120)
    places = [names.index(name) for name in DRIVEN]
    for k in range(60):
        # It acts from the state before on.
        node.on_torque_command(Float64MultiArray(data=found[k][3][places].tolist()))
        node.on_measurement('joint_states', measured(k, names=DRIVEN))
    node.on_torque_command(Float64MultiArray(data=[1.0]))
    node.on_joint_command(JointState(name=['elbow'], effort=[1.0]))
    assert node.counts[NOT_USABLE] == 2
    mass, deviation = node.unknown[-1]
    assert abs(mass - 5.0) < 4.0 * deviation < 1.0


def test_loads_have_a_covariance_and_markers_are_pale(build, tmp_path):
    path = tmp_path / 'sensors.yaml'
    path.write_text(SENSORS.read_text().replace(
        'part: {type: payload, body: platform, position: [0.2, 0.1155], deviation: 10.0}',
        'push: {type: wrench, body: platform_center, deviation: 100.0, density: 20.0}'))
    node = build(sensors=str(path))
    wrenches, covariances = [], []
    node.loads['push'] = (
        *node.loads['push'][:2], SimpleNamespace(publish=wrenches.append),
        SimpleNamespace(filled=lambda sec, nanosec, wrench: wrench.copy()),
        lambda stamp, values: covariances.append(values))
    feed(node, 0, 100, names=DRIVEN)
    # The weight of 5 kg.
    deviation = np.sqrt(np.array(covariances[-1]).reshape(6, 6).diagonal())
    assert (np.abs(wrenches[-1] - [0.0, -5.0 * 9.81, 0, 0, 0, 0])
            <= np.maximum(4.0 * deviation, 1e-12)).all()
    assert 0.0 < deviation[1] < 10.0 and (deviation[2:] == 0.0).all()
    array = node.markers.array(Time(nanoseconds=BEGIN).to_msg()).markers
    links = [one for one in array if one.ns == 'links']
    assert links and all(one.color.a < 0.5 for one in links)
    text, = (one.text for one in array if one.type == Marker.TEXT_VIEW_FACING)
    assert 'push.y' in text


def test_in_real_time_silence_widens_the_band(build):
    node = build(mode='realtime')
    clock = [0.0]
    node.seconds = lambda: clock[0]
    for k in range(30):
        clock[0] += 0.01
        node.on_measurement('joint_states', measured(k, names=DRIVEN))
        node.tick()
    assert len(node.seen) == 29 + (len(node.seen) == 30)
    before = node.estimator.belief.covariance.diagonal()[:3].copy()
    clock[0] += 0.5
    node.tick()
    assert (node.estimator.belief.covariance.diagonal()[:3] > 4.0 * before).all()
    assert node.seen[-1][0] == pytest.approx(node.seen[-2][0] + 5e8, abs=2)
    # For a while; then nothing is published.
    count = len(node.seen)
    clock[0] += 2.0
    node.tick()
    assert len(node.seen) == count


@pytest.mark.parametrize('scene, method, noise', [
    ('stewart_platform', 'extended', 'torque'),
    ('carpet_scraper_dry', 'sigma_points', 'acceleration')])
def test_machines_in_space_and_with_jumps_are_followed(build, tmp_path, scene, method, noise):
    """A platform with an orientation; dry friction and drives with limits."""
    machine, rng = Simulation.from_scene(scene), np.random.default_rng(0)
    joints = [name for name in machine.actuated_joints if name in machine.joint_names]
    path = tmp_path / 'sensors.yaml'
    path.write_text('sensors:\n' + ''.join(
        f'  encoder_{k}: {{type: joint, joint: {name}, deviation: 1.0e-5}}\n'
        for k, name in enumerate(joints)) + f'method: {method}\nnoise: {{{noise}: 0.01}}\n'
        'start: {position: 0.001, rate: 0.1}\n')
    node = build(scene=scene, sensors=str(path))
    places = [machine.joint_names.index(name) for name in joints]
    for k in range(30):
        machine.step(None, 0.005)
        message = JointState(
            name=joints, effort=[0.0] * len(joints), position=(
                machine.coordinates.by_freedom(machine.position)[places]
                + 1e-5 * rng.normal(size=len(joints))).tolist())
        message.header.stamp = Time(nanoseconds=BEGIN + round(1e9 * machine.time)).to_msg()
        node.on_measurement('joint_states', message)
    assert node.counts == {USED: 30, NOT_USABLE: 0, ODD: 0, LOST: 0, RESTARTS: 1}
    # Passive joints move by more than the encoders are wrong, next to ten times as much.
    apart = machine.coordinates.apart(machine.position, node.seen[-1][1])
    assert np.abs(apart).max() < 3e-4


@pytest.mark.parametrize('parameters, problem', [
    ({'scene': ''}, "'scene': expected"), ({'sensors': ''}, "'sensors': expected"),
    ({'sensors': 'none.yaml'}, "'sensors': none.yaml"), ({'scene': 'no_such'}, 'no_such'),
    ({'scene': 'four_bar'}, "'sensors': .*:5: sensors.encoder_1.joint: .*theta_1"),
    ({'mode': 'backwards'}, 'realtime')])
def test_bad_parameters_are_refused(make_node, parameters, problem):
    with pytest.raises(StartError, match=problem):
        make_node(EstimatorNode, **{
            'scene': 'three_rrr', 'sensors': str(SENSORS), **parameters})


@pytest.mark.parametrize('news, standing, level, word', [
    ({USED: 5}, '', DiagnosticStatus.OK, 'are used'),
    ({}, '', DiagnosticStatus.WARN, 'no measurements'),
    ({}, 'paused', DiagnosticStatus.WARN, 'paused'),
    ({USED: 5, NOT_USABLE: 1}, '', DiagnosticStatus.WARN, 'the reason'),
    ({USED: 5, LOST: 1}, '', DiagnosticStatus.WARN, 'the reason'),
    ({USED: 5, RESTARTS: 1}, '', DiagnosticStatus.WARN, 'a run has begun')])
def test_what_comes_in_is_judged(news, standing, level, word):
    none = dict.fromkeys((USED, NOT_USABLE, ODD, LOST, RESTARTS), 0)
    finding = measurements_finding({**none, **news}, 'the reason', standing)
    assert finding.level == level and word in finding.message


def test_an_alarm_is_an_error():
    unknowns = Estimated(('part',), np.array([5.0]), np.array([0.1]))
    assert model_finding((), unknowns).level == DiagnosticStatus.OK
    alarm = Alarm('sensor', 'encoder_1', math.nan, math.nan, 50.0, 1.0, 'encoder_1 is wrong')
    finding = model_finding((alarm,), unknowns)
    assert finding.level == DiagnosticStatus.ERROR and 'encoder_1 is wrong' in finding.message
    assert finding.values == {'part': 5.0, 'part, standard deviation': 0.1}


def test_process_estimates_what_a_simulator_publishes(processes, listener):
    """The load is found within its deviation, and the model explains what is measured."""
    node = processes.start(
        NODE, scene='three_rrr', sensors=SENSORS, mode='lockstep').wait_until_ready()
    estimates = listener.listen('estimated_joint_states', JointState)
    unknown = listener.listen('estimated_unknowns', Float64MultiArray)
    findings = listener.listen('/diagnostics', DiagnosticArray)
    drive = ['--ros-args', '--params-file',
             str(MACHINE.parents[1] / 'controllers' / 'three_rrr_circle.yaml')]
    # In lockstep a busy host changes nothing. Without a clock the start is published again with
    # its stamp, not as that of a machine which something holds.
    processes.start(SIMULATOR, arguments=drive, scene=MACHINE, mode='lockstep',
                    wait_for_subscribers=3)
    source = processes.start(SOURCE, arguments=drive, scene=MACHINE)
    listener.listen('joint_states', JointState)
    listener.wait(lambda: estimates and unknown and 0.0 < unknown[-1].data[3] < 0.05,
                  'an estimate of the load')
    *_, mass, deviation = unknown[-1].data
    assert unknown[-1].layout.dim[0].label.split()[2:] == ['part', 'part.deviation']
    assert abs(mass - 5.0) < 5.0 * deviation
    assert set(estimates[-1].name) > set(DRIVEN)
    listener.wait(lambda: any(status.name == f'{NODE}: model' and status.level == (
        DiagnosticStatus.OK) for message in findings for status in message.status), 'a finding')
    assert source.stop() == 0
    assert node.stop() == 0


def test_another_node_goes_on_in_mid_motion_and_bears_nonsense(run, listener, tmp_path):
    """The load is found again by a node that has not seen the motion begin."""
    drive = {'scene': str(MACHINE), 'arguments': ['--params-file', str(
        MACHINE.parents[1] / 'controllers' / 'three_rrr_circle.yaml')]}
    path = tmp_path / 'sensors.yaml'
    path.write_text(SENSORS.read_text().replace('\nunknowns', f'{HAND}\nunknowns', 1))
    settings = {'scene': 'three_rrr', 'sensors': str(path), 'mode': 'lockstep',
                'topics.hand': '/hand'}
    unknown = listener.listen('estimated_unknowns', Float64MultiArray)
    findings = listener.listen('/diagnostics', DiagnosticArray)

    def found():
        return unknown and 0.0 < unknown[-1].data[3] < 0.05

    node = run(EstimatorNode, **settings)
    run(SimulatorNode, mode='lockstep', wait_for_subscribers=2, **drive)
    run(TorqueSourceNode, **drive)
    listener.wait(found, 'an estimate of the load')
    listener.remove(node)
    unknown.clear()
    run(EstimatorNode, **settings)
    listener.wait(found, 'an estimate of the load by another node')
    publisher, message = listener.publisher('/hand', Imu), Imu()
    message.linear_acceleration.x = math.inf

    def reported():
        seconds, rest = unknown[-1].data[:2]
        message.header.stamp = Time(seconds=int(seconds), nanoseconds=int(rest)).to_msg()
        return any(status.level == DiagnosticStatus.WARN and 'expected finite' in status.message
                   for one in findings for status in one.status)

    listener.send(publisher, message, reported, 'a finding')
    # In lockstep the torque source, which reads the same topic, must not leave a state without an
    # answer.
    states = listener.listen('joint_states', JointState)
    listener.wait(lambda: states, 'a state')
    publisher = listener.publisher('joint_states', JointState)
    for change in (*BAD, {'position': [math.nan] * 9}, {'begin': 10 ** 12}, {'begin': 1}):
        newest, change = states[-1], dict(change)
        begin = change.pop('begin', 0)
        nonsense = copy(newest)
        nonsense.header = Header(stamp=Time(nanoseconds=begin + (
            0 if begin else stamp_of(newest))).to_msg())
        for key, value in change.items():
            setattr(nonsense, key, value)
        publisher.publish(nonsense)
    listener.wait(lambda: any(
        'joint_states not usable' in status.message or 'is not used' in status.message
        for one in findings for status in one.status), 'a finding on joint_states')
    unknown.clear()
    listener.wait(lambda: len(unknown) > 100 and found(), 'estimates after nonsense')
    *_, mass, deviation = unknown[-1].data
    assert abs(mass - 5.0) < 5.0 * deviation
