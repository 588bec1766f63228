# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of a CSV file are of the machine that was simulated, or are refused."""

from argparse import Namespace
import csv
from dataclasses import replace
import json

from closedloop_dynamics import load_scene, MechanismError, scene_names
from closedloop_dynamics.cli import main
from closedloop_dynamics.cli.command import recording_of, UsageError
from closedloop_dynamics.recording import recording as recordings
from closedloop_dynamics.recording.errors import RecordingError
from closedloop_dynamics.recording.kinematics import Drive, DrivenRun
from closedloop_dynamics.recording.quantities import by_name
from closedloop_dynamics.recording.recording import read_recording, Recording
from closedloop_dynamics.recording.rows import read_rows, scene_path
from closedloop_dynamics.scene.key_paths import changed, resolve
import numpy as np
import pytest

from ..reference import cases
from ..reference.loop_closure import closure

LENGTH = 'mechanism.joints.rocker_joint.position.0'


@pytest.fixture(scope='module')
def rows(tmp_path_factory):
    """Return the rows of a four-bar with another rocker, and the scene with it."""
    path = tmp_path_factory.mktemp('rows') / 'run.csv'
    assert main(['simulate', 'four_bar', '--set', f'{LENGTH}=0.45', '--motion',
                 'crank_joint=1.0472+t', '--duration', '0.1', '--rate', '50',
                 '--no-error-estimate', '--output', str(path)]) == 0
    scene = load_scene('four_bar')
    return path, changed(scene, {resolve(scene, LENGTH): 0.45})


def test_overrides_of_the_command_line_are_drawn(rows, tmp_path):
    path, scene = rows
    recording = read_recording(path)
    assert recording.scene.mechanism == replace(
        scene.mechanism, description=recording.scene.mechanism.description)
    assert 'motion_crank_joint' in recording.scene.effects
    assert closure(recording.motion.mechanism, recording.motion.position).max() < 1e-12
    # Five centimetres open, had the scene's own length been drawn.
    assert closure(load_scene('four_bar').mechanism, recording.motion.position).min() > 0.04
    assert main(['plot', str(path), '--output', str(tmp_path)]) == 0


def test_columns_with_units_are_read_in_single_precision(rows, tmp_path):
    path, scene = rows
    known = read_recording(path).motion
    with open(path, newline='', encoding='utf-8') as file:
        names, *table = csv.reader(file)
    values = np.array(table, dtype=float)
    # As after a thousand turns, which leaves few digits of where in the turn it is.
    crank = names.index('position.crank_joint')
    values[:, crank] += 2000.0 * np.pi
    marked = tmp_path / 'page.csv'
    with open(marked, 'w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow([f'{name} [unit]' for name in names])
        writer.writerows([values[k, 0], *np.float32(values[k, 1:]).tolist()]
                         for k in range(len(values)))
    motion = read_recording(marked, scene).motion
    assert np.abs(motion.position[:, 1:] - known.position[:, 1:]).max() < 1e-6
    with pytest.raises(RecordingError, match='another'):
        read_recording(marked, load_scene('four_bar'))


def test_forces_that_are_not_unique_are_marked_and_read(tmp_path):
    path, whole = tmp_path / 'bennett.csv', tmp_path / 'four_bar.csv'
    for name, file in (('bennett', path), ('four_bar', whole)):
        assert main(['simulate', name, '--duration', '0.02', '--rate', '50', '--forces', 'all',
                     '--no-error-estimate', '--output', str(file)]) == 0
    with open(path, encoding='utf-8') as file:
        names = next(csv.reader(file))
    scene = load_scene('bennett')
    # A turn about joint 1's axis, z of the world, is all that a moment there would hinder.
    assert 'force.joint_1.torque_x.least' in names and 'force.joint_1.torque_z' in names
    assert not any(name.startswith(('position', 'point', 'closure')) for name in names
                   if name.endswith('.least'))
    assert 'least' not in whole.read_text()
    motion, _ = read_rows(path)
    cut, = scene.mechanism.cut_joints
    assert motion.forces.shape == (2, 1, 6) and np.abs(motion.forces).max() > 0.1
    start = scene.initial.position[0]
    table = DrivenRun(scene, {'joint_1': Drive(start, start + 0.1)}, 2, 1.0).table()
    assert f'force.{cut.name}.x.least' in table[0] and f'force.{cut.name}.x' in by_name(table)


@pytest.mark.parametrize('beside', [True, False])
def test_rows_of_another_machine_are_refused(rows, tmp_path, beside):
    path, scene = rows
    copy = tmp_path / 'copy.csv'
    copy.write_bytes(path.read_bytes())
    if beside:
        scene_path(copy).write_bytes(scene_path(path).read_bytes())
    with pytest.raises(RecordingError, match='rocker_joint.position differs' if beside
                       else 'the closure error differs by 0.05 m'):
        read_rows(copy, load_scene('four_bar'))
    for name in ('three_rrr', 'slider_crank'):
        with pytest.raises(RecordingError, match='differs' if beside else 'expected the columns'):
            read_rows(copy, load_scene(name))
    point, = scene.mechanism.points
    for points, key in (((), point.name), ((point, replace(point, name='more')), 'more')):
        with pytest.raises(RecordingError, match=f'mechanism.points.{key} differs' if beside
                           else r'point\.'):
            read_rows(copy, replace(scene, mechanism=replace(scene.mechanism, points=points)))
    # The same machine may be named.
    motion, _ = read_rows(copy, scene)
    assert len(motion.time) == 6
    if not beside:
        with pytest.raises(RecordingError, match='add --scene'):
            read_rows(copy)
        cuts = tuple(replace(cut, name='other') for cut in scene.mechanism.cut_joints)
        with pytest.raises(RecordingError, match='force.other.x is missing'):
            read_rows(copy, replace(scene, mechanism=replace(scene.mechanism, cut_joints=cuts)))


def test_a_scene_that_is_not_of_these_rows_is_refused(rows, tmp_path):
    path, _ = rows
    copy = tmp_path / 'copy.csv'
    copy.write_bytes(path.read_bytes())
    scene_path(copy).write_text(scene_path(path).read_text().replace('0.45', '0.46'))
    with pytest.raises(RecordingError, match='those of another one: at t = 0 s'):
        read_rows(copy)


@pytest.mark.slow
@pytest.mark.parametrize('name', cases.only(cases.CLASSES, scene_names()))
def test_rows_of_shipped_scenes_are_of_their_machine(tmp_path, name):
    path = tmp_path / 'run.csv'
    assert main(['simulate', name, '--duration', '0.02', '--no-error-estimate', '--forces', 'all',
                 '--output', str(path)]) == 0
    motion, _ = read_rows(path)
    read_rows(path, load_scene(name))
    scene_path(path).unlink()
    assert len(read_rows(path, load_scene(name))[0].time) == len(motion.time) == 3


def test_a_bag_is_drawn_as_its_own_machine_and_replayed_by_any(rows, monkeypatch):
    _, scene = rows
    recording = Recording(motion=None, scene=scene, changes=[(scene, {})])
    monkeypatch.setattr(recordings, 'read_recording', lambda *arguments: recording)
    given = Namespace(scene='four_bar', namespace=None, set=[])
    assert recording_of(given, 'bag', other_machine=True) is recording
    with pytest.raises(UsageError, match='rocker_joint.position differs; leave --scene out'):
        recording_of(given, 'bag')


@pytest.mark.parametrize('count', [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_damaged_rows_and_scenes_are_refused_in_words(rows, tmp_path, count):
    path, _ = rows
    rng, copy = np.random.default_rng(27), tmp_path / 'copy.csv'
    with open(path, newline='') as file:
        table = list(csv.reader(file))
    reported, refused = json.loads(scene_path(path).read_text()), 0
    for k in range(count):
        damaged, scene = [list(row) for row in table], json.dumps(reported)
        row, column = (int(rng.integers(size)) for size in (len(table), len(table[0])))
        if k % 3 == 0:
            damaged[row][column] = str(rng.choice(['', 'x', '1e9', 'nan', 'force.x.y']))
        elif k % 3 == 1:
            del damaged[row][column]
        else:
            place = int(rng.integers(len(scene)))
            scene = scene[:place] + str(rng.choice(['', '0', '"', '}'])) + scene[place + 1:]
        with open(copy, 'w', newline='') as file:
            csv.writer(file).writerows(damaged)
        scene_path(copy).write_text(scene)
        try:
            read_recording(copy)
        except (RecordingError, MechanismError, OSError) as error:
            refused += 1
            assert str(error)
        except ValueError as error:
            # Of the scene beside it.
            refused += 1
            assert type(error).__name__ == 'SceneError'
    assert refused > count / 3
