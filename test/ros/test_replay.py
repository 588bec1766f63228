# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A bag recorded from the nodes is replayed, animated, and drawn."""

from test.ros import test_space
from test.test_cli import done

from closedloop_dynamics.cli import main
from closedloop_dynamics.recording.recording import read_recording
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.torque_source_node import TorqueSourceNode
import numpy as np
from PIL import Image
import pytest
from sensor_msgs.msg import JointState


@pytest.mark.parametrize('integrator', ['auto', 'rk4'])
def test_a_recording_that_began_late_is_met_exactly(
        run, record, listener, tmp_path, capsys, integrator):
    run(SimulatorNode, scene='three_rrr', integrator=integrator)
    run(TorqueSourceNode, mode='sine', amplitude=[8.0], frequency=[2.0])
    states = listener.listen('/joint_states', JointState)
    listener.wait(lambda: states and any(states[-1].effort), 'motion under torques')
    recorder = record()
    recorder.wait_for('scene', 'joint_states', 'replay_log')
    count = len(states)
    listener.wait(lambda: len(states) > count + 100, '1 s of motion')
    recorder.end()
    output = done(capsys, 'replay', tmp_path / 'bag')
    assert 'the recording began later' in output
    assert 'largest deviation of a position: 0 rad or m' in output


@pytest.fixture
def recorded(run, record, listener):
    """Return a function that drives a scene by sines until a coordinate has grown by ``moved``."""
    def drive(scene, moved, topics=(), **sines):
        recorder = record()
        run(SimulatorNode, scene=str(scene), wait_for_command=True)
        recorder.wait_for('scene', 'robot_description', 'joint_states', 'replay_log', *topics)
        run(TorqueSourceNode, mode='sine', **sines)
        states = listener.listen('/joint_states', JointState)
        listener.wait(lambda: states and np.ptp(
            [message.position for message in states], axis=0).max() > moved
            and len(states) > 50, 'motion')
        recorder.end()

    return drive


@pytest.fixture
def met_exactly(capsys, tmp_path):
    """Return a function that replays the bag, asserts that all is met, and returns its motion."""
    def replayed(name):
        bag, picture = tmp_path / 'bag', tmp_path / 'deviations.png'
        output = done(capsys, 'replay', bag, '--tolerance', '1e-12', '--picture', picture)
        assert f'states of {name}' in output
        assert 'largest deviation of a position: 0 rad or m' in output
        assert 'note:' not in output
        assert picture.stat().st_size > 10_000
        return read_recording(bag).motion
    return replayed


@pytest.mark.parametrize('scene', ['three_rrr_payload_friction', 'carpet_scraper_on_carpet'])
def test_a_recorded_run_is_met_exactly_and_animated(recorded, tmp_path, met_exactly, scene):
    recorded(scene, 0.15, amplitude=[8.0], frequency=[2.0])
    assert np.ptp(met_exactly(scene).position, axis=0).max() > 0.1
    animation = tmp_path / 'run.gif'
    assert main(['animate', str(tmp_path / 'bag'), '--output', str(animation),
                 '--duration', '0.2']) == 0
    with Image.open(animation) as frames:
        # On a busy machine, states come late and are fewer.
        assert 2 <= frames.n_frames <= 5


def test_a_recorded_run_in_space_is_met_exactly_and_drawn(recorded, tmp_path, met_exactly):
    recorded(test_space.file_of(test_space.made('bricard'), tmp_path), 0.2,
             amplitude=[2.0], frequency=[2.0])
    motion = met_exactly('bricard')
    assert np.ptp(motion.position, axis=0).max() > 0.1
    assert motion.forces.shape[1:] == (1, 6)
    assert np.nanmin(np.abs(motion.forces).max(axis=0)) > 0.0
    pictures = tmp_path / 'pictures'
    assert main(['plot', str(tmp_path / 'bag'), '--output', str(pictures)]) == 0
    assert len(list(pictures.glob('*.png'))) == 3


def test_a_recorded_run_with_orientations_is_met_exactly(recorded, tmp_path, met_exactly):
    recorded(test_space.file_of(test_space.made('floater'), tmp_path), 0.05,
             topics=['multi_dof_joint_states'], amplitude=[0.2, 0.1, 0.1, 0.2, 0.1],
             frequency=[2.0, 1.0, 2.0, 1.0, 2.0])
    motion = met_exactly('floater')
    assert motion.position.shape[1] == 13 and motion.velocity.shape[1] == 11
    # The recorder may hear one topic a state before the other, and misses none after that.
    missed = np.isnan(np.hstack([motion.position, motion.velocity])).any(axis=1)
    first = np.argmin(missed)
    assert first <= 2 and not missed[first:].any()
    motion = motion.part(slice(first, None))
    np.testing.assert_allclose(
        np.linalg.norm(motion.position[:, 3:7], axis=1), 1.0, rtol=0.0, atol=1e-15)
    assert np.ptp(motion.position, axis=0).min() > 1e-6
