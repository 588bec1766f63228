# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A page that was saved has the motion in it, and nothing from elsewhere."""

import base64
import json
import re
from test.view.rows import places_of

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.kinematics.modeling import extent
from closedloop_dynamics.mechanism.config import shipped_path
from closedloop_dynamics.mechanism.kinematics import body_poses, poses_in_space
from closedloop_dynamics.recording.recording import read_recording
from closedloop_dynamics.view.columns import motion_columns, motion_rows
from closedloop_dynamics.view.page import live_page
from closedloop_dynamics.view.saved import recorded
from closedloop_dynamics.view.thinning import OF_RANGE, OF_SIZE
from closedloop_dynamics.visual.trajectory import Trajectory
import numpy as np


def contents(path):
    """Return description, times and rows of a saved page."""
    text = path.read_text(encoding='utf-8')
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>',
                                text, re.DOTALL)[1])
    times, rows = (np.frombuffer(base64.b64decode(data[key]), dtype=kind)
                   for key, kind in (('times', '<f8'), ('rows', '<f4')))
    return data['scene'], times, rows.reshape(len(times), -1)


def test_a_simulated_motion_is_saved_as_it_was_computed(tmp_path, capsys):
    page, table = tmp_path / 'run.html', tmp_path / 'run.csv'
    arguments = ['--duration', '10', '--torque', 'theta_1=3']
    assert main(['view', 'three_rrr', *arguments, '--rate', '60', '--save', str(page)]) == 0
    assert 'MB' in capsys.readouterr().out
    assert main(['simulate', 'three_rrr', *arguments, '--rate', '60', '--no-error-estimate',
                 '--output', str(table)]) == 0
    assert page.stat().st_size < 3_000_000
    scene, times, rows = contents(page)
    motion = read_recording(table, load_scene('three_rrr')).motion
    # Between the rows asked for are those that paths and plots need.
    assert len(times) > 1.5 * len(motion.time) and np.diff(times).min() > 0.0
    at_rate = np.isin(times, motion.time)
    times, rows = times[at_rate], rows[at_rate]
    np.testing.assert_array_equal(times, motion.time)
    poses = rows[:, :scene['columns']['forces']].reshape(len(times), -1, 7)
    np.testing.assert_array_equal(poses, poses_in_space(
        body_poses(motion.mechanism, motion.position)).astype(np.float32))
    forces = rows[:, scene['columns']['forces']:scene['columns']['loads']]
    np.testing.assert_allclose(
        forces.reshape(len(times), -1, 3)[..., :2], motion.forces[..., 1:], rtol=1e-6)
    plots = {(plot['group'], plot['name']): rows[:, scene['columns']['plots'] + k]
             for k, plot in enumerate(scene['plots'])}
    np.testing.assert_array_equal(
        plots['joint velocity', 'theta_1'], motion.velocity[:, 0].astype(np.float32))
    assert np.isfinite(plots['energy', 'kinetic']).all()
    assert main(['view', 'three_rrr', '--save', str(page)]) == 2
    # A recording is saved with the same motion, without what it does not tell.
    assert main(['view', str(table), '--save', str(page),
                 '--overwrite']) == 0
    scene, again, recorded = contents(page)
    np.testing.assert_array_equal(again, times)
    np.testing.assert_array_equal(recorded, motion_rows(motion))
    np.testing.assert_array_equal(recorded[:, :scene['columns']['forces']], rows[
        :, :scene['columns']['forces']])


def test_a_page_with_few_rows_has_exact_curves_and_all_peaks(tmp_path, capsys):
    path, name, rate, duration = tmp_path / 'run.html', 'four_bar', 10, 10
    assert main(['view', name, '--duration', str(duration), '--rate', str(rate),
                 '--save', str(path)]) == 0
    scene, times, rows = contents(path)
    simulation, every, forces = Simulation.from_scene(name), [], []
    for _ in range(round(duration / simulation.step_size)):
        simulation.step()
        every.append(simulation.points[0])
        forces.append(np.linalg.norm(simulation.constraint_forces[0, 1:]))
    point, = scene['points']
    place = places_of(point, rows)
    column = scene['files'].index('cut_force.cut_1 [N]')

    def missed(chosen):
        """Return how far the states are from the lines between rows [m, N]."""
        point, force = (np.transpose([np.interp(
            np.arange(1, len(every) + 1) * simulation.step_size, times[chosen], each)
            for each in values[chosen].T]) for values in (place[:, :2], rows[:, [column]]))
        return np.abs(point - every).max(), np.abs(force[:, 0] - forces).max()

    size, peak = extent(simulation.mechanism), max(forces)
    away, lost = missed(np.isin(times, np.arange(duration * rate + 1) / rate))
    assert away > 0.1 * size and lost > 0.1 * peak
    away, lost = missed(np.ones(len(times), dtype=bool))
    assert away < 3.0 * OF_SIZE * size and lost < 3.0 * OF_RANGE * peak
    assert len(times) < 0.3 * len(every)


def test_of_many_rows_those_are_shown_that_lines_would_miss():
    scene, count = load_scene('four_bar'), 20_000
    mechanism = scene.mechanism
    time = np.arange(count) / 1000.0
    position = np.tile(scene.initial.position, (count, 1))
    forces = np.zeros((count, 1, 3))
    # A force that is large in one row, and one that is so in another, smaller.
    forces[7001, 0, 1], forces[15_003, 0, 2] = 50.0, -20.0
    motion = Trajectory(mechanism, time, position, 0.0 * position, 0.0 * position, forces)
    times, rows = recorded(motion, 2000)
    assert len(times) <= 2000 and (times[0], times[-1]) == (time[0], time[-1])
    column = motion_columns(mechanism).layout['files'].index('cut_force.cut_1 [N]')
    np.testing.assert_allclose(np.interp(time, times, rows[:, column]),
                               np.linalg.norm(forces[:, 0, 1:], axis=1), atol=0.1)


def test_a_page_needs_nothing_from_elsewhere():
    text = live_page('</title><script>evil()</script>')
    assert 'evil()</script>' not in text.replace('&lt;script>evil()&lt;/script>', '')
    assert not re.search(r'(src|href)\s*=\s*["\'](?!data:|\$)', text)
    assert not re.search(r'https?://(?!www\.w3\.org)', text)
    assert '/*' not in re.sub(r'<style>.*?</style>', '', text, flags=re.DOTALL)


def test_what_cannot_be_shown_is_said(capsys, tmp_path):
    for arguments, problem in (
            ([], 'expected a scene or a recording'),
            (['no_such_scene'], 'no_such_scene'),
            (['run.csv'], 'add --scene'),
            (['run.csv', '--torque', 'theta_1=1'], '--torque: expected a scene'),
            (['four_bar', '--speed', 'crank=1'], 'crank_joint'),
            (['four_bar', '--motion', 'crank_joint=2*'], 'expected an expression'),
            (['four_bar', '--torque', 'crank_joint=1', '--motion', 'crank_joint=t'], 'one way'),
            (['four_bar', '--controller', str(shipped_path('scenes', 'four_bar'))],
             'closedloop_torque_source')):
        assert main(['view', *arguments]) == 2
        assert problem in capsys.readouterr().err
