# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Messages and files become readings and torques: partial, wrong, late and repeated ones."""

import math
from test.estimation.recorded import message, SENSORS, states, write_bag, write_csv
from types import SimpleNamespace

from closedloop_dynamics import load_scene, Model
from closedloop_dynamics.estimation.record_file import (
    begun, read_events, record_of, without_latency)
from closedloop_dynamics.estimation.setup_file import read_setup
from closedloop_dynamics.estimation.start_finder import StartFinder
from closedloop_dynamics.estimation.streams import StreamError, Streams
from closedloop_dynamics.kinematics.passive_joint_solver import PassiveJointError
from closedloop_dynamics.recording.errors import RecordingError
from closedloop_dynamics.recording.forces import MessageBag
from closedloop_dynamics.recording.reading import BagReadError
import numpy as np
import pytest

ENCODERS = ('encoder_1', 'encoder_6', 'encoder_7')


@pytest.fixture(scope='module')
def scene():
    return load_scene('three_rrr')


@pytest.fixture(scope='module')
def setup(scene):
    return read_setup(SENSORS, scene)


@pytest.fixture
def streams(setup, scene):
    return Streams(setup, scene.mechanism)


def test_partial_messages_give_what_they_have(streams):
    found = streams.measurements('joint_states', message(
        ['other', 'theta_7', 'theta_1'], [9.0, 0.5, math.nan], [1.0, math.nan, 2.0]))
    assert found == [('encoder_7', (0.5,)), ('rate_1', (2.0,))]
    assert streams.torques(message(
        ['theta_7', 'theta_2', 'theta_1'], effort=[3.0, 4.0, math.nan])) == {'theta_7': 3.0}
    # The same message again, as of a simulator that stands still.
    assert not streams.measurements('joint_states', message(['theta_1'], [0.1]))
    assert streams.measurements('joint_states', message(['theta_1'], [0.1], stamp=1))


@pytest.mark.parametrize('bad, problem', [
    (message(['elbow', 'knee'], [0.1, 0.2]), 'names none of theta_1, .*, but elbow, knee'),
    (message(['theta_1'], [0.1, 0.2]), 'one per name, got 2 for 1'),
    (message(['theta_1', 'theta_1'], [0.1, 0.2]), 'named twice'),
    (message(['theta_1'], [math.inf]), 'encoder_1: expected finite'), (message(), 'nothing')])
def test_wrong_messages_are_refused_and_change_nothing(streams, bad, problem):
    with pytest.raises(StreamError, match=problem):
        streams.measurements('joint_states', bad)
    assert len(streams.measurements('joint_states', message(['theta_1'], [0.1]))) == 1


def test_angles_follow_one_another_over_turns(streams):
    streams.begin({'theta_1': 20.0})
    for k, angle in enumerate((20.1, 22.0, 22.4)):
        (_, (value,)), = streams.measurements('joint_states', message(
            ['theta_1'], [math.remainder(angle, 2.0 * math.pi)], stamp=k))
        assert value == pytest.approx(angle)


def test_other_sensors_read_their_messages(scene):
    setup = read_setup({
        'sensors': {'hand': {'type': 'imu', 'body': 'platform', 'gyroscope': 1,
                             'accelerometer': 1},
                    'tracker': {'type': 'pose', 'body': 'platform', 'deviation': 1, 'angle': 1},
                    'camera': {'type': 'point', 'point': 'corner_1', 'deviation': 1},
                    'cell': {'type': 'wrench', 'joint': 'cut_1', 'deviation': 1, 'moment': 1}},
        'topics': {'hand': '/hand/imu'}}, scene)
    streams = Streams(setup, scene.mechanism)
    assert streams.topics == {
        'joint_states': 'sensor_msgs/msg/JointState', '/hand/imu': 'sensor_msgs/msg/Imu',
        'tracker': 'geometry_msgs/msg/PoseStamped', 'camera': 'geometry_msgs/msg/PoseStamped',
        'cell': 'geometry_msgs/msg/WrenchStamped'}

    def three(x, y, z, **more):
        return SimpleNamespace(x=x, y=y, z=z, **more)

    header = message().header
    assert streams.measurements('/hand/imu', SimpleNamespace(
        header=header, angular_velocity=three(1.0, 2.0, 3.0),
        linear_acceleration=three(4.0, 5.0, 6.0))) == [('hand', (3.0, 4.0, 5.0))]
    turned = three(0.0, 0.0, math.sin(0.4), w=math.cos(0.4))
    pose = SimpleNamespace(header=header, pose=SimpleNamespace(
        position=three(1.0, 2.0, 3.0), orientation=turned))
    (_, found), = streams.measurements('tracker', pose)
    np.testing.assert_allclose(found, (1.0, 2.0, 0.8))
    assert streams.measurements('camera', pose) == [('camera', (1.0, 2.0))]
    pose.pose.orientation = three(0.0, 0.0, 0.0, w=0.0)
    pose.header = message(stamp=1).header
    with pytest.raises(StreamError, match='unit quaternion'):
        streams.measurements('tracker', pose)
    assert streams.measurements('cell', SimpleNamespace(header=header, wrench=SimpleNamespace(
        force=three(1.0, 2.0, 3.0), torque=three(4.0, 5.0, 6.0)))) == [('cell', (6.0, 1.0, 2.0))]


def test_bag_and_rows_are_the_same_record(setup, scene, tmp_path):
    names, found = states(20)
    read = [read_events(path, setup, scene.mechanism) for path in (
        write_csv(tmp_path / 'run.csv', 20), write_bag(tmp_path / 'bag', 20))]
    records = [record_of(events, setup, scene.mechanism, -0.004) for events in read]
    assert read[1].begin == 10 ** 18 + 10 ** 7
    for record in records:
        angles = record.measurements['encoder_6'][:, 0]
        there = np.isfinite(angles)
        # When they were true; between are the instants from which on other torques acted.
        np.testing.assert_allclose(record.times[there], 0.01 * np.arange(20) - 0.004, atol=1e-9)
        np.testing.assert_allclose(record.times[~there], 0.01 * np.arange(19), atol=1e-9)
        np.testing.assert_allclose(angles[there], [state[1][5] for state in found])
        # What a state tells was exerted since the one before.
        np.testing.assert_allclose(record.torques[~there, 1], [
            state[3][names.index('theta_6')] for state in found[1:]])
    assert set(records[0].measurements) == {one.name for one in setup.sensors}


def test_a_run_begins_where_its_joints_are(setup, scene, tmp_path):
    """Killed and started again in mid-motion: positions and rates are those of the motion."""
    _, found = states(60)
    events = read_events(write_csv(tmp_path / 'run.csv', 60), setup, scene.mechanism)
    events = events._replace(measurements=[one for one in events.measurements if one[0] > 0.295])
    latency, setup = setup.sensors[0].latency, without_latency(setup)
    start, rest = begun(events, StartFinder(setup, Model(scene)))
    assert start.time == pytest.approx(0.30 - latency) and rest.measurements[0][0] > start.time
    before, now = (found[k][-1] for k in (29, 30))
    # Between the two states, as old as the sensors are.
    np.testing.assert_allclose(start.state.q, now + latency / 0.01 * (before - now), atol=2e-3)
    np.testing.assert_allclose(start.state.qd, (now - before) / 0.01, atol=0.1)
    without = setup._replace(sensors=setup.sensors[:3])
    rates = begun(events, StartFinder(without, Model(scene)))[0].state.qd
    np.testing.assert_allclose(rates, start.state.qd, atol=0.3)


def test_joints_that_cannot_be_there_begin_nothing(setup, scene):
    start_finder = StartFinder(setup, Model(scene))
    # All proximal links point outwards: the platform does not reach their ends.
    readings = dict(zip(ENCODERS, ((3.67,), (-0.52,), (1.57,))))
    readings.update({f'rate_{name[-1]}': (0.0,) for name in ENCODERS})
    with pytest.raises(PassiveJointError):
        start_finder.take(0.0, readings)


def write(path, lines):
    path.write_text('\n'.join(lines) + '\n')
    return path


@pytest.mark.parametrize('lines, problem', [
    (['time,position.elbow', '0,1'], 'expected the columns time and position.theta_1'),
    (['time,position.theta_1', '0,1', '0,1'], 'a time that increases'),
    (['time,position.theta_1', '0,inf'], 'encoder_1: expected finite'),
    (['time,position.theta_1', '0,nan'], 'no sensor has measured anything'),
    (['time,position.theta_1', '0,x'], 'expected a number'), (['time,position.theta_1'], 'rows')])
def test_rows_that_do_not_do_are_refused(setup, scene, tmp_path, lines, problem):
    with pytest.raises(RecordingError, match=problem):
        read_events(write(tmp_path / 'run.csv', lines), setup, scene.mechanism)


def test_bags_that_do_not_do_are_refused(setup, scene, tmp_path):
    with pytest.raises(BagReadError):
        read_events(tmp_path, setup, scene.mechanism)
    with MessageBag(tmp_path / 'other') as bag:
        bag.state('/joint_states', 0, ['elbow'], [1.0], [0.0], [0.0])
    with pytest.warns(UserWarning, match='1 messages are not used'), pytest.raises(
            RecordingError, match='expected measurements on .*joint_states.*names none of'):
        read_events(tmp_path / 'other', setup, scene.mechanism)
    with pytest.raises(RecordingError, match='the topics in it are /joint_states'):
        read_events(tmp_path / 'other', setup, scene.mechanism, namespace='left')


def test_of_a_bag_in_which_time_goes_back_the_last_run_is_read(setup, scene, tmp_path):
    names, found = states(20)
    with MessageBag(tmp_path / 'bag') as bag:
        for begin in (10 ** 18, 10 ** 17):
            for time, q, qd, effort, _ in found:
                bag.state('/joint_states', begin + round(1e9 * time), names, q, qd, effort)
    with pytest.warns(UserWarning, match='time goes back'):
        events = read_events(tmp_path / 'bag', setup, scene.mechanism)
    assert events.begin == 10 ** 17 + 10 ** 7 and len(events.measurements) == 6 * 20
