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
import shutil
import subprocess

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, FontProperties
from matplotlib.patches import Polygon
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .appearance import FORCE_COLOR, PATH_COLOR
from .drawing import all_places, AXIS_DASHES, MechanismArtist
from .gif import Gif
from .motion import body_poses, magnitudes, Motion, named_point
from .pictures import COLORS
from .raster import (
    BEFORE, begin, canvas, DOTS, draw, draw_trail, hulls, lengthen, LINE, line, POLYGON, Shapes,
    TILES, write_text)
from .views import perspective, PLANE

FRAME_DOTS_PER_INCH = 100
# Pixels of a point of 1/72 inch, in which widths of lines are given.
POINT = FRAME_DOTS_PER_INCH / 72.0
# Half the width of the path, and half the diagonal of the mark at its end [pixels].
TRAIL_HALF, MARK = 0.8 * POINT, 3.5 * POINT
# Room at the foot of an arrow, and its head [pixels].
ARROW_GAP, ARROW_HEAD = 4.0 * POINT, 4.8 * POINT
# The time, and the line that shows it in the plot.
CHARACTERS, CLOCK_SIZE, CURSOR_COLOR = ' 0123456789.-ts=', 10.0 * POINT, (77, 77, 77)
# A layer above all bodies.
TOP = 1e9
# Length of path between two of its points that are drawn, as a share of the picture's extent.
TRAIL = 0.003


class AnimationError(OSError):
    """An animation that cannot be written; the message says what to do."""


def frame_times(motion, rate, speed):
    """
    Return the times of the motion that the frames show [s], at least one.

    ``rate`` is in frames per second of the animation [Hz], ``speed`` in seconds of motion per
    second.

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


class _Pixels:
    """Places in coordinates of matplotlib as pixels of a picture of some height."""

    def __init__(self, height, transform):
        self._height, self._transform = height, transform

    def __call__(self, places):
        """Return pixels of places of shape (..., 2), y down."""
        flat = self._transform.transform(np.reshape(places, (-1, 2))).reshape(places.shape)
        return np.stack([flat[..., 0], self._height - flat[..., 1]], axis=-1)


class _Found:
    """Shapes that are found one by one."""

    def __init__(self):
        self._rows, self._vertices, self._layers = [], [], []

    def add(self, kind, vertices, fill='white', edge='white', half=0.0, radius=0.0,
            dashes=(0.0, 0.0, 0.0, 0.0), layer=0.0):
        """Add one with its vertices in every frame, shape (frames, n, 2) [pixels]."""
        self._rows.append((kind, _of(fill), _of(edge), half, radius, dashes))
        self._vertices.append(vertices)
        self._layers.append(layer)

    def add_artist(self, artist, vertices, layers):
        """Add what matplotlib would draw as an artist."""
        layer = artist.get_zorder() if layers is None else layers
        if isinstance(artist, Polygon):
            self.add(POLYGON, vertices, artist.get_facecolor(), artist.get_edgecolor(),
                     0.5 * POINT * artist.get_linewidth(), layer=layer)
            return
        if artist.get_linestyle() != 'None':
            width = POINT * artist.get_linewidth()
            dashed = artist.get_linestyle() == '--'
            self.add(LINE, vertices, edge=artist.get_color(), half=0.5 * width, layer=layer,
                     dashes=[width * part for part in AXIS_DASHES[1]] if dashed else 4 * [0.0])
        if artist.get_marker() not in ('None', None, ''):
            size = 0.5 * POINT * artist.get_markersize()
            style = {'fill': artist.get_markerfacecolor(), 'edge': artist.get_markeredgecolor(),
                     'half': 0.5 * POINT * artist.get_markeredgewidth(), 'layer': layer}
            if artist.get_marker() == 's':
                corners = size * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
                for k in range(vertices.shape[1]):
                    self.add(POLYGON, vertices[:, k:k + 1] + corners, **style)
            else:
                self.add(DOTS, vertices, radius=size, **style)

    def arrays(self, frames):
        """Return them as Shapes, with vertices (frames, n, 2) and layers (frames, shapes)."""
        kinds, fills, edges, halves, radii, dashes = zip(*self._rows)
        counts = [vertices.shape[1] for vertices in self._vertices]
        shapes = Shapes(
            np.array(kinds), np.concatenate([[0], np.cumsum(counts)]), np.array(fills),
            np.array(edges), np.array(halves, dtype=float), np.array(radii, dtype=float),
            np.array(dashes, dtype=float))
        layers = np.stack([np.broadcast_to(layer, frames) for layer in self._layers], axis=1)
        return shapes, np.ascontiguousarray(np.concatenate(self._vertices, axis=1)), layers


def _of(color):
    """Return a colour as three whole numbers from 0 to 255."""
    return np.array([round(255.0 * part) for part in to_rgb(color)])


def _hulls_of(places):
    """Return the corners of the convex hulls of places, both of shape (frames, n, 2)."""
    corners = np.empty_like(places)
    hulls(places.copy(), corners, np.zeros(2 * places.shape[1], dtype=np.int64))
    return corners


def _arrow(start, end):
    """Return shaft (frames, 2, 2) and head (frames, 3, 2) of arrows from start to end [pixels]."""
    along = end - start
    length = np.linalg.norm(along, axis=1, keepdims=True)
    with np.errstate(invalid='ignore', divide='ignore'):
        along = np.where(length > ARROW_GAP, along / length, np.nan)
    aside = along[:, ::-1] * (-1.0, 1.0)
    tip = end - 0.9 * POINT * along
    neck = tip - ARROW_HEAD * along
    shaft = np.stack([start + ARROW_GAP * along, neck], axis=1)
    return shaft, np.stack([tip, neck + 0.5 * ARROW_HEAD * aside, neck - 0.5 * ARROW_HEAD * aside],
                           axis=1)


class Animation:
    """
    Draws the frames of a motion.

    What stands still is drawn once, by matplotlib; what moves is drawn over it (``raster``). A
    mechanism in space is seen in perspective.

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
    canvas : raster.Canvas
        Has the frame that was drawn last.

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
        # Of all that was recorded, not of the instants that frames happen to show.
        largest = float(np.nanmax(forces)) if known else 0.0
        still = Figure(figsize=(8.0, 8.0), layout='constrained', dpi=FRAME_DOTS_PER_INCH)
        above, below = still.subplots(2, 1, height_ratios=[4, 1])
        artist = MechanismArtist(above, mechanism, poses, view)
        artist.ground()
        (left, right), (low, high) = above.get_xlim(), above.get_ylim()
        above.set(xlim=(left, right), ylim=(low, high), autoscale_on=False)
        height = np.clip(6.5 * (high - low) / (right - left), 2.0, 7.0)
        # An even number of pixels, as video wants.
        still.set_size_inches(8.0, round(2.6 + height, 1))
        self._plot_forces(below, motion, forces, largest)
        still.suptitle(title, fontweight='bold', x=0.02, ha='left')
        still.legend(
            handles=artist.legend_handles(
                point, f'force on body A, longest {largest:.3g} N' if known else None),
            loc='outside lower center', ncols=4, fontsize=8, frameon=False)
        drawn = FigureCanvasAgg(still)
        drawn.draw()
        self.canvas = canvas(np.asarray(drawn.buffer_rgba()))
        self._pixels = _Pixels(self.canvas.still.shape[0], above.transData)
        self._prepare(artist, shown, largest, point and view.project(
            named_point(mechanism, poses, point)))
        self._prepare_path(motion, artist, point and view.project(named_point(
            mechanism, body_poses(mechanism, motion.position), point)))
        self._prepare_clock(above, below)

    def __len__(self):
        """Return the number of frames."""
        return len(self._frame_times)

    def show(self, index):
        """Draw a frame, counted from 0."""
        begin(self.canvas)
        draw(self.canvas, self._shapes, self._vertices[index], self._orders[index])
        if len(self._path):
            self._show_trail(index)
        draw(self.canvas, self._shapes, self._vertices[index], self._topmost)
        write_text(self.canvas, self._glyphs, self._codes[index], *self._clock_place)
        x, (top, bottom) = self._cursor_places[index], self._cursor_ends
        line(self.canvas, x, top, x, bottom, 0.5 * POINT, *CURSOR_COLOR)

    def frame(self, index):
        """
        Draw a frame and return it, uint8, shape (height, width, 4).

        It is red, green, blue and opacity, overwritten by the next one.

        """
        self.show(index)
        return self.canvas.picture

    def _show_trail(self, index):
        """Let the path of the point go on to where it is."""
        if index < self._trailed:
            self.canvas.trail[:] = 0
            self.canvas.tiles[BEFORE] = (1 << TILES) - 1
            self.canvas.picture[:] = self.canvas.still
            self._trailed, self._passed = -1, 0
            draw(self.canvas, self._shapes, self._vertices[index], self._orders[index])
        stop = int(np.searchsorted(self._path_times, self._frame_times[index], 'right')) - 1
        stop = max(stop, 0)
        lengthen(self.canvas, self._path, self._passed, stop, TRAIL_HALF)
        self._trailed, self._passed = index, stop
        draw_trail(self.canvas, _of(PATH_COLOR))
        x, y = self._path[stop]
        line(self.canvas, x, y, *self._places[index], TRAIL_HALF, *_of(PATH_COLOR))

    def _prepare(self, artist, shown, largest, places):
        """Find what moves: its shapes, and where their corners are in every frame."""
        parts = artist.bodies(0)
        found = _Found()
        for part in parts:
            seen = artist.places(part)
            if part.solid:
                seen = _hulls_of(seen)
            found.add_artist(part.artist, self._pixels(seen), None if part.layer is None
                             else artist.layers(part))
            part.artist.remove()
        self._places = None
        if places is not None:
            self._places = self._pixels(places)
            corners = MARK * np.array([(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)])
            found.add(POLYGON, self._places[:, None] + corners, fill=PATH_COLOR, edge='white',
                      half=0.4 * POINT, layer=TOP)
        forces = np.moveaxis(shown.forces, 1, 0)
        unknown = ~np.isfinite(shown.forces).all(axis=(1, 2)) | (largest <= 0.0)
        for start, end in artist.arrow_ends(slice(None), np.nan_to_num(forces), largest):
            start, end = (self._pixels(np.where(unknown[:, None], np.nan, each))
                          for each in (start, end))
            shaft, head = _arrow(start, end)
            found.add(LINE, shaft, edge=FORCE_COLOR, half=0.9 * POINT, layer=TOP)
            found.add(POLYGON, head, fill=FORCE_COLOR, edge=FORCE_COLOR, half=0.9 * POINT,
                      layer=TOP)
        self._shapes, self._vertices, layers = found.arrays(len(shown.time))
        # The mark and the arrows are seen above the path.
        self._topmost = np.flatnonzero(layers[0] == TOP)
        self._orders = np.ascontiguousarray(np.argsort(layers, axis=1, kind='stable')[
            :, :layers.shape[1] - len(self._topmost)])

    def _prepare_path(self, motion, artist, path):
        """Find the path of the point, in all instants that are known."""
        self._path, self._path_times = np.zeros((0, 2)), motion.time
        self._trailed, self._passed = -1, 0
        if path is None:
            return
        # A point for each pixel or two of the path is enough.
        steps = np.hypot(*np.diff(path, axis=0).T)
        passed = np.concatenate([[0.0], np.cumsum(steps)]) // (TRAIL * artist.extent)
        kept = np.unique(passed, return_index=True)[1]
        self._path, self._path_times = self._pixels(path[kept]), motion.time[kept]

    def _prepare_clock(self, above, below):
        """Find where the time is written, and where the line is that tells it."""
        height = self.canvas.still.shape[0]
        font = ImageFont.truetype(findfont(FontProperties(family='monospace')), CLOCK_SIZE)
        size = round(font.getlength('0') + 1.0), sum(font.getmetrics())
        self._glyphs = np.zeros((len(CHARACTERS), size[1], size[0]), dtype=np.uint8)
        for k, character in enumerate(CHARACTERS):
            picture = Image.new('L', size)
            ImageDraw.Draw(picture).text((0, 0), character, fill=255, font=font)
            self._glyphs[k] = np.asarray(picture)
        texts = [f't = {time:7.3f} s' for time in self._frame_times]
        longest = max(map(len, texts))
        self._codes = np.array([[CHARACTERS.index(character) for character in text.rjust(longest)]
                                for text in texts])
        advance = font.getlength('0')
        right, top = _Pixels(height, above.transAxes)(np.array([0.99, 0.98]))
        self._clock_place = (int(right - advance * longest), int(top), advance, 0)
        self._cursor_places = _Pixels(height, below.transData)(np.column_stack(
            [self._frame_times, np.zeros(len(self._frame_times))]))[:, 0]
        box = below.get_window_extent()
        self._cursor_ends = height - box.y1, height - box.y0

    def _plot_forces(self, axes, motion, magnitudes, largest):
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
        raise AnimationError(f'{path}: expected a name that ends in .gif or .mp4')
    if path.suffix.lower() == '.mp4' and shutil.which('ffmpeg') is None:
        raise AnimationError(
            f'{path}: the program ffmpeg makes MP4 files, and it is not installed; install it '
            f'(sudo apt install ffmpeg), or write {path.with_suffix(".gif").name}')


def write(animation, path, rate, progress=lambda done: None):
    """
    Write an animation into a ``.gif`` or ``.mp4`` file, which is replaced when all is written.

    What ends the writing before leaves nothing. ``rate`` is in frames per second [Hz];
    ``progress`` is told how many frames are done. Raises OSError where it cannot be written.

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
    with open(path, 'wb') as file:
        # The last frame has all that is drawn, the whole path among it.
        gif = Gif(file, animation.frame(len(animation) - 1), rate)
        for index in range(len(animation)):
            animation.show(index)
            gif.add(animation.canvas, whole=index == 0)
            progress(index + 1)
        gif.close()


class _Frames(Figure):
    """What matplotlib takes for a figure: its picture is one that was drawn already."""

    def __init__(self, animation):
        height, width, _ = animation.canvas.picture.shape
        super().__init__(figsize=(width / FRAME_DOTS_PER_INCH, height / FRAME_DOTS_PER_INCH),
                         dpi=FRAME_DOTS_PER_INCH)
        FigureCanvasAgg(self)
        self._picture = animation.canvas.picture

    def savefig(self, file, **options):
        """Write the picture."""
        file.write(self._picture.tobytes())


def _write_mp4(animation, path, rate, progress):
    # Only here, as it takes a tenth of a second.
    from matplotlib.animation import FFMpegWriter
    writer = FFMpegWriter(fps=rate, codec='h264')
    try:
        with writer.saving(_Frames(animation), str(path), FRAME_DOTS_PER_INCH):
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
