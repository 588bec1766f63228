# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forces along a recorded motion: those of the simulation that was recorded."""

from pathlib import Path
from test.ros.bags import read_with_rosbags

from closedloop_dynamics.cli import main
from closedloop_dynamics.recording.forces import ForceBag, smooth
from closedloop_dynamics.recording.message_numbers import constraint_force
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
import pytest


def recorded(path, scene, torque, count=200, period=0.002):
    """Write a bag of a simulated motion; return the constraint forces."""
    # Errors of positions count a millionfold in accelerations.
    simulation, forces = Simulation.from_scene(scene, accuracy=1e-10), []
    with ForceBag(path, simulation) as bag:
        for k in range(count):
            simulation.step(torque, period)
            forces.append(simulation.constraint_forces)
            bag.write(round(1e9 * (k + 1) * period))
    return np.array(forces)


@pytest.mark.parametrize('scene, joints, torque', [
    ('four_bar', 'crank_joint', [0.5]),
    pytest.param('three_rrr_horizontal', None, [1.0, -2.0, 0.5], marks=pytest.mark.slow),
    ('bennett', None, [0.3])])
def test_torques_and_forces_are_those_that_acted(tmp_path, capsys, scene, joints, torque):
    forces = recorded(tmp_path / 'motion', scene, torque, period=0.001)
    code = main(['forces', str(tmp_path / 'motion'), '--scene', scene, '--output',
                 str(tmp_path / 'forces'), *(['--joints', joints] if joints else [])])
    out = capsys.readouterr()
    assert code == 0, out.err
    found = read_with_rosbags(tmp_path / 'forces')
    simulation = Simulation.from_scene(scene)
    driven = [simulation.joint_names.index(name) for name in simulation.actuated_joints]
    # At its ends a spline is worse.
    for _, message in found['/joint_states'][20:-20]:
        np.testing.assert_allclose(np.array(message.effort)[driven], torque, atol=1e-5)
    for k, cut in enumerate(simulation.mechanism.cut_joints):
        messages = found[f'/constraint_forces/{cut.name}']
        met = np.array([constraint_force(message.wrench, simulation.mechanism.planar)
                        for _, message in messages])
        scale = np.abs(forces[:, k]).max()
        assert np.abs(met - forces[:, k])[20:-20].max() < 1e-5 * scale
    assert f'{simulation.mechanism.cut_joints[0].name}: force of at most' in out.out
    acted = read_with_rosbags(tmp_path / 'motion')
    for name in simulation.joint_names:
        for (stamp, met), (other, expected) in list(zip(
                found[f'/joint_forces/{name}'], acted[f'/joint_forces/{name}']))[20:-20]:
            assert stamp == other
            np.testing.assert_allclose(
                constraint_force(met.wrench, simulation.mechanism.planar),
                constraint_force(expected.wrench, simulation.mechanism.planar),
                atol=1e-5 * np.abs(forces).max())


def test_a_table_has_the_forces_of_all_joints(tmp_path):
    recorded(tmp_path / 'motion', 'four_bar', [0.5], count=30)
    arguments = ['forces', str(tmp_path / 'motion'), '--scene', 'four_bar', '--output',
                 str(tmp_path / 'forces.csv')]
    assert main(arguments) == 0
    names, *rows = (tmp_path / 'forces.csv').read_text().splitlines()
    assert 'force.crank_joint.x' in names and len(rows) == 30
    numbers = np.array([row.split(',') for row in rows], dtype=float)
    np.testing.assert_allclose(numbers[:, 0], 0.002 * np.arange(30), atol=1e-12)
    assert main(arguments) == 2
    assert main([*arguments, '--overwrite']) == 0


def test_damage_and_messages_out_of_order_are_reported(tmp_path, capsys):
    bag = tmp_path / 'motion'
    recorded(bag, 'four_bar', [0.5], count=200)
    file, = bag.glob('*.mcap')
    data = bytearray(file.read_bytes())
    data[len(data) // 4] ^= 0xFF
    file.write_bytes(data)
    assert main(['forces', str(bag), '--scene', 'four_bar', '--output',
                 str(tmp_path / 'forces.csv')]) == 2
    assert 'a record is cut off or damaged' in capsys.readouterr().err
    simulation = Simulation.from_scene('four_bar')
    with ForceBag(tmp_path / 'repeated', simulation) as copy:
        for stamp in [*range(10), 5, 6]:
            copy.write(1_000_000 * stamp)
    assert main(['forces', str(tmp_path / 'repeated'), '--scene', 'four_bar', '--output',
                 str(tmp_path / 'forces.csv')]) == 0
    assert '/joint_states: 2 messages are not used' in capsys.readouterr().err


def test_noise_is_smoothed_as_its_deviation_allows():
    times = np.linspace(0.0, 2.0, 1000)
    exact = np.array([np.sin(3.0 * times), -9.0 * np.sin(3.0 * times)])
    noisy = exact[0] + 1e-4 * np.random.default_rng(4).normal(size=len(times))
    rough, fine = (smooth(times, noisy[:, np.newaxis], deviation)[2, 50:-50, 0] - exact[1, 50:-50]
                   for deviation in (0.0, 1e-4))
    assert np.abs(fine).max() < 0.5 and np.abs(rough).max() > 30.0


@pytest.mark.parametrize('options, code, problem', [
    (['--joints', 'rocker_joint,crank_joint,elbow'], 2, 'expected positions of'),
    (['--topic', '/other'], 2, 'expected more than 5 measurements, got 0'),
    (['--deviation', '-1'], 2, 'a finite number >= 0'),
    (['--set', 'mechanism.joints.crank_joint.position=1'], 2, '--set')])
def test_what_cannot_be_is_said(tmp_path, capsys, options, code, problem):
    recorded(tmp_path / 'motion', 'four_bar', [0.5], count=10)
    try:
        found = main(['forces', str(tmp_path / 'motion'), '--scene', 'four_bar', '--output',
                      str(tmp_path / 'forces'), *options])
    except SystemExit as error:
        found = error.code
    assert found == code and problem in capsys.readouterr().err
    assert not Path(tmp_path / 'forces').exists()


def test_a_motion_through_a_singular_position_is_refused(tmp_path, capsys):
    # Falls through positions in which its drives would not hold it.
    recorded(tmp_path / 'motion', 'three_rrr', [0.0, 0.0, 0.0], count=300, period=0.004)
    assert main(['forces', str(tmp_path / 'motion'), '--scene', 'three_rrr', '--output',
                 str(tmp_path / 'forces')]) == 1
    assert 's of the recording: ' in capsys.readouterr().err


def test_what_is_no_bag_is_refused(tmp_path, capsys):
    (tmp_path / 'run.csv').write_text('time,theta_1\n0,0\n')
    assert main(['forces', str(tmp_path / 'run.csv'), '--scene', 'three_rrr', '--output',
                 str(tmp_path / 'forces')]) == 2
    assert 'run.csv: expected a rosbag2 bag' in capsys.readouterr().err
