# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Files of sensors are read as they are written, or refused by file, line and key."""

from collections import Counter
from test.attack.test_mutated_scenes import mutated
from test.estimation.recorded import SENSORS

from closedloop_dynamics.estimation.sensors import ImuSensor, JointSensor
from closedloop_dynamics.estimation.setup_file import COMMAND, read_setup, SetupError
from closedloop_dynamics.estimation.unknowns import Payload, Wrench
from closedloop_dynamics.scene.loading import load_scene
import numpy as np
import pytest

TEXT = """\
sensors:
  encoder: {type: joint, joint: theta_1, deviation: 1.0e-4, rate: 100, latency: 0.004}
  elbow: {type: joint, joint: cut_1, deviation: 2.0e-3}
  hand: {type: imu, body: platform, gyroscope: 0.01, accelerometer: 0.1, position: [0.1, 0.0]}
  camera: {type: point, point: platform_center, deviation: 0.001}
  tracker: {type: pose, body: platform, deviation: 0.001, angle: 0.002}
  cell: {type: wrench, joint: cut_1, deviation: 1.0, moment: 0.1}
unknowns:
  part: {type: payload, body: platform, position: [0.2, 0.1155], deviation: 10.0}
  push: {type: wrench, body: platform_center, deviation: 20.0, density: 5.0}
  grease: {type: joint_torque, joint: theta_2, deviation: 1.0, density: 0.1}
  length: {type: number, key: mechanism.joints.theta_2.position.0, deviation: 0.004}
  drift: {type: bias, sensor: hand, component: spin, deviation: 0.01, density: 0.001}
  tilt: {type: gravity, deviation: 0.02}
noise: {torque: 0.5, acceleration: 0.1}
start: {position: 0.001, rate: 0.1}
topics: {hand: /hand/imu}
names: {motor_1: theta_1}
torques: command
gate: 0.99
suspects:
  mass: {type: number, key: mechanism.bodies.platform.mass, deviation: 1.0}
  offset: {type: bias, sensor: encoder, deviation: 0.01}
"""


@pytest.fixture(scope='module')
def scene():
    return load_scene('three_rrr')


@pytest.fixture
def read(scene, tmp_path):
    def read(text):
        path = tmp_path / 'sensors.yaml'
        path.write_text(text)
        return read_setup(path, scene)
    return read


def test_all_that_a_file_says_is_taken_over(read):
    setup = read(TEXT)
    assert setup.sensors[0] == JointSensor(
        'encoder', joint='theta_1', deviation=1e-4, rate=100.0, latency=0.004)
    assert isinstance(setup.sensors[2], ImuSensor) and setup.sensors[2].position == (0.1, 0.0)
    assert [one.name for one in setup.sensors] == [
        'encoder', 'elbow', 'hand', 'camera', 'tracker', 'cell']
    assert setup.unknowns[0] == Payload(
        'part', body='platform', deviation=10.0, position=(0.2, 0.1155))
    assert isinstance(setup.unknowns[1], Wrench) and setup.unknowns[-1].planar
    assert [one.name for one in setup.suspects] == ['mass', 'offset']
    assert (setup.noise.torque, setup.noise.acceleration) == (0.5, 0.1)
    assert (setup.start.position, setup.start.rate) == (0.001, 0.1)
    assert (setup.topics, setup.names) == ({'hand': '/hand/imu'}, {'motor_1': 'theta_1'})
    assert setup.torques == COMMAND and setup.method == 'extended'
    assert setup.gate == 0.99


def test_in_space_places_have_three_numbers():
    scene = load_scene('stewart_platform')
    body, joint = scene.mechanism.bodies[-1].name, scene.mechanism.actuated_joints[0]
    setup = read_setup({
        'sensors': {'leg': {'type': 'joint', 'joint': joint, 'deviation': 1e-4},
                    'hand': {'type': 'imu', 'body': body, 'gyroscope': 0.1, 'accelerometer': 1}},
        'unknowns': {'part': {'type': 'payload', 'body': body, 'deviation': 1.0},
                     'tilt': {'type': 'gravity', 'deviation': 0.01}}}, scene)
    assert setup.sensors[1].position == setup.unknowns[0].position == (0.0, 0.0, 0.0)
    assert not setup.unknowns[1].planar


@pytest.mark.parametrize('old, new, line, problem', [
    ('theta_1, dev', 'theta_9, dev', 2, 'sensors.encoder.joint: .*theta_9.*did you mean'),
    ('deviation: 1.0e-4', 'deviation: -1.0e-4', 2, 'sensors.encoder.deviation: .*positive'),
    ('deviation: 1.0e-4', 'deviation: .nan', 2, 'sensors.encoder.deviation: .*positive.*nan'),
    ('latency: 0.004', 'latency: 0.3', 2, 'sensors.encoder.latency: .*at most 0.2 s'),
    ('rate: 100', 'rat: 100', 2, "sensors.encoder.rat: .*unknown key 'rat'.*'rate'"),
    ('type: imu', 'type: imi', 4, "sensors.hand.type: .*'imu'"),
    ('body: platform, gyro', 'body: hand, gyro', 4, 'sensors.hand.body: .*one of the bodies'),
    ('position: [0.1, 0.0]', 'position: [0.1, 0.0, 0.0]', 4, 'sensors.hand.position: .*2 numbers'),
    ('point: platform_center, ', '', 5, 'sensors.camera.point: expected this required key'),
    ('joint: cut_1, deviation: 1.0', 'joint: cut_9, deviation: 1.0', 7, 'sensors.cell.joint'),
    (', deviation: 10.0', '', 9, 'unknowns.part.deviation: expected this required key'),
    ('deviation: 20.0', 'deviation: 0', 10, 'unknowns.push.deviation: .*positive number, got 0'),
    ('density: 5.0', 'density: -5.0', 10, 'unknowns.push.density: .*zero or more'),
    ('joint: theta_2', 'joint: cut_1', 11, 'unknowns.grease.joint'),
    ('theta_2.position', 'theta_2.place', 12, 'unknowns.length'),
    ('sensor: hand', 'sensor: foot', 13, "unknowns.drift.sensor: .*'foot'"),
    ('{torque: 0.5', '{torqe: 0.5', 15, "noise.torqe: .*'torque'"),
    ('{position: 0.001', '{position: 0', 16, 'start.position: .*positive'),
    ('topics: {hand', 'topics: {foot', 17, 'topics.foot: .*unknown key'),
    ('/hand/imu', "''", 17, 'topics.hand: .*topic'),
    ('motor_1: theta_1', 'motor_1: elbow', 18, 'names.motor_1: .*one of the joints'),
    ('{motor_1: theta_1}', '{a: theta_1, b: theta_1}', 18, 'names.b: .*no other name'),
    ('torques: command', 'torques: both', 19, 'torques: expected one of effort, command'),
    ('gate: 0.99', 'gate: 1', 20, 'gate: expected a probability between 0 and 1, got 1'),
    ('gate: 0.99', 'gate: often', 20, "gate: expected a probability .*'often'"),
    ('sensors:', 'sensor:', 1, "sensor: .*'sensors'")])
def test_what_does_not_fit_is_named_by_line_and_key(read, old, new, line, problem):
    assert old in TEXT
    with pytest.raises(SetupError, match=rf'sensors\.yaml:{line}: {problem}'):
        read(TEXT.replace(old, new, 1))


@pytest.mark.parametrize('text', ['', '[]', 'sensors: {}', 'sensors: 3', 'sensors: {a: }'])
def test_files_without_sensors_are_refused(read, text):
    with pytest.raises(SetupError, match='expected'):
        read(text)


def test_shipped_sensors_fit_their_scene(scene):
    assert len(read_setup(SENSORS, scene).sensors) == 6


@pytest.mark.parametrize('count', [
    300, pytest.param(10_000, marks=(pytest.mark.slow, pytest.mark.timeout(3600)))])
def test_mutated_files_are_refused_in_words_or_right(scene, tmp_path, count):
    """What is accepted has numbers that are finite, and positive where they must be."""
    rng, counts = np.random.default_rng(20261128), Counter()
    path = tmp_path / 'sensors.yaml'
    for _ in range(count):
        path.write_bytes(mutated(rng, TEXT))
        try:
            setup = read_setup(path, scene)
        except SetupError as error:
            assert str(path) in str(error)
            counts['refused'] += 1
            continue
        counts['accepted'] += 1
        for one in setup.sensors:
            numbers = one.deviations(True)
            assert np.isfinite(numbers).all() and min(numbers) > 0.0
        for one in setup.unknowns:
            assert np.isfinite([*one.deviations, *one.densities]).all()
            assert min(one.deviations) > 0.0 and min(one.densities) >= 0.0
    # Damages that nobody notices would test nothing.
    assert min(counts['refused'], counts['accepted']) > 0.05 * count
