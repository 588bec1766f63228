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
A GIF written frame by frame, each as what has changed since the one before.

Pillow compares whole pictures and compresses every pixel of a frame; here what is drawn on is
known, and runs of unchanged pixels are taken in one step.

"""

import struct

import numpy as np
from PIL import Image

from .raster import BEFORE, next_run, NOW, tile_width, TILES
from ..core.compiled import compiled

# Colours of the palette; the last number stands for what does not change.
BITS = 6
UNCHANGED = (1 << BITS) - 1
COLORS = UNCHANGED
# What differs is marked by this bit until it is taken.
MARK = 0x80
# Bits of each of red, green and blue that choose the colour.
DEPTH = 5
# A GIF counts the time of a frame in hundredths of a second; shorter ones are shown too long.
TICKS, SHORTEST = 100, 2
# Of the compression: codes of at most so many bits.
MOST_BITS = 12
MOST_CODES = 1 << MOST_BITS
# Pixels that are compared at once, and as many that do not change.
WORD = 8
UNCHANGED_WORD = np.uint64(int.from_bytes(bytes(WORD * [UNCHANGED]), 'little'))


class Gif:
    """
    A GIF that goes round without end.

    Parameters
    ----------
    file : file object
        Binary, to be written.
    sample : ndarray of uint8, shape (height, width, 4)
        A picture with all colours that will come.
    rate : float
        Frames per second [Hz], to the nearest hundredth of a second.

    """

    def __init__(self, file, sample, rate):
        """Choose the colours and write what comes before the frames."""
        self._file = file
        height, width, _ = sample.shape
        picture = Image.fromarray(sample).convert('RGB').quantize(
            COLORS, Image.Quantize.MAXCOVERAGE)
        levels = np.arange(1 << DEPTH) * 255 // ((1 << DEPTH) - 1)
        cube = np.stack(np.meshgrid(levels, levels, levels, indexing='ij'), axis=-1)
        self._nearest = np.ascontiguousarray(np.asarray(Image.fromarray(
            cube.reshape(1, -1, 3).astype(np.uint8)).quantize(
                palette=picture, dither=Image.Dither.NONE))[0])
        self._shown = np.full((height, width), UNCHANGED, dtype=np.uint8)
        self._changed = np.zeros((height * width // WORD + 1) * WORD, dtype=np.uint8)
        self._box = np.zeros(4, dtype=np.int64)
        # A code has at most 12 bits and stands for a pixel or more; lengths of blocks come on top.
        self._out = np.zeros(2 * height * width + 1024, dtype=np.uint8)
        self._children = np.zeros((MOST_CODES, 1 << BITS), dtype=np.uint16)
        self._runs = np.zeros(MOST_CODES + 1, dtype=np.int64)
        self._delay = max(SHORTEST, round(TICKS / rate))
        colors = bytes(picture.getpalette()[:3 * COLORS]).ljust(3 << BITS, b'\0')
        file.write(b'GIF89a' + struct.pack('<HHBBB', width, height, 0x80 | (BITS - 1), 0, 0)
                   + colors + b'!\xff\x0bNETSCAPE2.0\x03\x01\0\0\0')

    def add(self, canvas, whole=False):
        """
        Add a frame: the picture of a ``raster.Canvas``, and what was drawn on.

        ``whole`` says that everything may have changed, as in the first frame.

        """
        find_changes(canvas, self._nearest, whole, self._shown, self._changed, self._box)
        left, top, right, bottom = self._box.tolist()
        count = compress(self._changed, self._changed.view(np.uint64),
                         (right - left) * (bottom - top), self._children, self._runs, self._out)
        # Left as it is, with one colour that is seen through.
        self._file.write(
            b'!\xf9\x04' + struct.pack('<BHBB', 0b101, self._delay, UNCHANGED, 0)
            + b',' + struct.pack('<HHHHBB', left, top, right - left, bottom - top, 0, BITS))
        self._file.write(self._out[:count].tobytes())

    def close(self):
        """Write the end."""
        self._file.write(b';')


@compiled
def find_changes(canvas, nearest, whole, shown, changed, box):
    """
    Find the pixels whose colours in the palette have changed.

    Parameters
    ----------
    canvas : raster.Canvas
        With the picture, and what was drawn on.
    nearest : ndarray of uint8, shape (2 ** (3 DEPTH),)
        Number in the palette of each colour, red in the highest bits.
    whole : bool
        Whether to look at every pixel.
    shown : ndarray of uint8, shape (height, width)
        What is shown, by its numbers; updated.
    changed : ndarray of uint8, shape (more than height * width,)
        What has changed in the box, row by row; written.
    box : ndarray of int64, shape (4,)
        Left, top, right and bottom of what has changed; one pixel where nothing has. Written.

    """
    picture, tiles = canvas.picture, canvas.tiles
    height, width = shown.shape
    cut, size = 8 - DEPTH, tile_width(width)
    left, top, right, bottom = width, height, 0, 0
    for row in range(height):
        drawn = tiles[NOW, row] | tiles[BEFORE, row]
        if whole:
            drawn = (1 << TILES) - 1
        if drawn == 0:
            continue
        first, last = width, 0
        stop = 0
        while drawn >> stop:
            start, stop = next_run(drawn, stop)
            for x in range(start * size, min(width, stop * size)):
                number = nearest[((picture[row, x, 0] >> cut) << 2 * DEPTH)
                                 | ((picture[row, x, 1] >> cut) << DEPTH)
                                 | (picture[row, x, 2] >> cut)]
                if number != shown[row, x]:
                    shown[row, x] = number | MARK
                    first, last = min(first, x), x + 1
        if first < last:
            left, right = min(left, first), max(right, last)
            top, bottom = min(top, row), row + 1
    if left >= right:
        left, top, right, bottom = 0, 0, 1, 1
    box[0], box[1], box[2], box[3] = left, top, right, bottom
    span = right - left
    for k in range(span * (bottom - top)):
        changed[k] = UNCHANGED
    for row in range(top, bottom):
        drawn = tiles[NOW, row] | tiles[BEFORE, row]
        if whole:
            drawn = (1 << TILES) - 1
        if drawn == 0:
            continue
        at = (row - top) * span - left
        stop = 0
        while drawn >> stop:
            start, stop = next_run(drawn, stop)
            for x in range(max(left, start * size), min(right, stop * size)):
                if shown[row, x] & MARK:
                    changed[at + x] = shown[row, x] = shown[row, x] & ~MARK


@compiled
def compress(pixels, words, count, children, runs, out):
    """
    Compress pixels as a GIF has them (Lempel, Ziv and Welch), in blocks.

    Parameters
    ----------
    pixels : ndarray of uint8
        The first ``count`` are taken; the one after them is overwritten.
    words : ndarray of uint64
        The same, WORD pixels in each.
    count : int
        At least one.
    children : ndarray of uint16, shape (MOST_CODES, 2 ** BITS)
        Code of what another code stands for with a pixel after it, zero: none. Written.
    runs : ndarray of int64, shape (MOST_CODES + 1,)
        Code of so many unchanged pixels. Written.
    out : ndarray of uint8
        Written.

    Returns
    -------
    int
        Number of bytes.

    """
    clear, end = 1 << BITS, (1 << BITS) + 1
    waiting, held, written, block = 0, 0, 1, 0
    # No pixel of the palette: it ends the last run.
    pixels[count] = 255
    bits, free, longest = BITS + 1, MOST_CODES, 1
    at, code, pending = 0, -1, clear
    run_end = 0
    while True:
        # Write what is pending.
        waiting |= pending << held
        held += bits
        while held >= 8:
            if block == 255:
                out[written - 256] = 255
                written += 1
                block = 0
            out[written] = waiting & 255
            waiting >>= 8
            held -= 8
            written += 1
            block += 1
        if pending == end:
            break
        if pending == clear:
            children[:] = 0
            bits, free, longest = BITS + 1, end + 1, 1
            runs[1] = UNCHANGED
        elif at < count:
            # The string that was written and the pixel after it get a code, as far as there are.
            if free < MOST_CODES:
                children[code, pixels[at]] = free
                if pixels[at] == UNCHANGED and code == runs[longest]:
                    longest += 1
                    runs[longest] = free
                if free == 1 << bits:
                    bits += 1
                free += 1
            else:
                pending = clear
                continue
        if at >= count:
            pending = end
            continue
        # The longest string that has a code.
        if pixels[at] == UNCHANGED:
            if run_end <= at:
                run_end = at + 1
                while run_end % WORD and pixels[run_end] == UNCHANGED:
                    run_end += 1
                if run_end % WORD == 0:
                    while words[run_end // WORD] == UNCHANGED_WORD:
                        run_end += WORD
                    while pixels[run_end] == UNCHANGED:
                        run_end += 1
            length = min(longest, run_end - at)
            code = runs[length]
            at += length
        else:
            code = np.int64(pixels[at])
            at += 1
        while at < count:
            following = np.int64(children[code, pixels[at]])
            if following == 0:
                break
            code = following
            at += 1
        pending = code
    if held > 0:
        if block == 255:
            out[written - 256] = 255
            written += 1
            block = 0
        out[written] = waiting & 255
        written += 1
        block += 1
    out[written - block - 1] = block
    out[written] = 0
    return written + 1
