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
"""What frames of animations are drawn with, and how they are written: areas, hulls, lossless."""

import io

from closedloop_dynamics.visual import raster
from closedloop_dynamics.visual.appearance import convex_hull
from closedloop_dynamics.visual.gif import Gif
import numpy as np
from PIL import Image, ImageSequence
import pytest

BLACK, WHITE = np.zeros(3, dtype=np.int64), np.full(3, 255)
NO_DASHES = np.zeros((1, 4))


def white(height=60, width=80):
    return raster.canvas(np.full((height, width, 4), 255, dtype=np.uint8))


def covered(canvas):
    """Return how many pixels are black, parts of them counted."""
    return (255 - canvas.picture[..., 0].astype(float)).sum() / 255.0


@pytest.mark.parametrize('angle', [0.0, 0.3, 0.5 * np.pi, 2.0, -0.8])
def test_lines_are_as_long_and_wide_as_they_are_told(angle):
    canvas = white()
    x, y = 20.0 * np.cos(angle), 20.0 * np.sin(angle)
    raster.line(canvas, 40.0 - x, 30.0 - y, 40.0 + x, 30.0 + y, 2.5, 0, 0, 0)
    # With half a disk at each end.
    assert covered(canvas) == pytest.approx(40.0 * 5.0 + np.pi * 2.5 ** 2, rel=0.02)


@pytest.mark.parametrize('sense', [1, -1])
@pytest.mark.parametrize('count', [3, 4, 7])
def test_polygons_and_dots_have_their_areas(sense, count):
    angles = sense * 2.0 * np.pi * np.arange(count) / count + 0.2
    corners = 20.0 * np.column_stack([np.cos(angles), np.sin(angles)]) + [40.3, 30.1]
    # A corner may come twice.
    corners = np.vstack([corners, corners[-1:]])
    area = 0.5 * count * 400.0 * np.sin(2.0 * np.pi / count)
    canvas = white()
    raster.polygon(canvas, corners, 0, count + 1, 0.0, BLACK, BLACK)
    assert covered(canvas) == pytest.approx(area, rel=0.01)
    # The edge lies half outside.
    raster.polygon(canvas, corners, 0, count + 1, 1.5, BLACK, BLACK)
    around = 2.0 * count * 20.0 * np.sin(np.pi / count)
    assert covered(canvas) == pytest.approx(area + 1.5 * around + np.pi * 1.5 ** 2, rel=0.01)
    canvas = white()
    raster.dot(canvas, 40.2, 30.4, 9.0, 1.0, WHITE, BLACK)
    assert covered(canvas) == pytest.approx(np.pi * (10.0 ** 2 - 8.0 ** 2), rel=0.02)


def test_what_lies_outside_or_is_unknown_is_left_out():
    canvas = white()
    shapes = raster.Shapes(
        np.array([raster.POLYGON]), np.array([0, 3]), WHITE[None] * 0, WHITE[None] * 0,
        np.array([1.0]), np.zeros(1), NO_DASHES)
    order = np.array([0])
    for corners in ([[-50.0, -9.0], [-20.0, -9.0], [-20.0, 70.0]],
                    [[200.0, 10.0], [300.0, 10.0], [300.0, 50.0]], [[np.nan, 1], [2, 3], [9, 9]]):
        raster.draw(canvas, shapes, np.array(corners, dtype=float), order)
    assert covered(canvas) == 0.0
    # One that is larger than the picture fills it.
    raster.draw(canvas, shapes, np.array([[-500.0, -500.0], [900.0, -500.0], [0.0, 900.0]]), order)
    assert covered(canvas) == canvas.picture[..., 0].size


def test_a_frame_begins_with_what_stands_still():
    still = np.random.default_rng(1).integers(0, 256, (60, 80, 4)).astype(np.uint8)
    canvas = raster.canvas(still)
    raster.line(canvas, 3.0, 50.0, 70.0, 5.0, 3.0, 0, 0, 0)
    raster.dot(canvas, 79.0, 59.0, 5.0, 1.0, BLACK, BLACK)
    assert (canvas.picture != still).any()
    raster.begin(canvas)
    np.testing.assert_array_equal(canvas.picture, still)
    assert canvas.tiles[raster.BEFORE].any() and not canvas.tiles[raster.NOW].any()


def test_hulls_of_many_frames_are_those_of_each():
    rng = np.random.default_rng(4)
    places = rng.normal(size=(40, 7, 2))
    # Points twice, and all on one line.
    places[0, 3], places[1] = places[0, 2], np.outer(np.arange(7.0), [1.0, 2.0])
    corners = np.empty_like(places)
    raster.hulls(places.copy(), corners, np.zeros(14, dtype=np.int64))
    for found, points in zip(corners, places):
        wanted = convex_hull(points)
        assert sorted(map(tuple, np.unique(found, axis=0))) == sorted(map(tuple, wanted))


def shown(canvas, gif):
    """Return the numbers in the palette of the picture."""
    red, green, blue = (canvas.picture[..., k].astype(int) >> 3 for k in range(3))
    return gif._nearest[red << 10 | green << 5 | blue]


def test_a_gif_shows_what_was_drawn_pixel_by_pixel():
    rng = np.random.default_rng(7)
    # Noise on a part: the table of codes is full several times.
    still = np.full((97, 131, 4), 255, dtype=np.uint8)
    still[10:60, 20:90, :3] = rng.integers(0, 4, (50, 70, 3)) * 80
    canvas, file = raster.canvas(still), io.BytesIO()
    gif, wanted = Gif(file, still, 25.0), []
    for k in range(12):
        raster.begin(canvas)
        # In one of them nothing moves.
        x = 5.0 + 10.0 * min(k, 6)
        raster.line(canvas, x, 5.0, 130.0 - x, 90.0, 2.0, 240, 80, 0)
        raster.dot(canvas, 131.0 - x, x, 8.0, 2.0, BLACK, WHITE)
        gif.add(canvas, whole=k == 0)
        wanted.append(shown(canvas, gif))
    gif.close()
    with Image.open(io.BytesIO(file.getvalue())) as picture:
        assert (picture.n_frames, picture.info['duration'], picture.info['loop']) == (12, 40, 0)
        palette = np.array(picture.getpalette()[:189]).reshape(-1, 3)
        for frame, numbers in zip(ImageSequence.Iterator(picture), wanted, strict=True):
            np.testing.assert_array_equal(np.asarray(frame.convert('RGB')), palette[numbers])


@pytest.mark.parametrize('rate, duration', [(20.0, 50), (60.0, 20), (1000.0, 20), (3.0, 330)])
def test_frames_are_shown_for_hundredths_of_seconds(rate, duration):
    canvas, file = white(), io.BytesIO()
    gif = Gif(file, canvas.picture, rate)
    gif.add(canvas, whole=True)
    gif.close()
    with Image.open(io.BytesIO(file.getvalue())) as picture:
        assert picture.info['duration'] == duration
