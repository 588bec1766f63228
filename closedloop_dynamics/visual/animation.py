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

from contextlib import contextmanager
import math
import subprocess

from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from PIL import Image

from .appearance import PATH_COLOR
from .drawing import all_places, MechanismArtist
from .motion import body_poses, magnitudes, Motion, named_point
from .pictures import COLORS
from .views import perspective, PLANE

FRAME_DOTS_PER_INCH = 100
# Length of path between two of its points that are drawn, as a share of the picture's extent.
TRAIL = 0.003
# A GIF counts the time of a frame in hundredths of a second.
GIF_TICKS = 100
COLORS_OF_A_GIF = 64


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


class _Moving(Figure):
    """A figure that draws what moves over a picture of what stands still."""

    def __init__(self, background, **options):
        super().__init__(**options)
        self._background, self.artists_in_order = background, []

    def draw(self, renderer):
        """Put the picture behind, and draw on it."""
        renderer.restore_region(self._background)
        for artist in self.artists_in_order:
            artist.draw(renderer)


class Animation:
    """
    Draws the frames of a motion.

    What stands still is drawn once, into a picture that lies behind all frames; a frame is what
    moves alone. A mechanism in space is seen in perspective.

    Parameters
    ----------
    motion : Motion
        Its times rise; forces may be NaN where none are known.
    title : str
        Title of the figure.
    times : ndarray
        Of the frames [s].
    point : str, optional
        Whose path is drawn; the mechanism's first named point when not given.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
        Shows the frame that was drawn last.

    """

    def __init__(self, motion, title, times, point=None):
        mechanism = motion.mechanism
        self._shown = between(motion, times)
        self._poses = body_poses(mechanism, self._shown.position)
        if point is None and mechanism.points:
            point = mechanism.points[0].name
        self._times, self._path = motion.time, None
        view = PLANE if mechanism.planar else perspective(all_places(mechanism, self._poses))
        if point is not None:
            self._path, self._places = (
                view.project(named_point(mechanism, poses, point))
                for poses in (body_poses(mechanism, motion.position), self._poses))
        forces = magnitudes(motion.forces)
        known = np.isfinite(forces).any()
        # Of all that was recorded, not of the instants that frames happen to show.
        self._largest = float(np.nanmax(forces)) if known else 0.0
        still = Figure(figsize=(8.0, 8.0), layout='constrained', dpi=FRAME_DOTS_PER_INCH)
        above, below = still.subplots(2, 1, height_ratios=[4, 1])
        artist = MechanismArtist(above, mechanism, self._poses, view)
        artist.ground()
        (left, right), (low, high) = above.get_xlim(), above.get_ylim()
        above.set(xlim=(left, right), ylim=(low, high), autoscale_on=False)
        height = np.clip(6.5 * (high - low) / (right - left), 2.0, 7.0)
        # An even number of pixels, as video wants.
        still.set_size_inches(8.0, round(2.6 + height, 1))
        self._plot_forces(below, motion, forces)
        still.suptitle(title, fontweight='bold', x=0.02, ha='left')
        still.legend(
            handles=artist.legend_handles(
                point, f'force on body A, longest {self._largest:.3g} N' if known else None),
            loc='outside lower center', ncols=4, fontsize=8, frameon=False)
        canvas = FigureCanvasAgg(still)
        canvas.draw()
        self.figure = _Moving(canvas.copy_from_bbox(still.bbox), figsize=still.get_size_inches(),
                              dpi=FRAME_DOTS_PER_INCH)
        self._canvas = FigureCanvasAgg(self.figure)
        axes, cursor = (self.figure.add_axes(
            each.get_position(), xlim=each.get_xlim(), ylim=each.get_ylim(), autoscale_on=False)
            for each in (above, below))
        self._prepare(MechanismArtist(axes, mechanism, self._poses, view))
        self._clock = axes.text(
            0.99, 0.98, '', transform=axes.transAxes, ha='right', va='top', family='monospace',
            parse_math=False)
        self._cursor = cursor.axvline(motion.time[0], color='0.3', linewidth=1.0)
        self.figure.artists_in_order = [*axes.lines, *axes.patches, *axes.texts, self._cursor]
        self._sort()

    def __len__(self):
        """Return the number of frames."""
        return len(self._shown.time)

    def show(self, index):
        """
        Put a frame into the figure.

        Parameters
        ----------
        index : int
            From 0.

        """
        time = self._shown.time[index]
        for part, places, layers in self._parts:
            part.place(places[index])
            if layers is not None:
                part.artist.set_zorder(layers[index])
        if not self._artist.mechanism.planar:
            self._sort()
        if self._path is not None:
            past = self._path[:np.searchsorted(self._times, time)]
            self._trail.set_data(*np.vstack([past, self._places[index]]).T)
            self._mark.set_data(*self._places[index:index + 1].T)
        forces = self._shown.forces[index]
        shown = bool(self._largest and np.isfinite(forces).all())
        ends = self._artist.arrow_ends(index, np.nan_to_num(forces), self._largest)
        for arrow, (start, end) in zip(self._arrows, ends):
            arrow.xyann, arrow.xy = start, end
            arrow.set_visible(shown)
        self._clock.set_text(f't = {time:7.3f} s')
        self._cursor.set_xdata([time, time])

    def frame(self, index):
        """
        Draw a frame.

        Parameters
        ----------
        index : int
            From 0.

        Returns
        -------
        ndarray of uint8, shape (height, width, 4)
            Red, green, blue, opacity; overwritten by the next one.

        """
        self.show(index)
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())

    def _prepare(self, artist):
        """Make all that moves, as in the first frame."""
        self._artist = artist
        limits = artist.axes.get_xlim(), artist.axes.get_ylim()
        self._parts = [
            (part, artist.places(part), None if part.layer is None else artist.layers(part))
            for part in artist.bodies(0)]
        if self._path is not None:
            # A point for each pixel or two of the path is enough.
            steps = np.hypot(*np.diff(self._path, axis=0).T)
            passed = np.concatenate([[0.0], np.cumsum(steps)]) // (TRAIL * artist.extent)
            kept = np.unique(passed, return_index=True)[1]
            self._path, self._times = self._path[kept], self._times[kept]
            self._trail, = artist.axes.plot([], [], color=PATH_COLOR, linewidth=1.6, zorder=31)
            self._mark = artist.mark(self._places[0])
        self._arrows = artist.forces(0, np.nan_to_num(self._shown.forces[0]), self._largest)
        artist.axes.set(xlim=limits[0], ylim=limits[1], autoscale_on=False)

    def _sort(self):
        """Let artists of higher layers be drawn over those of lower ones."""
        self.figure.artists_in_order.sort(key=lambda each: each.get_zorder())

    def _plot_forces(self, axes, motion, magnitudes):
        for k, cut in enumerate(motion.mechanism.cut_joints):
            axes.plot(motion.time, magnitudes[:, k], linewidth=1.2,
                      color=COLORS[k % len(COLORS)], label=cut.name)
        axes.set(xlabel='time [s]', ylabel='force [N]')
        axes.set_xlim(motion.time[0], max(motion.time[-1], motion.time[0] + 1e-3))
        if self._largest:
            axes.set_ylim(0.0, 1.05 * self._largest)
            axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
        axes.grid(color='0.92')
        axes.spines[['top', 'right']].set_visible(False)


def require_writable(path):
    """
    Refuse at once a file that could not be written.

    Raises
    ------
    AnimationError

    """
    if path.suffix.lower() not in ('.gif', '.mp4'):
        raise AnimationError(f'{path}: expected a name that ends in .gif or .mp4')
    if path.suffix.lower() == '.mp4' and not FFMpegWriter.isAvailable():
        raise AnimationError(
            f'{path}: the program ffmpeg makes MP4 files, and it is not installed; install it '
            f'(sudo apt install ffmpeg), or write {path.with_suffix(".gif").name}')


def write(animation, path, rate, progress=lambda done: None):
    """
    Write an animation into a file.

    Parameters
    ----------
    animation : Animation
        What is written.
    path : pathlib.Path
        ``.gif`` or ``.mp4``; replaced, if it exists, when all is written. What ends the writing
        before leaves nothing.
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
    with _replaced(path) as unfinished:
        (_write_gif if path.suffix.lower() == '.gif' else _write_mp4)(
            animation, unfinished, rate, progress)


@contextmanager
def _replaced(path):
    """Yield the path of a new file; rename it to the one given when the block has ended well."""
    unfinished = path.with_name(f'.{path.stem}.unfinished{path.suffix}')
    try:
        yield unfinished
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def _write_gif(animation, path, rate, progress):
    # Matplotlib's own writer keeps all frames in memory and chooses colours for each anew: they
    # would flicker, and a long run would not fit.
    # The last frame has all that is drawn, the whole path among it.
    sample = Image.fromarray(animation.frame(len(animation) - 1)).convert('RGB')
    palette = sample.quantize(COLORS_OF_A_GIF, Image.Quantize.MAXCOVERAGE)

    def frames():
        for index in range(len(animation)):
            picture = Image.fromarray(animation.frame(index)).convert('RGB')
            yield picture.quantize(palette=palette, dither=Image.Dither.NONE)
            progress(index + 1)

    pictures = frames()
    tick = 1000 / GIF_TICKS
    duration = max(2, round(1000 / rate / tick)) * tick
    next(pictures).save(path, save_all=True, append_images=pictures, duration=duration, loop=0,
                        optimize=False)


def _write_mp4(animation, path, rate, progress):
    writer = FFMpegWriter(fps=rate, codec='h264')
    try:
        with writer.saving(animation.figure, str(path), FRAME_DOTS_PER_INCH):
            for index in range(len(animation)):
                animation.show(index)
                writer.grab_frame()
                progress(index + 1)
    except BrokenPipeError:
        raise AnimationError('ffmpeg ended before the last frame') from None
    except subprocess.CalledProcessError as error:
        # Ctrl-C ends ffmpeg, too.
        if isinstance(error.__context__, KeyboardInterrupt):
            raise error.__context__ from None
        raise AnimationError(f'ffmpeg failed: {error.stderr.strip()}') from None
