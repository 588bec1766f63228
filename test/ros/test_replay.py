# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A bag recorded from real processes is replayed, animated, and drawn."""

from test.ros.bags import read_with_rosbags

from closedloop_dynamics.cli import main
import numpy as np
from PIL import Image
import pytest
from sensor_msgs.msg import JointState

SIMULATOR = 'closedloop_simulator'
RECORDER = 'closedloop_recorder'
SOURCE = 'closedloop_torque_source'


@pytest.mark.parametrize('integrator', [
    'auto', pytest.param('rk4', marks=pytest.mark.slow)])
def test_a_recording_that_began_late_is_met_exactly(
        processes, listener, tmp_path, capsys, integrator):
    simulator = processes.start(SIMULATOR, scene='three_rrr', integrator=integrator)
    simulator.wait_until_ready()
    source = processes.start(SOURCE, mode='sine', amplitude='[8.0]', frequency='[2.0]')
    states = listener.listen('/joint_states', JointState)
    listener.wait(lambda: states and any(states[-1].effort), 'motion under torques')
    recorder = processes.start(RECORDER, output='bag').wait_until_ready()
    for topic in ('scene', 'joint_states', 'replay_log'):
        recorder.wait_for(f'/{topic}: first message')
    count = len(states)
    listener.wait(lambda: len(states) > count + 100, '1 s of motion')
    for process in (source, simulator, recorder):
        assert process.stop() == 0
    assert main(['replay', str(tmp_path / 'bag')]) == 0
    output = capsys.readouterr().out
    assert 'the recording began later' in output
    assert 'largest deviation of a position: 0 rad or m' in output


@pytest.mark.slow
@pytest.mark.parametrize('scene', ['three_rrr_payload_friction', 'carpet_scraper_on_carpet'])
def test_a_recorded_run_is_met_exactly(processes, listener, tmp_path, capsys, scene):
    recorder = processes.start(RECORDER, output='bag').wait_until_ready()
    simulator = processes.start(SIMULATOR, scene=scene, wait_for_command='true')
    simulator.wait_until_ready()
    for topic in ('scene', 'robot_description', 'joint_states', 'replay_log'):
        recorder.wait_for(f'/{topic}: first message')
    source = processes.start(SOURCE, mode='sine', amplitude='[8.0]', frequency='[2.0]')
    recorder.wait_for('/torque_command: first message')
    bag = tmp_path / 'bag'
    states = listener.listen('/joint_states', JointState)
    listener.wait(lambda: len(states) > 150, '1.5 s of motion')
    for process in (source, simulator, recorder):
        assert process.stop() == 0
    picture = tmp_path / 'deviations.png'
    assert main(['replay', str(bag), '--tolerance', '1e-12', '--picture', str(picture)]) == 0
    output = capsys.readouterr().out
    assert f'states of {scene}' in output
    assert 'largest deviation of a position: 0 rad or m' in output
    assert 'note:' not in output
    assert picture.stat().st_size > 10_000
    moved = np.ptp([message.position for _, message in read_with_rosbags(bag)['/joint_states']],
                   axis=0)
    assert moved.max() > 0.1
    animation = tmp_path / 'run.gif'
    assert main(['animate', str(bag), '--output', str(animation), '--duration', '0.5']) == 0
    with Image.open(animation) as frames:
        # On a busy machine, states come late and are fewer.
        assert 8 <= frames.n_frames <= 11
