# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters from recordings: CSV files, and what bags hold."""

from dataclasses import replace
from pathlib import Path
from test.recording.test_replay import Recorder

from closedloop_dynamics import identify, load_scene
from closedloop_dynamics.cli import main
from closedloop_dynamics.recording.measurements import between_states, read_measurements
from closedloop_dynamics.recording.recording import RecordingError
from closedloop_dynamics.scene.key_paths import changed, resolve
import numpy as np
import pytest

COUPLER = 'mechanism.bodies.coupler.mass'
ROCKER = 'mechanism.bodies.rocker.inertia'


def identify_command(*arguments):
    """Return the exit code of the command."""
    try:
        return main(['identify', *map(str, arguments)])
    except SystemExit as end:
        return end.code


@pytest.fixture(scope='module')
def rows(tmp_path_factory):
    """Return the CSV file of a run."""
    path = tmp_path_factory.mktemp('run') / 'run.csv'
    assert main(['simulate', 'four_bar', '--duration', '1', '--torque', 'crank_joint=0.5',
                 '--output', str(path)]) == 0
    return path


def numbers_in(out):
    """Return values and standard deviations by key."""
    lines = [line.split() for line in out.splitlines() if line.startswith('mechanism.')]
    return {key: (float(value), float(deviation)) for key, value, deviation, *_ in lines}


def test_numbers_of_a_run_come_back(rows, capsys, tmp_path):
    picture = tmp_path / 'left.png'
    arguments = [rows, 'four_bar', '--set', f'{COUPLER}=3', '--set', f'{ROCKER}=1', '--vary',
                 COUPLER, ROCKER, '--picture', picture]
    assert identify_command(*arguments) == 0
    out = capsys.readouterr().out
    found = numbers_in(out)
    assert found[COUPLER][0] == 1.0 and found[ROCKER][0] == 0.0041666667
    assert out.count(' identified') == 2 and '101 of 101 instants of four_bar' in out
    assert picture.stat().st_size > 10_000
    assert identify_command(*arguments) == 2
    assert '--picture' in capsys.readouterr().err


def test_what_cannot_be_known_is_named_without_a_number(rows, capsys):
    assert identify_command(rows, 'four_bar', '--vary', 'mechanism.bodies') == 0
    out = capsys.readouterr().out
    assert not numbers_in(out)
    assert 'not known alone: mechanism.bodies.crank.mass, ' in out
    assert 'without influence on this motion: crank.mass, rocker.mass' in out
    assert 'rocker.first_moment.x + 0.714286*coupler.first_moment.x = 0.225, ' in out


def test_positions_and_efforts_alone_do_with_splines(tmp_path, capsys):
    path = tmp_path / 'driven.csv'
    assert main(['simulate', 'four_bar', '--duration', '1', '--motion',
                 'crank_joint=1.0472+0.8*sin(8*t)', '--output', str(path)]) == 0
    names, *lines = path.read_text().splitlines()
    table = np.array([line.split(',') for line in lines], dtype=float)
    column = dict(zip(names.split(','), table.T))
    random = np.random.default_rng(5)
    noisy = column['position.crank_joint'] + 1e-6 * random.normal(size=len(table))
    bare = tmp_path / 'robot.csv'
    bare.write_text('time,position.crank_joint,effort.crank_joint\n' + '\n'.join(
        f'{t!r},{q!r},{tau!r}' for t, q, tau in zip(
            column['time'].tolist(), noisy.tolist(), column['effort.crank_joint'].tolist())))
    arguments = [bare, 'four_bar', '--set', f'{COUPLER}=3', '--vary', COUPLER]
    assert identify_command(*arguments) == 2
    assert 'velocity.crank_joint is missing; with --deviation' in capsys.readouterr().err
    assert identify_command(*arguments, '--deviation', '1e-6') == 0
    assert numbers_in(capsys.readouterr().out)[COUPLER][0] == pytest.approx(1.0, rel=0.01)


def recorded(scene, ticks=120):
    """Return what a bag holds of a run under commands that change at any time."""
    recorder, random = Recorder(scene), np.random.default_rng(8)
    count = len(recorder.simulation.actuated_joints)
    for _ in range(ticks):
        # A command in the middle of a period, another one at its end.
        recorder.advance(4, random.normal(size=count), False)
        recorder.advance(6, random.normal(size=count))
    return recorder


def test_a_bag_has_efforts_that_acted_between_its_states():
    scene = load_scene('three_rrr_horizontal')
    recorder = recorded(scene)
    recorder.simulation.reset()
    recorder.jumps += 1
    torque = np.array([1.0, 2.0, 3.0])
    recorder.advance(10, torque)
    recorder.advance(10, torque)
    recording = recorder.recording(without=(20,))
    driven = scene.mechanism.actuated_joints
    time, values, effort = between_states('bag', recording, scene, driven)
    # The last two states are of another run; of one interval half the commands are missing.
    states = len(recording.motion.time)
    assert len(time) == states - 1 - 2
    log = np.array([row[4][[0, 5, 6]] for row in recorder.rows])
    for place, name in enumerate(driven):
        assert effort[name][0] == pytest.approx(
            0.4 * log[1, place] + 0.6 * log[2, place], rel=1e-12)
        assert effort[name][-1] == pytest.approx(torque[place], rel=1e-12)
    # The state half way, to the fourth power of the time between.
    middle = values['position']['theta_1'][1]
    ends = recording.motion.position[1:3, 0]
    assert min(ends) < middle < max(ends)


@pytest.mark.parametrize('name, key, truth', [
    ('three_rrr_horizontal', 'mechanism.bodies.platform.mass', 8.0),
    ('four_bar', COUPLER, 1.0), ('bennett', 'mechanism.bodies.rocker.mass', None)])
def test_masses_come_out_of_a_bag(name, key, truth, monkeypatch):
    scene = load_scene(name)
    recording = recorded(scene).recording()
    monkeypatch.setattr('closedloop_dynamics.recording.measurements.read_recording',
                        lambda *_: recording)
    joints = scene.mechanism.actuated_joints
    measured = read_measurements('bag', scene, joints, joints)
    path = resolve(scene, key)
    if truth is None:
        truth = next(body for body in scene.mechanism.bodies if body.name == path[2]).mass
    found = identify(changed(scene, {path: 2.0 * truth}), [key], measured.motion, measured.effort,
                     measured.others)
    one = found.estimates[key]
    # What commands at other times than those of the states leave is like noise.
    assert one.value == pytest.approx(truth, rel=0.02) and one.identified
    assert abs(one.value - truth) < 4.0 * one.deviation


def test_drives_and_gaps_are_seen():
    scene = load_scene('four_bar')
    recording = recorded(scene, 3).recording()
    joints = scene.mechanism.actuated_joints
    _, _, effort = between_states('bag', replace(recording, log=None), scene, joints)
    np.testing.assert_allclose(effort['crank_joint'], 0.5 * (
        recording.motion.effort[1:, 0] + recording.motion.effort[:-1, 0]))
    still = replace(recording, log=None, motion=recording.motion.part([1]))
    with pytest.raises(RecordingError, match='expected states one after the other'):
        between_states('bag', still, scene, joints)


@pytest.mark.parametrize('change, problem', [
    (lambda text: text.replace('effort.crank_joint', 'torque'), 'effort.crank_joint is missing'),
    (lambda text: text.splitlines()[0], 'expected rows, got none'),
    (lambda text: '\n'.join([*text.splitlines()[:5], *text.splitlines()[2:]]),
     'a time that increases'),
    (lambda text: text.replace('0.5,', 'nan,', 1), 'expected finite numbers')])
def test_rows_that_cannot_be_are_refused(rows, tmp_path, capsys, change, problem):
    (tmp_path / 'run.csv').write_text(change(Path(rows).read_text()))
    assert identify_command(tmp_path / 'run.csv', 'four_bar', '--vary', COUPLER) == 2
    assert problem in capsys.readouterr().err


@pytest.mark.parametrize('arguments, problem', [
    (['four_bar', '--vary', COUPLER], 'expected a recording to identify from, or --excite'),
    (['none.csv', 'four_bar', '--vary', COUPLER, '--excite', '2'], 'or --excite, which needs'),
    (['none.csv', 'four_bar'], '--vary'),
    (['none.csv', 'four_bar', '--vary', COUPLER], 'none.csv'),
    (['RUN', 'four_bar', '--vary', 'mechanism.bodies.x.mass'], "got 'x'"),
    (['RUN', 'four_bar', '--vary', COUPLER, '--joints', 'elbow'], 'elbow: expected a joint'),
    (['RUN', 'four_bar', '--vary', COUPLER, '--deviation', '-1'], 'a finite number >= 0'),
    (['RUN', 'four_bar', '--vary', COUPLER, '--harmonics', '1'], 'a whole number from 2 to 20')])
def test_command_lines_that_cannot_be_are_refused(rows, capsys, arguments, problem):
    assert identify_command(*[rows if each == 'RUN' else each for each in arguments]) == 2
    assert problem in capsys.readouterr().err
