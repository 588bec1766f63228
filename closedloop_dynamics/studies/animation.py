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

"""A motion as a moving picture: the mechanism with its forces, and these over time."""

import math
import shutil
import subprocess

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from PIL import Image

from .drawing import MechanismArtist
from .motion import body_poses, Motion, named_point
from .pictures import COLORS
from ..appearance import PATH_COLOR

DOTS_PER_INCH = 100
FFMPEG = 'ffmpeg'
# A GIF counts the time of a frame in hundredths of a second.
GIF_TICKS = 100
COLORS_OF_A_GIF = 128


class AnimationError(OSError):
    """An animation that cannot be written; the message says what to do."""


def frame_times(motion, rate, speed):
    """
    Return the times of the motion that the frames show.

    Parameters
    ----------
    motion : Motion
        What is shown, from its first to its last instant.
    rate : float
        Frames per second of the animation [Hz].
    speed : float
        Seconds of motion per second of the animation.

    Returns
    -------
    ndarray
        [s], at least one.

    """
    first, last = motion.time[0], motion.time[-1]
    count = math.floor((last - first) * rate / speed + 1e-9) + 1
    return first + np.arange(count) * speed / rate


def between(motion, times):
    """Return a motion at other times, linearly between the instants that are known."""
    def at(values):
        flat = values.reshape(len(values), -1)
        columns = [np.interp(times, motion.time, column) for column in flat.T]
        return np.array(columns).T.reshape(len(times), *values.shape[1:])

    return Motion(motion.mechanism, times, *(
        at(values) for values in (motion.position, motion.velocity, motion.effort,
                                  motion.forces)))


class Animation:
    """
    Draws the frames of a motion.

    Parameters
    ----------
    motion : Motion
        Its times rise; forces may be NaN where none are known.
    title : str
        Above it.
    times : ndarray
        Of the frames [s].
    point : str, optional
        Whose path is drawn; the mechanism's first named point when not given.

    Attributes
    ----------
    figure : matplotlib.figure.Figure

    """

    def __init__(self, motion, title, times, point=None):
        mechanism = motion.mechanism
        self._shown = between(motion, times)
        self._poses = body_poses(mechanism, self._shown.position)
        if point is None and mechanism.points:
            point = mechanism.points[0].name
        self.figure = Figure(figsize=(8.0, 8.0), layout='constrained', dpi=DOTS_PER_INCH)
        self._canvas = FigureCanvasAgg(self.figure)
        magnitudes = np.hypot(motion.forces[..., 1], motion.forces[..., 2])
        known = np.isfinite(magnitudes).any()
        # One outlier, a blow at a stop, must not make all other arrows invisible.
        self._largest = float(np.nanpercentile(magnitudes, 99.0)) if known else 0.0
        above, below = self.figure.subplots(2, 1, height_ratios=[4, 1])
        self._artist = MechanismArtist(above, mechanism, self._poses)
        self._artist.ground()
        self._times, self._path = motion.time, None
        if point is not None:
            self._path = named_point(mechanism, body_poses(mechanism, motion.position), point)
            self._places = named_point(mechanism, self._poses, point)
        (left, right), (low, high) = above.get_xlim(), above.get_ylim()
        above.set(xlim=(left, right), ylim=(low, high), autoscale_on=False)
        height = np.clip(6.5 * (high - low) / (right - left), 2.0, 7.0)
        self.figure.set_size_inches(8.0, round(2.6 + height, 2))
        self._plot_forces(below, motion, magnitudes)
        self.figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
        self.figure.legend(
            handles=self._artist.legend_handles(point, self._largest or None),
            loc='outside lower center', ncols=4, fontsize=8, frameon=False)
        self._clock = above.text(
            0.99, 0.98, '', transform=above.transAxes, ha='right', va='top', family='monospace')
        self._canvas.draw()
        # The layout is found once: it must not move from frame to frame.
        self.figure.set_layout_engine('none')

    def __len__(self):
        """Return the number of frames."""
        return len(self._shown.time)

    def frame(self, index):
        """
        Draw a frame.

        Parameters
        ----------
        index : int
            From 0.

        Returns
        -------
        PIL.Image.Image
            RGB.

        """
        axes, time = self._artist.axes, self._shown.time[index]
        before = set(axes.get_children())
        self._artist.bodies(index)
        if self._path is not None:
            past = self._path[:np.searchsorted(self._times, time)]
            axes.plot(*np.vstack([past, self._places[index]]).T, color=PATH_COLOR, linewidth=1.6,
                      zorder=31)
            self._artist.mark(self._places[index])
        forces = self._shown.forces[index]
        if self._largest and np.isfinite(forces).all():
            self._artist.forces(index, forces, self._largest)
        self._clock.set_text(f't = {time:7.3f} s')
        self._cursor.set_xdata([time, time])
        self._canvas.draw()
        for artist in set(axes.get_children()) - before:
            artist.remove()
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert('RGB')

    def _plot_forces(self, axes, motion, magnitudes):
        for k, cut in enumerate(motion.mechanism.cut_joints):
            axes.plot(motion.time, magnitudes[:, k], linewidth=1.2,
                      color=COLORS[k % len(COLORS)], label=cut.name)
        self._cursor = axes.axvline(motion.time[0], color='0.3', linewidth=1.0)
        axes.set(xlabel='time [s]', ylabel='force [N]')
        axes.set_xlim(motion.time[0], max(motion.time[-1], motion.time[0] + 1e-3))
        if self._largest:
            axes.set_ylim(0.0, 1.15 * self._largest)
            axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
        axes.grid(color='0.92')
        axes.spines[['top', 'right']].set_visible(False)


def require_writable(path):
    """
    Refuse at once a file that could not be written.

    Parameters
    ----------
    path : pathlib.Path
        Its ending chooses the format.

    Raises
    ------
    AnimationError

    """
    if path.suffix.lower() not in ('.gif', '.mp4'):
        raise AnimationError(f'{path}: expected a name that ends in .gif or .mp4')
    if path.suffix.lower() == '.mp4' and shutil.which(FFMPEG) is None:
        raise AnimationError(
            f'{path}: the program {FFMPEG} makes MP4 files, and it is not installed; install it '
            f'(sudo apt install {FFMPEG}), or write {path.with_suffix(".gif").name}')


def write(animation, path, rate, progress=lambda done: None):
    """
    Write an animation into a file.

    Parameters
    ----------
    animation : Animation
        What is written.
    path : pathlib.Path
        ``.gif`` or ``.mp4``; replaced if it exists.
    rate : float
        Frames per second [Hz].
    progress : callable
        Told how many frames are done.

    Raises
    ------
    OSError
        Where it cannot be written.

    """
    require_writable(path)

    def frames():
        for index in range(len(animation)):
            yield animation.frame(index)
            progress(index + 1)

    (_write_gif if path.suffix.lower() == '.gif' else _write_mp4)(frames(), path, rate)


def _write_gif(frames, path, rate):
    first = next(frames)
    # One palette for all: colours must not flicker.
    palette = first.quantize(COLORS_OF_A_GIF, dither=Image.Dither.NONE)

    def reduced(frame):
        return frame.quantize(palette=palette, dither=Image.Dither.NONE)

    tick = 1000 / GIF_TICKS
    duration = max(2, round(1000 / rate / tick)) * tick
    reduced(first).save(path, save_all=True, append_images=map(reduced, frames),
                        duration=duration, loop=0, optimize=False)


def _write_mp4(frames, path, rate):
    first = next(frames)
    width, height = first.size
    command = [
        FFMPEG, '-y', '-loglevel', 'error', '-f', 'rawvideo', '-pix_fmt', 'rgb24',
        '-s', f'{width}x{height}', '-r', f'{rate:g}', '-i', '-', '-vf',
        # Video wants even numbers.
        'pad=ceil(iw/2)*2:ceil(ih/2)*2', '-pix_fmt', 'yuv420p', str(path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        process.stdin.write(first.tobytes())
        for frame in frames:
            process.stdin.write(frame.tobytes())
    except BrokenPipeError:
        # What it says is told below.
        pass
    finally:
        _, errors = process.communicate()
    if process.returncode:
        raise AnimationError(f'{path}: {FFMPEG} failed: {errors.decode(errors="replace").strip()}')
