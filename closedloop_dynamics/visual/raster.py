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

"""
Lines, convex polygons and dots drawn over a picture that stands still, with smooth edges.

Places are in pixels, x to the right, y down. What was drawn on is noted, so that the next frame
restores, and a file gets, no more than that.

"""

import math
from typing import NamedTuple

import numpy as np

from ..core.compiled import compiled, inlined

LINE, POLYGON, DOTS = range(3)
# What was drawn on: in the present frame, and in the one before.
NOW, BEFORE = 0, 1
# Every row is divided into so many tiles, a bit each.
TILES = 32
# Three points count as on a line where they span less than this share of the extent's square.
FLAT = 1e-9


class Canvas(NamedTuple):
    """
    Where frames are drawn.

    Attributes
    ----------
    still : ndarray of uint8, shape (height, width, 4)
        What stands still: red, green, blue, opacity.
    picture : ndarray of uint8, shape (height, width, 4)
        The present frame.
    trail : ndarray of uint8, shape (height, width)
        How much of each pixel a path covers that grows from frame to frame, 0 to 255.
    tiles : ndarray of int64, shape (2, height)
        Which parts of each row were drawn on, the first in the lowest bit.

    """

    still: np.ndarray
    picture: np.ndarray
    trail: np.ndarray
    tiles: np.ndarray


class Shapes(NamedTuple):
    """
    What is drawn in every frame, at other places each time.

    Attributes
    ----------
    kind : ndarray of int64, shape (n,)
        LINE, POLYGON or DOTS.
    first : ndarray of int64, shape (n + 1,)
        Row of the first vertex of each shape; dots have one each.
    fill, edge : ndarray of int64, shape (n, 3)
        Colours; that of a line is its edge's.
    half : ndarray of float64, shape (n,)
        Half the width of lines and edges [pixels]; zero: no edge.
    radius : ndarray of float64, shape (n,)
        Of dots, up to the middle of the edge [pixels].
    dashes : ndarray of float64, shape (n, 4)
        Dash, gap, dash and gap of a line [pixels]; zero: none.

    """

    kind: np.ndarray
    first: np.ndarray
    fill: np.ndarray
    edge: np.ndarray
    half: np.ndarray
    radius: np.ndarray
    dashes: np.ndarray


def canvas(still):
    """Return a canvas over a picture, ndarray of uint8, shape (height, width, 4)."""
    height, width, _ = still.shape
    return Canvas(np.ascontiguousarray(still), still.copy(),
                  np.zeros((height, width), dtype=np.uint8),
                  np.zeros((2, height), dtype=np.int64))


@inlined
def tile_width(width):
    """Return how many pixels a tile has in a picture of this width."""
    return (width + TILES - 1) // TILES


@inlined
def _blend(picture, row, x, red, green, blue, share):
    """Mix a colour into a pixel."""
    part = int(256.0 * share + 0.5)
    picture[row, x, 0] += ((red - picture[row, x, 0]) * part) >> 8
    picture[row, x, 1] += ((green - picture[row, x, 1]) * part) >> 8
    picture[row, x, 2] += ((blue - picture[row, x, 2]) * part) >> 8


@inlined
def _note(place, row, low, high):
    """Note that a part of a row is drawn on."""
    size = tile_width(place.trail.shape[1])
    for tile in range(low // size, (high - 1) // size + 1):
        place.tiles[NOW, row] |= 1 << tile


@inlined
def next_run(drawn, tile):
    """Return the first tile of the next ones that were drawn on, and the one after the last."""
    while not drawn >> tile & 1:
        tile += 1
    start = tile
    while drawn >> tile & 1:
        tile += 1
    return start, tile


@compiled
def begin(place):
    """
    Restore what the frame before has drawn on, and note it as such.

    Parameters
    ----------
    place : Canvas
        Changed.

    """
    still, picture, tiles = place.still, place.picture, place.tiles
    height, width = still.shape[0], still.shape[1]
    size = tile_width(width)
    for row in range(height):
        drawn = tiles[NOW, row]
        tiles[BEFORE, row], tiles[NOW, row] = drawn, 0
        if drawn == 0:
            continue
        stop = 0
        while drawn >> stop:
            start, stop = next_run(drawn, stop)
            for x in range(start * size, min(width, stop * size)):
                for channel in range(4):
                    picture[row, x, channel] = still[row, x, channel]


@compiled
def line(place, x0, y0, x1, y1, half, red, green, blue):
    """
    Draw a straight line with round ends.

    Parameters
    ----------
    place : Canvas
        Changed.
    x0, y0, x1, y1 : float
        Ends [pixels].
    half : float
        Half its width [pixels].
    red, green, blue : int
        0 to 255.

    """
    picture = place.picture
    height, width = picture.shape[0], picture.shape[1]
    reach = half + 0.5
    dx, dy = x1 - x0, y1 - y0
    length = math.sqrt(dx * dx + dy * dy)
    if length > 0.0:
        dx /= length
        dy /= length
    else:
        dx = 1.0
    top = max(0, int(math.floor(min(y0, y1) - reach)))
    bottom = min(height, int(math.ceil(max(y0, y1) + reach)) + 1)
    for row in range(top, bottom):
        ry = row + 0.5 - y0
        # The strip along the line, and its ends.
        low, high = min(x0, x1) - reach, max(x0, x1) + reach
        if abs(dy) > 1e-9:
            a, b = (ry * dx - reach) / dy + x0, (ry * dx + reach) / dy + x0
            low, high = max(low, min(a, b)), min(high, max(a, b))
        first, last = max(0, int(math.floor(low - 0.5))), min(width, int(math.ceil(high + 0.5)))
        if first >= last:
            continue
        _note(place, row, first, last)
        for x in range(first, last):
            rx = x + 0.5 - x0
            along = rx * dx + ry * dy
            across = rx * dy - ry * dx
            beyond = max(-along, along - length, 0.0)
            share = reach - math.sqrt(beyond * beyond + across * across)
            if share > 0.0:
                _blend(picture, row, x, red, green, blue, min(share, 1.0))


@compiled
def _dashed(place, x0, y0, x1, y1, half, red, green, blue, dashes):
    """Draw a line in dashes."""
    length = math.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
    start, piece = 0.0, 0
    while start < length and length > 0.0:
        end = min(length, start + dashes[piece])
        if piece % 2 == 0:
            a, b = start / length, end / length
            line(place, x0 + a * (x1 - x0), y0 + a * (y1 - y0), x0 + b * (x1 - x0),
                 y0 + b * (y1 - y0), half, red, green, blue)
        start, piece = end, (piece + 1) % 4


@compiled
def dot(place, x, y, radius, half, fill, edge):
    """
    Draw a disk with an edge.

    Parameters
    ----------
    place : Canvas
        Changed.
    x, y, radius : float
        Centre, and distance of the middle of the edge from it [pixels].
    half : float
        Half the width of the edge [pixels].
    fill, edge : ndarray of int64, shape (3,)
        Colours.

    """
    picture = place.picture
    height, width = picture.shape[0], picture.shape[1]
    reach = radius + half + 0.5
    top, bottom = max(0, int(math.floor(y - reach))), min(height, int(math.ceil(y + reach)) + 1)
    first, last = max(0, int(math.floor(x - reach))), min(width, int(math.ceil(x + reach)) + 1)
    if first >= last:
        return
    for row in range(top, bottom):
        _note(place, row, first, last)
        for column in range(first, last):
            away = math.sqrt((column + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2)
            share = reach - away
            if share <= 0.0:
                continue
            if half > 0.0:
                _blend(picture, row, column, edge[0], edge[1], edge[2], min(share, 1.0))
                inside = radius - half + 0.5 - away
            else:
                inside = share
            if inside > 0.0:
                _blend(picture, row, column, fill[0], fill[1], fill[2], min(inside, 1.0))


@inlined
def _turn(points, a, b, c):
    """Return twice the area of a triangle, positive counter-clockwise."""
    return (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1]) - (
        points[b, 1] - points[a, 1]) * (points[c, 0] - points[a, 0])


@compiled
def polygon(place, corners, first, stop, half, fill, edge):
    """
    Draw a convex polygon with an edge.

    Parameters
    ----------
    place : Canvas
        Changed.
    corners : ndarray, shape (n, 2)
        [pixels].
    first, stop : int
        Its corners among these, either way round; the same one may come several times.
    half : float
        Half the width of the edge [pixels].
    fill, edge : ndarray of int64, shape (3,)
        Colours.

    """
    picture = place.picture
    height, width = picture.shape[0], picture.shape[1]
    area, top, bottom = 0.0, math.inf, -math.inf
    left, right = math.inf, -math.inf
    for k in range(first, stop):
        following = k + 1 if k + 1 < stop else first
        area += _turn(corners, first, k, following)
        top, bottom = min(top, corners[k, 1]), max(bottom, corners[k, 1])
        left, right = min(left, corners[k, 0]), max(right, corners[k, 0])
    if abs(area) > FLAT * (right - left + bottom - top) ** 2:
        sense = 1.0 if area > 0.0 else -1.0
        for row in range(max(0, int(math.floor(top - 0.5))),
                         min(height, int(math.ceil(bottom + 0.5)) + 1)):
            # Of every edge's line: where the row is out of it at all, and where all inside.
            low, high, core_low, core_high = left - 1.0, right + 1.0, left, right
            y = row + 0.5
            for k in range(first, stop):
                following = k + 1 if k + 1 < stop else first
                ex = corners[following, 0] - corners[k, 0]
                ey = corners[following, 1] - corners[k, 1]
                size = math.sqrt(ex * ex + ey * ey)
                if size == 0.0:
                    continue
                # How far out a pixel is: nx x + c.
                nx, ny = sense * ey / size, -sense * ex / size
                c = ny * (y - corners[k, 1]) - nx * corners[k, 0]
                if abs(nx) < 1e-9:
                    if c > 0.5:
                        low, high = 1.0, 0.0
                    if c > -0.5:
                        core_low, core_high = 1.0, 0.0
                elif nx > 0.0:
                    high = min(high, (0.5 - c) / nx)
                    core_high = min(core_high, (-0.5 - c) / nx)
                else:
                    low = max(low, (0.5 - c) / nx)
                    core_low = max(core_low, (-0.5 - c) / nx)
            begin_x = max(0, int(math.ceil(low - 0.5)))
            end_x = min(width, int(math.floor(high - 0.5)) + 1)
            if begin_x >= end_x:
                continue
            _note(place, row, begin_x, end_x)
            for x in range(begin_x, end_x):
                share = 1.0
                if not core_low <= x + 0.5 <= core_high:
                    out = -math.inf
                    for k in range(first, stop):
                        following = k + 1 if k + 1 < stop else first
                        ex = corners[following, 0] - corners[k, 0]
                        ey = corners[following, 1] - corners[k, 1]
                        size = math.sqrt(ex * ex + ey * ey)
                        if size > 0.0:
                            out = max(out, sense * (ey * (x + 0.5 - corners[k, 0])
                                                    - ex * (y - corners[k, 1])) / size)
                    share = min(1.0, 0.5 - out)
                if share > 0.0:
                    _blend(picture, row, x, fill[0], fill[1], fill[2], share)
    if half > 0.0:
        for k in range(first, stop):
            following = k + 1 if k + 1 < stop else first
            if k == first or corners[k, 0] != corners[following, 0] or (
                    corners[k, 1] != corners[following, 1]):
                line(place, corners[k, 0], corners[k, 1], corners[following, 0],
                     corners[following, 1], half, edge[0], edge[1], edge[2])


@compiled
def draw(place, shapes, vertices, order):
    """
    Draw shapes one over the other.

    Parameters
    ----------
    place : Canvas
        Changed.
    shapes : Shapes
        Any.
    vertices : ndarray of float64, shape (n, 2)
        Of all of them [pixels]; shapes with NaN are left out.
    order : ndarray of int64
        Their numbers, the lowest first.

    """
    for number in order:
        first, stop = shapes.first[number], shapes.first[number + 1]
        known = True
        for k in range(first, stop):
            known = known and vertices[k, 0] == vertices[k, 0]
        if not known:
            continue
        edge, fill, half = shapes.edge[number], shapes.fill[number], shapes.half[number]
        if shapes.kind[number] == POLYGON:
            polygon(place, vertices, first, stop, half, fill, edge)
        elif shapes.kind[number] == DOTS:
            for k in range(first, stop):
                dot(place, vertices[k, 0], vertices[k, 1], shapes.radius[number], half, fill, edge)
        else:
            for k in range(first, stop - 1):
                if shapes.dashes[number, 0] > 0.0:
                    _dashed(place, vertices[k, 0], vertices[k, 1], vertices[k + 1, 0],
                            vertices[k + 1, 1], half, edge[0], edge[1], edge[2],
                            shapes.dashes[number])
                else:
                    line(place, vertices[k, 0], vertices[k, 1], vertices[k + 1, 0],
                         vertices[k + 1, 1], half, edge[0], edge[1], edge[2])


@compiled
def lengthen(place, path, first, stop, half):
    """
    Let the trail go on along a path.

    Parameters
    ----------
    place : Canvas
        Its trail and tiles are changed.
    path : ndarray of float64, shape (n, 2)
        [pixels].
    first, stop : int
        From which of its points to which, the last one included.
    half : float
        Half the width of the trail [pixels].

    """
    trail = place.trail
    height, width = trail.shape
    reach = half + 0.5
    for k in range(first, stop):
        x0, y0, x1, y1 = path[k, 0], path[k, 1], path[k + 1, 0], path[k + 1, 1]
        dx, dy = x1 - x0, y1 - y0
        square = dx * dx + dy * dy
        low = max(0, int(math.floor(min(x0, x1) - reach)))
        high = min(width, int(math.ceil(max(x0, x1) + reach)) + 1)
        for row in range(max(0, int(math.floor(min(y0, y1) - reach))),
                         min(height, int(math.ceil(max(y0, y1) + reach)) + 1)):
            if low < high:
                _note(place, row, low, high)
            for x in range(low, high):
                rx, ry = x + 0.5 - x0, row + 0.5 - y0
                share = 0.0
                if square > 0.0:
                    share = min(1.0, max(0.0, (rx * dx + ry * dy) / square))
                rx -= share * dx
                ry -= share * dy
                cover = reach - math.sqrt(rx * rx + ry * ry)
                if cover > 0.0:
                    trail[row, x] = max(trail[row, x], int(255.0 * min(cover, 1.0)))


@compiled
def draw_trail(place, color):
    """Draw the trail, of a colour, where this frame or the one before has drawn."""
    trail, picture, tiles = place.trail, place.picture, place.tiles
    width = trail.shape[1]
    size = tile_width(width)
    for row in range(trail.shape[0]):
        drawn = tiles[NOW, row] | tiles[BEFORE, row]
        if drawn == 0:
            continue
        stop = 0
        while drawn >> stop:
            start, stop = next_run(drawn, stop)
            for x in range(start * size, min(width, stop * size)):
                if trail[row, x]:
                    _blend(picture, row, x, color[0], color[1], color[2], trail[row, x] / 255.0)


@compiled
def write_text(place, glyphs, codes, x, y, advance, shade):
    """
    Write glyphs of one width beside each other.

    Parameters
    ----------
    place : Canvas
        Changed.
    glyphs : ndarray of uint8, shape (n, height, width)
        How much of each pixel they cover.
    codes : ndarray of int64
        Their numbers.
    x, y : int
        Upper left corner of the first [pixels].
    advance : float
        From one to the next [pixels].
    shade : int
        Of gray, 0 to 255.

    """
    picture = place.picture
    height, width = picture.shape[0], picture.shape[1]
    for k in range(len(codes)):
        left = x + int(k * advance + 0.5)
        for i in range(glyphs.shape[1]):
            row = y + i
            if not 0 <= row < height:
                continue
            low, high = max(0, left), min(width, left + glyphs.shape[2])
            if low < high:
                _note(place, row, low, high)
            for column in range(low, high):
                cover = glyphs[codes[k], i, column - left]
                if cover:
                    _blend(picture, row, column, shade, shade, shade, cover / 255.0)


@compiled
def hulls(places, corners, chain):
    """
    Find the convex hulls of points in many pictures.

    Parameters
    ----------
    places : ndarray of float64, shape (n, m, 2)
        Sorted by x and y in place.
    corners : ndarray of float64, shape (n, m, 2)
        Of the hulls, the last one repeated; written.
    chain : ndarray of int64, shape (2 m,)
        Written.

    """
    for frame in range(places.shape[0]):
        points, count = places[frame], places.shape[1]
        for k in range(1, count):
            x, y = points[k, 0], points[k, 1]
            j = k - 1
            while j >= 0 and (points[j, 0] > x or points[j, 0] == x and points[j, 1] > y):
                points[j + 1, 0], points[j + 1, 1] = points[j, 0], points[j, 1]
                j -= 1
            points[j + 1, 0], points[j + 1, 1] = x, y
        found = 0
        for half in range(2):
            start = found
            for step in range(count):
                k = step if half == 0 else count - 1 - step
                while found - start > 1 and _turn(
                        points, chain[found - 2], chain[found - 1], k) <= 0.0:
                    found -= 1
                chain[found] = k
                found += 1
            found -= 1
        for k in range(count):
            corner = chain[min(k, max(found, 1) - 1)]
            corners[frame, k, 0], corners[frame, k, 1] = points[corner, 0], points[corner, 1]
