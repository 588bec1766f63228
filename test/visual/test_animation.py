# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Animations show every instant, in the format asked for, or say why not."""

import os
import signal

from closedloop_dynamics import Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.recording.recording import since_the_last_reset
from closedloop_dynamics.recording.run import columns, Report, run
from closedloop_dynamics.simulation.signals import Interrupted
from closedloop_dynamics.visual import animation as animations, pictures, trajectory as motions
from closedloop_dynamics.visual.appearance import body_colors, FORCE_COLOR, PATH_COLOR
from closedloop_dynamics.visual.drawing import mixed
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
import numpy as np
from PIL import Image
import pytest


@pytest.fixture(scope='module')
def motion():
    simulation, rows = Simulation.from_scene('three_rrr'), []
    run(simulation, 0.5, 100, {'theta_1': 5.0}, report=Report(), on_row=rows.append)
    return motions.from_rows(simulation.mechanism, columns(simulation), rows)


@pytest.fixture
def csv_file(tmp_path, capsys):
    path = tmp_path / 'run.csv'
    assert main(['simulate', 'four_bar', '--duration', '0.4', '--output', str(path)]) == 0
    capsys.readouterr()
    return path


@pytest.mark.parametrize('rate, speed, count', [
    (20.0, 1.0, 11), (20.0, 0.5, 21), (7.0, 1.0, 4), (20.0, 100.0, 1)])
def test_frames_are_evenly_spread_in_time(motion, rate, speed, count):
    times = animations.frame_times(motion, rate, speed)
    assert len(times) == count
    assert times[0] == 0.0 and times[-1] <= 0.5
    np.testing.assert_allclose(np.diff(times), speed / rate)


def test_motion_between_its_instants_is_interpolated(motion):
    shown = motions.Trajectory(motion.mechanism, *(getattr(motion, name)[::2] for name in (
        'time', 'position', 'velocity', 'effort', 'forces')))
    between = animations.between(shown, motion.time)
    np.testing.assert_array_equal(between.position[::2], motion.position[::2])
    assert np.abs(between.position - motion.position).max() < 0.01
    assert between.forces.shape == motion.forces.shape


def test_frames_differ_and_do_not_jump(motion):
    animation = animations.Animation(motion, 'test', animations.frame_times(motion, 20.0, 1.0))
    first, second, again = (animation.frame(k).astype(int) for k in (0, 5, 0))
    # What a frame draws is gone in the next one.
    np.testing.assert_array_equal(first, again)
    changed = np.any(first != second, axis=2)
    assert 0.002 < changed.mean() < 0.3
    # The title, the labels and the legend stand still.
    assert not changed[:20].any() and not changed[-40:].any()


def pixels(frame, color):
    """Return the number of pixels of a colour above the plot and the legend."""
    color = np.round(255.0 * np.array(to_rgb(color)))
    return np.sum(np.all(np.abs(frame[:-250, :, :3].astype(int) - color) <= 2.0, axis=2))


def test_bodies_forces_and_the_path_are_seen_in_their_colors(motion):
    animation = animations.Animation(motion, 'test', animations.frame_times(motion, 20.0, 1.0))
    frames = [animation.frame(k).copy() for k in range(len(animation))]
    for color in set(body_colors(motion.mechanism).values()):
        # Bars of several hundred pixels of length, seven wide; arrows and the path cover some.
        assert min(pixels(frame, mixed(color, 0.75)) for frame in frames) > 500
    # The path grows, and is above the platform.
    path = [pixels(frame, PATH_COLOR) for frame in frames]
    assert path[0] < 60 and path[-1] > path[5] > path[0] + 30
    assert max(pixels(frame, FORCE_COLOR) for frame in frames) > 50
    # As far as it has come, whatever was drawn before.
    again = [pixels(animation.frame(k), PATH_COLOR) for k in (8, 2)]
    np.testing.assert_allclose(again, [path[8], path[2]], rtol=0.05, atol=5)


def test_a_long_path_is_drawn_in_pieces(motion, monkeypatch):
    animation = animations.Animation(motion, 'test', animations.frame_times(motion, 20.0, 1.0))
    drawn = []
    before = Line2D.set_data
    monkeypatch.setattr(Line2D, 'set_data', lambda line, x, y: (
        drawn.append(len(x)), before(line, x, y)))
    total = []
    for index in range(len(animation)):
        drawn.clear()
        animation.frame(index)
        total.append(sum(drawn))
    # A frame draws what is new of the path, so that the last one takes no more than others.
    assert total[-1] < 1.5 * np.median(total)


def test_forces_that_are_not_known_are_left_out(motion):
    unknown = motions.Trajectory(motion.mechanism, motion.time, motion.position, motion.velocity,
                                 motion.effort, np.full_like(motion.forces, np.nan))
    animation = animations.Animation(unknown, 'test', np.array([0.0, 0.1]))
    assert len(animation) == 2
    assert pixels(animation.frame(1), FORCE_COLOR) == 0
    assert pixels(animation.frame(1), PATH_COLOR) > 0
    for draw in (pictures.positions, pictures.constraint_forces):
        FigureCanvasAgg(draw(unknown, 'test')).draw()


def test_gif_holds_all_frames_at_their_rate(csv_file, tmp_path, capsys):
    output = tmp_path / 'run.gif'
    arguments = ['animate', str(csv_file), '--output', str(output)]
    assert main([*arguments, '--rate', '10']) == 0
    assert '5 frames' in capsys.readouterr().out
    with Image.open(output) as picture:
        assert picture.n_frames == 5
        assert picture.info['duration'] == 100
        assert picture.info['loop'] == 0
    assert main(arguments) == 2
    assert '--overwrite' in capsys.readouterr().err


@pytest.mark.parametrize('arguments, problem', [
    (['--output', 'run.avi'], 'ends with .gif or .mp4'),
    (['--output', 'run.gif', '--scene', 'three_rrr'], 'mechanism.bodies.crank differs'),
    (['--output', 'run.gif', '--start', '9'], 'expected a part'),
    (['--output', 'run.gif', '--point', 'nose'], '--point: expected'),
    (['--output', 'run.gif', '--rate', '1e6'], 'at most 20000 frames'),
])
def test_what_cannot_be_drawn_is_said(csv_file, tmp_path, monkeypatch, capsys, arguments, problem):
    monkeypatch.chdir(tmp_path)
    assert main(['animate', str(csv_file), *arguments]) == 2
    assert problem in capsys.readouterr().err
    assert not (tmp_path / 'run.gif').exists()


def test_mp4_without_ffmpeg_is_refused_at_once(csv_file, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv('PATH', str(tmp_path))
    output = tmp_path / 'run.mp4'
    assert main(['animate', str(csv_file), '--output', str(output)]) == 2
    message = capsys.readouterr().err
    assert 'ffmpeg' in message and 'install' in message and 'run.gif' in message


@pytest.mark.parametrize('code', [0, 1])
def test_mp4_is_made_by_ffmpeg_from_whole_frames(csv_file, tmp_path, monkeypatch, capsys, code):
    # A stand-in: it keeps what it is given, and reports its exit code.
    program = tmp_path / 'ffmpeg'
    program.write_text('#!/bin/sh\necho "$@" > said\ncat > given\necho broken codec >&2\n'
                       f'for last; do :; done\ncp given "$last"\nexit {code}\n')
    program.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('PATH', f'{tmp_path}{os.pathsep}{os.environ["PATH"]}')
    arguments = ['animate', str(csv_file), '--output', 'run.mp4']
    assert main(arguments) == code
    words = (tmp_path / 'said').read_text().split()
    width, height = map(int, words[words.index('-s') + 1].split('x'))
    assert words[words.index('-framerate') + 1] == '20.0'
    assert (tmp_path / 'given').stat().st_size == 9 * width * height * 4
    assert width % 2 == height % 2 == 0
    assert (tmp_path / 'run.mp4').exists() == (code == 0)
    if code:
        assert 'broken codec' in capsys.readouterr().err


def test_forces_between_two_frames_are_in_full_view(motion, monkeypatch):
    forces = motion.forces.copy()
    forces[23, 1] = 0.0, 3e4, 4e4
    struck = motions.Trajectory(motion.mechanism, motion.time, motion.position, motion.velocity,
                                motion.effort, forces)
    limits = []
    plot = animations.Animation.plot_forces

    def watched(animation, axes, *arguments):
        plot(animation, axes, *arguments)
        limits.extend(axes.get_ylim())

    monkeypatch.setattr(animations.Animation, 'plot_forces', watched)
    animations.Animation(struck, 'test', animations.frame_times(struck, 10.0, 1.0))
    assert limits[0] <= 0.0 and limits[1] >= 5e4


@pytest.mark.parametrize('ending', ['gif', 'mp4'])
def test_an_interruption_leaves_no_file(csv_file, tmp_path, monkeypatch, capsys, ending):
    program = tmp_path / 'ffmpeg'
    program.write_text('#!/bin/sh\nfor last; do :; done\ncat > "$last"\n')
    program.chmod(0o755)
    monkeypatch.setenv('PATH', f'{tmp_path}{os.pathsep}{os.environ["PATH"]}')
    before = animations.Animation.frame

    def frame(animation, index):
        if index == 3:
            raise Interrupted(signal.SIGINT)
        return before(animation, index)

    monkeypatch.setattr(animations.Animation, 'frame', frame)
    output = tmp_path / 'out' / f'run.{ending}'
    output.parent.mkdir()
    assert main(['animate', str(csv_file), '--output', str(output)]) == 130
    assert list(output.parent.iterdir()) == []
    assert 'interrupted' in capsys.readouterr().err


def test_what_was_before_a_reset_is_left_out(motion):
    twice = motions.Trajectory(motion.mechanism, *(
        np.concatenate([values, values[:1], values])
        for values in (motion.time, motion.position, motion.velocity, motion.effort,
                       motion.forces)))
    np.testing.assert_array_equal(since_the_last_reset(twice).time, motion.time)
    np.testing.assert_array_equal(since_the_last_reset(motion).position, motion.position)


def test_plots_of_a_run_are_written(csv_file, tmp_path, capsys):
    arguments = ['plot', str(csv_file), '--output', str(tmp_path / 'out')]
    assert main(arguments) == 0
    names = [line.rpartition('/')[2] for line in capsys.readouterr().out.splitlines()]
    assert names == ['joint_motion.png', 'constraint_forces.png', 'positions.png']
    for name in names:
        with Image.open(tmp_path / 'out' / name) as picture:
            assert min(picture.size) > 200
    assert main(arguments) == 2
    assert '--overwrite' in capsys.readouterr().err
