# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The demonstration ends by itself, tells the truth, and leaves no process behind."""

import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
import uuid

from closedloop_dynamics.ros import demo
from closedloop_dynamics.ros.bag import BagWriter
from closedloop_dynamics.ros.demo_drive import aim_of, drive_for, shipped_drives
from closedloop_dynamics.ros.demo_recording import read_recording, Recording
from closedloop_dynamics.ros.demo_report import draw, summary, wanted_motion
from closedloop_dynamics.ros.torque_source_parameters import TORQUE_SOURCE_PARAMETERS
from closedloop_dynamics.scene import load_scene, scene_names
from closedloop_dynamics.simulation import Simulation
from closedloop_dynamics.studies.motion import Motion
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

ROOT = Path(__file__).resolve().parents[2]
MARK = 'CLOSEDLOOP_DYNAMICS_TEST_DEMO'
PATIENCE = 200.0
pytestmark = pytest.mark.timeout(600)


class Demo:
    """The demonstration in a process, and all processes that came of it."""

    def __init__(self, *arguments, directory):
        self._mark = f'{MARK}={uuid.uuid4().hex}'
        name, _, value = self._mark.partition('=')
        self.output = directory / 'output'
        self.process = subprocess.Popen(
            [sys.executable, '-P', '-m', 'closedloop_dynamics.ros.demo', *arguments,
             '--output', str(self.output)],
            env={**os.environ, 'PYTHONPATH': str(ROOT), 'PYTHONUNBUFFERED': '1', name: value},
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            cwd=directory, start_new_session=True)

    def alive(self):
        """Return the command lines of all its processes, by process id."""
        found = {}
        for path in Path('/proc').glob('[0-9]*'):
            try:
                if self._mark.encode() in (path / 'environ').read_bytes().split(b'\0'):
                    command = (path / 'cmdline').read_bytes().decode().split('\0')
                    found[int(path.name)] = ' '.join(command)
            except OSError:
                continue
        return found

    def wait_for(self, function):
        """Return the id of the process that runs a function of ``executables``."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            for number, command in self.alive().items():
                if f'executables.{function}()' in command:
                    return number
            assert self.process.poll() is None, self.process.communicate()
            time.sleep(0.05)
        pytest.fail(f'no process runs {function}')

    def end(self):
        """Return exit code and output once it has ended; nothing of it may be left."""
        try:
            text, errors = self.process.communicate(timeout=PATIENCE)
            left = self.alive()
        finally:
            for number in self.alive():
                os.kill(number, signal.SIGKILL)
        assert not left
        assert 'Traceback' not in errors
        return self.process.returncode, text, errors


@pytest.fixture
def start(domain, tmp_path):
    """Return a function that starts a demonstration."""
    return lambda *arguments: Demo(*arguments, directory=tmp_path)


def check_pictures(directory):
    for name in ('joint_motion', 'constraint_forces', 'positions'):
        assert (directory / f'{name}.png').read_bytes().startswith(b'\x89PNG')


def test_short_demonstration_from_start_to_end(start):
    run = start('four_bar', '--duration', '2')
    code, text, errors = run.end()
    assert code == 0, text + errors
    count = int(re.search(r'recorded +(\d+) messages', text)[1])
    rows = re.findall(r'(\S+) +(\d+) messages at +([\d.]+) Hz', text)
    # On a busy machine the recorder may find the torque source after the end.
    assert {topic for topic, *_ in rows} - {'torque_command'} == {
        'constraint_forces/cut_1', 'joint_states', 'replay_log'}
    once = re.findall(r'(\S+) +1 message$', text, re.MULTILINE)
    assert set(once) <= {'scene', 'robot_description'}
    assert sum(int(number) for _, number, _ in rows) + len(once) == count > 200
    assert 'commands:' in text and '0 rejected' in text
    assert float(re.search(r'closed within (\S+) m', text)[1]) < 1e-10
    assert text.rstrip().endswith(f'{run.output}/')
    check_pictures(run.output / 'four_bar')
    recording = read_recording(
        run.output / 'four_bar' / 'bag', '/demo_four_bar', load_scene('four_bar').mechanism)
    assert recording.count == count
    # The motion begins with the first torque and is recorded from there.
    assert 1.8 < recording.motion.time[-1] < 20.0
    assert np.abs(recording.motion.effort[1:, 0]).max() > 0.0


@pytest.mark.slow
def test_default_demonstration_holds_what_it_drives(start):
    code, text, errors = start().end()
    assert code == 0, text + errors
    assert [name in text for name in ('[1/2] carpet_scraper', '[2/2] three_rrr')] == [True, True]
    turning = re.search(r'theta_1 turns at ([\d.]+) rad/s over (\d+) whole turns', text)
    assert float(turning[1]) == pytest.approx(4.7124, rel=0.01)
    assert int(turning[2]) >= 4
    follows = re.search(r'theta_1, theta_6, theta_7 follow .* within ([\d.e-]+) rad \(rms\)', text)
    assert float(follows[1]) < 0.02


@pytest.mark.parametrize('number', [signal.SIGINT, pytest.param(
    signal.SIGTERM, marks=pytest.mark.slow)])
def test_interrupted_demonstration_leaves_nothing(start, number):
    run = start('four_bar', '--duration', '600')
    run.wait_for('torque_source')
    run.process.send_signal(number)
    # A second one, of an impatient user, changes nothing.
    run.process.send_signal(number)
    code, _, errors = run.end()
    assert code == 128 + number
    assert 'Interrupted' in errors


@pytest.mark.slow
@pytest.mark.parametrize('function', ['simulator', 'recorder', 'torque_source'])
def test_a_node_that_dies_ends_the_demonstration_with_its_name(start, function):
    run = start('four_bar', '--duration', '600')
    run.wait_for('simulator')
    os.kill(run.wait_for(function), signal.SIGKILL)
    code, _, errors = run.end()
    assert code == 1
    assert f'closedloop_{function} ended early' in errors and '-9' in errors


@pytest.mark.slow
def test_nodes_end_with_a_demonstration_that_is_killed(start):
    run = start('four_bar', '--duration', '600')
    run.wait_for('simulator')
    run.process.kill()
    run.process.communicate()
    deadline = time.monotonic() + 60.0
    while run.alive() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert run.end()[0] == -signal.SIGKILL


@pytest.mark.parametrize('arguments, words', [
    (['four_barr'], ['four_barr', 'four_bar']),
    (['four_bar', '--duration', '0'], ['--duration', '0']),
    (['four_bar', '--duration', 'long'], ['--duration', 'long'])])
def test_usage_errors_come_before_any_node(arguments, words, capsys):
    with pytest.raises(SystemExit) as end:
        demo.main(arguments)
    assert end.value.code == 2
    errors = capsys.readouterr().err
    for word in words:
        assert word in errors


def test_an_output_directory_with_files_is_left_alone(tmp_path, capsys):
    (tmp_path / 'precious').write_text('data')
    with pytest.raises(SystemExit) as end:
        demo.main(['four_bar', '--output', str(tmp_path)])
    assert end.value.code == 2
    assert 'not empty' in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ['precious']


def test_both_machines_have_drives_and_every_drive_has_its_scene():
    assert shipped_drives() == ['carpet_scraper', 'three_rrr']
    assert set(shipped_drives()) <= set(scene_names())
    known = {parameter.name for parameter in TORQUE_SOURCE_PARAMETERS}
    for name in shipped_drives():
        drive = drive_for(load_scene(name))
        assert set(drive.parameters) <= known
        assert Path(drive.arguments[1]).is_file()


def test_crank_is_to_turn_at_45_rpm():
    scene = load_scene('carpet_scraper')
    aim = aim_of(drive_for(scene), scene.mechanism.actuated_joints)
    assert aim.reference.velocity.tolist() == [45 * 2 * np.pi / 60]


def test_platform_is_to_go_round_a_circle():
    scene = load_scene('three_rrr')
    simulation = Simulation(scene)
    base = [simulation.joint_names.index(name) for name in simulation.actuated_joints]
    aim = aim_of(drive_for(scene), simulation.actuated_joints)
    start, places = simulation.position, []
    for moment in np.linspace(0.0, 4.0, 81):
        position = simulation.position
        position[base] = aim.reference.at(moment, start[base])[0]
        simulation.set_state(position, hold=simulation.actuated_joints)
        places.append(simulation.point('platform_center'))
    places = np.array(places[:-1])
    radius = np.hypot(*(places - places.mean(axis=0)).T)
    # The wave is the first harmonic of what a true circle takes.
    assert radius == pytest.approx(np.full(80, 0.12), abs=0.012)


@pytest.mark.parametrize('headstart, lag', [(0.0, 0.0), (0.2, 0.0), (0.0, 0.1)])
def test_a_reference_that_began_early_is_found_and_a_lag_is_not_hidden(headstart, lag):
    scene = load_scene('three_rrr')
    aim = aim_of(drive_for(scene), scene.mechanism.actuated_joints)
    moment = np.linspace(0.0, 8.0, 801)
    position = np.zeros((801, 7))
    followed = np.maximum(moment + headstart - lag, 0.0)[:, np.newaxis]
    position[:, [0, 5, 6]] = aim.reference.at(followed, np.zeros(3))[0]
    position[0, [0, 5, 6]] = 0.0
    motion = Motion(scene.mechanism, moment, position, np.zeros((801, 7)), np.zeros((801, 7)),
                    np.zeros((801, 2, 3)))
    wanted, _, found = wanted_motion(motion, aim)
    assert found == pytest.approx(headstart, abs=1e-9)
    error = np.abs(wanted - position)[100:, [0, 5, 6]].max()
    assert error == pytest.approx(0.34 * 2 * np.pi * 0.25 * lag, rel=0.1, abs=1e-9)


@pytest.mark.parametrize('name', ['four_bar', 'slider_crank', 'hoeken_pantograph_leg'])
def test_other_scenes_get_small_sines(name):
    scene = load_scene(name)
    drive = drive_for(scene)
    assert drive.parameters['mode'] == 'sine'
    assert 0.0 < drive.parameters['amplitude'][0] < 5.0
    assert aim_of(drive, scene.mechanism.actuated_joints) is None


def test_a_scene_of_the_users_gets_no_drive_of_a_shipped_one(tmp_path):
    shipped = load_scene('three_rrr')
    path = tmp_path / 'three_rrr.yaml'
    path.write_text(shipped.path.read_text())
    assert drive_for(load_scene(path)).parameters['mode'] == 'sine'
    assert len(drive_for(load_scene(path)).parameters['amplitude']) == 3


STORE = get_typestore(Stores.ROS2_JAZZY)


def message(kind, **fields):
    return STORE.serialize_cdr(STORE.types[kind](**fields), kind)


def header(nanoseconds):
    return STORE.types['std_msgs/msg/Header'](
        stamp=STORE.types['builtin_interfaces/msg/Time'](*divmod(nanoseconds, 10 ** 9)),
        frame_id='')


def wrench(force_x, force_y, torque):
    vector = STORE.types['geometry_msgs/msg/Vector3']
    return STORE.types['geometry_msgs/msg/Wrench'](
        force=vector(x=force_x, y=force_y, z=0.0), torque=vector(x=0.0, y=0.0, z=torque))


def write_bag(path, answered=1, at_rest=0, states=5):
    """Write states of the four-bar; a command answers one, the first ones are at rest."""
    writer = BagWriter(path, 'mcap', STORE)
    kinds = {'joint_states': 'sensor_msgs/msg/JointState',
             'constraint_forces/cut_1': 'geometry_msgs/msg/WrenchStamped',
             'torque_command': 'std_msgs/msg/Float64MultiArray'}
    for topic, kind in kinds.items():
        writer.add_topic(f'/cell/{topic}', kind)
    begin = 5 * 10 ** 9
    for k in range(states):
        stamp = begin + k * 10 ** 7
        writer.write('/cell/joint_states', stamp + 10 ** 6, message(
            kinds['joint_states'], header=header(stamp), name=['a', 'b', 'c'],
            position=np.array([max(k, at_rest), 0.0, 1.0]), velocity=np.array([0.0, k, 0.0]),
            effort=np.zeros(3)))
        if k != 3:
            writer.write('/cell/constraint_forces/cut_1', stamp + 2 * 10 ** 6, message(
                kinds['constraint_forces/cut_1'], header=header(stamp),
                wrench=wrench(float(k), 10.0, 0.5)))
        if k == answered:
            layout = STORE.types['std_msgs/msg/MultiArrayLayout'](dim=[], data_offset=0)
            writer.write('/cell/torque_command', stamp + 3 * 10 ** 6, message(
                kinds['torque_command'], layout=layout, data=np.array([1.0])))
    writer.close()
    assert writer.error is None


@pytest.fixture
def bag(tmp_path):
    """Return a bag of five states, the second answered by a command."""
    write_bag(tmp_path / 'bag')
    return tmp_path / 'bag'


def test_recording_is_what_the_bag_holds(bag):
    recording = read_recording(bag, '/cell', load_scene('four_bar').mechanism)
    assert {topic: len(times) for topic, times in recording.arrivals.items()} == {
        'joint_states': 5, 'constraint_forces/cut_1': 4, 'torque_command': 1}
    assert recording.count == 10
    assert recording.rate('joint_states') == pytest.approx(100.0)
    assert np.isnan(recording.rate('torque_command'))
    # Time counts from the state that the first command answered.
    assert recording.motion.time == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert recording.motion.position[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert recording.motion.velocity[:, 1].tolist() == [1.0, 2.0, 3.0, 4.0]
    forces = recording.motion.forces[:, 0]
    assert forces[0].tolist() == [0.5, 1.0, 10.0]
    assert np.isnan(forces[2]).all() and forces[3, 1] == 4.0
    assert recording.arrivals['joint_states'][0] == pytest.approx(-0.009)


def test_motion_begins_with_itself_where_the_first_commands_were_missed(tmp_path):
    write_bag(tmp_path / 'bag', answered=18, at_rest=7, states=30)
    recording = read_recording(tmp_path / 'bag', '/cell', load_scene('four_bar').mechanism)
    assert len(recording.motion.time) == 30 - 7
    assert recording.motion.position[:2, 0].tolist() == [7.0, 8.0]


def test_a_motion_without_commands_is_taken_whole(tmp_path):
    write_bag(tmp_path / 'bag', answered=None)
    recording = read_recording(tmp_path / 'bag', '/cell', load_scene('four_bar').mechanism)
    assert len(recording.motion.time) == 5


def test_a_bag_without_states_is_refused(bag):
    with pytest.raises(ValueError, match='no joint_states'):
        read_recording(bag, '/elsewhere', load_scene('four_bar').mechanism)


def test_summary_tells_mean_speed_and_ripple(tmp_path):
    scene = load_scene('carpet_scraper')
    aim = aim_of(drive_for(scene), scene.mechanism.actuated_joints)
    speed, moment = aim.reference.velocity[0], np.linspace(0.0, 8.0, 801)
    position, velocity = np.zeros((2, 801, 7))
    # Ten ripples a second around the speed wanted.
    position[:, 0] = speed * moment - 0.1 / (20 * np.pi) * np.cos(20 * np.pi * moment)
    velocity[:, 0] = speed + 0.1 * np.sin(20 * np.pi * moment)
    motion = Motion(scene.mechanism, moment, position, velocity, np.zeros((801, 7)),
                    np.ones((801, 3, 3)))
    recording = Recording(motion, {'joint_states': moment, 'torque_command': moment[150:]})
    said = summary(recording, aim)
    assert [text.endswith(', from 1.5 s of motion on') for key, text in said if key == ''] == [
        False, True]
    text = dict(said)['tracking']
    mean, turns = re.search(r'at ([\d.]+) rad/s over (\d+) whole', text).groups()
    assert float(mean) == pytest.approx(speed, abs=1e-3)
    assert turns == '5'
    assert 'ripple 0.071 rad/s (rms), 0.095 rad/s (largest)' in text
    wanted, rate, _ = wanted_motion(motion, aim)
    assert wanted[-1, 0] == pytest.approx(position[-1, 0], abs=0.01) and rate[0, 0] == speed
    assert np.isnan(wanted[:, 1:]).all()
    for path in draw(recording, aim, scene.name, tmp_path):
        assert path.is_file()
    check_pictures(tmp_path)
