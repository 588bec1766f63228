# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A motion as a moving picture: the mechanism with its forces, and these over time."""

from contextlib import contextmanager
import math
import shutil
import subprocess

import numpy as np

from .appearance import COLORS
from .drawing import all_places, ARROW, MechanismArtist
from .gif import Gif
from .trajectory import magnitudes, Trajectory
from .views import perspective, PLANE
from ..mechanism.extras import of_an_extra
from ..mechanism.kinematics import body_poses, named_point

with of_an_extra():
    from matplotlib.artist import Artist
    from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyArrowPatch

FRAME_DOTS_PER_INCH = 100
# More would take long, and fill a disk.
MOST_FRAMES = 20_000
CURSOR_COLOR = '0.3'
# Length of path between two of its points that are drawn, as a share of the picture's extent.
TRAIL = 0.003


class AnimationError(OSError):
    """An animation that cannot be written; the message has the remedy."""


def frame_times(motion, rate, speed):
    """
    Return the times of the motion that the frames show [s], at least one.

    ``rate`` is in frames per second of the animation [Hz], ``speed`` in seconds of motion per
    second. AnimationError for more than ``MOST_FRAMES``.
    """
    first, last = motion.time[0], motion.time[-1]
    count = math.floor((last - first) * rate / speed + 1e-9) + 1
    if count > MOST_FRAMES:
        raise AnimationError(f'expected at most {MOST_FRAMES} frames, got {count}')
    return first + np.arange(count) * speed / rate


def between(motion, times):
    """Return a motion at other times, by linear interpolation."""
    def at(values):
        flat = values.reshape(len(values), -1)
        columns = [np.interp(times, motion.time, column) for column in flat.T]
        return np.array(columns).T.reshape(len(times), *values.shape[1:])

    return Trajectory(motion.mechanism, times, *(
        at(values) for values in (motion.position, motion.velocity, motion.effort,
                                  motion.forces)))


class _Trail(Artist):
    """
    The path of a point as far as it has come.

    Every piece of it is drawn once, into a picture of its own that is laid over the frames: a
    frame costs the same however long the path is.
    """

    def __init__(self, line, path, reached, places):
        """
        Adopt a line that has the style.

        ``path``: shape (m, 2), in the coordinates of the line; of each frame ``reached``, the
        number of the last point of the path, and ``places``, shape (n, 2), where the point is.
        """
        super().__init__()
        self._line, self._path, self._reached, self._places = line, path, reached, places
        self.set_zorder(line.get_zorder())
        self._index, self._drawn = 0, 0
        width, height = line.figure.canvas.get_width_height()
        self._layer = RendererAgg(width, height, line.figure.dpi)

    def show(self, index):
        """Choose the frame that is drawn next."""
        if index < self._index:
            self._layer.clear()
            self._drawn = 0
        self._index = index

    def draw(self, renderer):
        reached = self._reached[self._index]
        if reached > self._drawn:
            self._line.set_data(*self._path[self._drawn:reached + 1].T)
            self._line.draw(self._layer)
            self._drawn = reached
        # Images have their lowest row first.
        renderer.draw_image(renderer.new_gc(), 0, 0,
                            np.asarray(self._layer.buffer_rgba())[::-1])
        self._line.set_data(*np.array([self._path[reached], self._places[self._index]]).T)
        self._line.draw(renderer)


class Animation:
    """
    Draws the frames of a motion at some times [s], as ``picture``, uint8 (height, width, 4).

    What stands still is drawn once; what moves is drawn over it. A mechanism in space is seen in
    perspective. Times of the motion rise; forces may be NaN where none are known. The path of a
    named point is drawn, by default the mechanism's first one.
    """

    def __init__(self, motion, title, times, point=None):
        mechanism = motion.mechanism
        shown = between(motion, times)
        self._frame_times = times
        poses = body_poses(mechanism, shown.position)
        if point is None and mechanism.points:
            point = mechanism.points[0].name
        view = PLANE if mechanism.planar else perspective(all_places(mechanism, poses))
        forces = magnitudes(motion.forces)
        known = np.isfinite(forces).any()
        # The largest force of the whole recording, not of the instants that frames show.
        largest = float(np.nanmax(forces)) if known else 0.0
        figure = Figure(figsize=(8.0, 8.0), layout='constrained', dpi=FRAME_DOTS_PER_INCH)
        above, below = figure.subplots(2, 1, height_ratios=[4, 1])
        artist = MechanismArtist(above, mechanism, poses, view)
        artist.ground()
        (left, right), (low, high) = above.get_xlim(), above.get_ylim()
        above.set(xlim=(left, right), ylim=(low, high), autoscale_on=False)
        height = np.clip(6.5 * (high - low) / (right - left), 2.0, 7.0)
        # An even number of pixels, as video wants.
        figure.set_size_inches(8.0, round(2.6 + height, 1))
        self.plot_forces(below, motion, forces, largest)
        figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
        figure.legend(
            handles=artist.legend_handles(
                point, f'force on body A, longest {largest:.3g} N' if known else None),
            loc='outside lower center', ncols=3, fontsize=8, frameon=False)
        self._canvas = FigureCanvasAgg(figure)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(figure.bbox)
        self.picture = np.asarray(self._canvas.buffer_rgba())
        # Artists that move; and functions that update them, with their data in each frame.
        self._moving, self._changes = [], []
        self._add_bodies(artist)
        if point is not None:
            self._add_path(artist, motion, point)
        self._add_arrows(artist, shown.forces, largest)
        clock = above.text(0.99, 0.98, '', transform=above.transAxes, ha='right', va='top',
                           family='monospace', fontsize=10)
        self._add(clock, clock.set_text, [f't = {time:7.3f} s' for time in times])
        cursor = below.axvline(times[0], color=CURSOR_COLOR, linewidth=1.0)
        self._add(cursor, cursor.set_xdata, np.column_stack([times, times]))

    def __len__(self):
        return len(self._frame_times)

    def frame(self, index):
        """Draw a frame, counted from 0, and return it: ``picture``, overwritten by the next."""
        self._canvas.restore_region(self._still)
        for change, values in self._changes:
            change(values[index])
        renderer = self._canvas.get_renderer()
        for artist in sorted(self._moving, key=Artist.get_zorder):
            artist.draw(renderer)
        return self.picture

    def _add(self, artist, change, values):
        self._moving.append(artist)
        self._changes.append((change, values))

    def _add_bodies(self, artist):
        for part in artist.bodies(0):
            self._add(part.artist, part.place, artist.places(part))
            if part.layer is not None:
                self._changes.append((part.artist.set_zorder, artist.layers(part)))

    def _add_path(self, artist, motion, point):
        def seen(poses):
            return artist.view.project(named_point(motion.mechanism, poses, point))

        places, path = seen(artist.poses), seen(body_poses(motion.mechanism, motion.position))
        # A point for each pixel or two of the path is enough.
        steps = np.hypot(*np.diff(path, axis=0).T)
        passed = np.concatenate([[0.0], np.cumsum(steps)]) // (TRAIL * artist.extent)
        kept = np.unique(passed, return_index=True)[1]
        reached = np.searchsorted(motion.time[kept], self._frame_times, 'right') - 1
        line = artist.trace(path[:0])
        # A point of the ground may lie outside of the moving parts.
        line.set_clip_on(False)
        trail = _Trail(line, path[kept], np.maximum(reached, 0), places)
        self._add(trail, trail.show, range(len(self)))
        mark = artist.mark(places[0])
        mark.set_clip_on(False)
        self._add(mark, lambda place: mark.set_data(*place[:, np.newaxis]), places)

    def _add_arrows(self, artist, forces, largest):
        pixels = artist.axes.transData.transform
        for start, end in artist.arrow_ends(slice(None), np.moveaxis(forces, 1, 0), largest):
            arrow = FancyArrowPatch((0.0, 0.0), (0.0, 0.0), clip_on=False, **ARROW)
            artist.axes.add_patch(arrow)
            ends = np.stack([start, end], axis=1)
            self._add(arrow, lambda both, arrow=arrow: arrow.set_positions(*both), ends)
            length = np.linalg.norm(pixels(end) - pixels(start), axis=1)
            # None of a force that is not known, or so small that the joint hides it.
            self._changes.append(
                (arrow.set_visible, length > ARROW['shrinkA'] * FRAME_DOTS_PER_INCH / 72.0))

    def plot_forces(self, axes, motion, magnitudes, largest):
        for k, cut in enumerate(motion.mechanism.cut_joints):
            axes.plot(motion.time, magnitudes[:, k], linewidth=1.2,
                      color=COLORS[k % len(COLORS)], label=cut.name)
        axes.set(xlabel='time [s]', ylabel='force [N]')
        axes.set_xlim(motion.time[0], max(motion.time[-1], motion.time[0] + 1e-3))
        if largest:
            axes.set_ylim(0.0, 1.05 * largest)
            axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
        axes.grid(color='0.92')
        axes.spines[['top', 'right']].set_visible(False)


def require_writable(path):
    """Raise AnimationError at once for a file that could not be written."""
    if path.suffix.lower() not in ('.gif', '.mp4'):
        raise AnimationError(f'expected a name that ends with .gif or .mp4, got {path}')
    if path.suffix.lower() == '.mp4' and shutil.which('ffmpeg') is None:
        raise AnimationError(
            f'{path}: the program ffmpeg makes MP4 files, and it is not installed; install it '
            f'(sudo apt install ffmpeg), or write {path.with_suffix(".gif").name}')


def write(animation, path, rate, progress=lambda done: None):
    """
    Write an animation into a ``.gif`` or ``.mp4`` file, which is replaced when all is written.

    What ends the writing before leaves nothing. ``rate`` is in frames per second [Hz];
    ``progress`` is called with the number of frames done. Raises OSError where writing fails.
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
    last = len(animation) - 1
    with open(path, 'wb') as file:
        # What may hide something in one of them is elsewhere in another.
        gif = Gif(file, np.concatenate(
            [animation.frame(index).copy() for index in (0, last // 2, last)]), rate)
        for index in range(len(animation)):
            gif.add(animation.frame(index))
            progress(index + 1)
        gif.close()


class _Frames(Figure):
    """A replacement of a matplotlib figure whose picture is already drawn."""

    def __init__(self, picture):
        height, width, _ = picture.shape
        super().__init__(figsize=(width / FRAME_DOTS_PER_INCH, height / FRAME_DOTS_PER_INCH),
                         dpi=FRAME_DOTS_PER_INCH)
        FigureCanvasAgg(self)
        self._picture = picture

    def savefig(self, file, **options):
        """Write the picture."""
        file.write(self._picture.tobytes())


def _write_mp4(animation, path, rate, progress):
    # Only here, as it takes a tenth of a second.
    from matplotlib.animation import FFMpegWriter
    writer = FFMpegWriter(fps=rate, codec='h264')
    try:
        with writer.saving(_Frames(animation.picture), str(path), FRAME_DOTS_PER_INCH):
            for index in range(len(animation)):
                animation.frame(index)
                writer.grab_frame()
                progress(index + 1)
    except BrokenPipeError:
        raise AnimationError('ffmpeg ended before the last frame') from None
    except subprocess.CalledProcessError as error:
        # Ctrl-C ends ffmpeg, too.
        if isinstance(error.__context__, KeyboardInterrupt):
            raise error.__context__ from None
        raise AnimationError(f'ffmpeg failed: {error.stderr.strip()}') from None
