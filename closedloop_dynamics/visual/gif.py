# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A GIF written frame by frame, each as the change since the one before.

Pillow's own writer of several frames keeps all of them in memory until the last one is known.
"""

import io

import numpy as np

from ..mechanism.extras import of_an_extra

with of_an_extra():
    from PIL import Image
    from PIL.GifImagePlugin import getdata

# Colours of the palette; the last number marks unchanged pixels.
UNCHANGED = COLORS = 127
# A GIF counts the time of a frame in hundredths of a second; shorter ones are shown too long.
TICKS, SHORTEST = 100, 2


class Gif:
    """
    A GIF that goes round without end, written into a binary file.

    ``sample``, uint8 of shape (height, width, 4): a picture with all colours that will come, of
    any size; ``rate``: frames per second [Hz], to the nearest hundredth of a second.
    """

    def __init__(self, file, sample, rate):
        self._file = file
        sample = Image.fromarray(sample).convert('RGB')
        self._palette = sample.quantize(COLORS, Image.Quantize.MAXCOVERAGE)
        # A colour of the palette is a mean of several; the most frequent of these is shown, so
        # that areas have their colours, white is white, and gray has no tint.
        numbers, counts = np.unique(
            np.asarray(sample) @ np.array([1 << 16, 1 << 8, 1]), return_counts=True)
        colors = (numbers[np.argsort(counts), np.newaxis] >> [16, 8, 0]).astype(np.uint8)
        shown = np.zeros((COLORS + 1, 3), dtype=np.uint8)
        shown[self._numbers(Image.fromarray(colors[np.newaxis]))[0]] = colors
        self._colors = shown.tobytes()
        # [ms]
        self._duration = 1000 // TICKS * max(SHORTEST, round(TICKS / rate))
        self._shown = None

    def add(self, picture):
        """Write a frame: ndarray of uint8, shape (height, width, 4), its opacity left out."""
        before, self._shown = self._shown, self._numbers(
            Image.fromarray(picture).convert('RGB'))
        if before is None:
            frame, first = Image.fromarray(self._shown), io.BytesIO()
            frame.putpalette(self._colors)
            frame.save(first, 'GIF', loop=0, duration=self._duration, disposal=1, optimize=False)
            # More follows before the end.
            self._file.write(first.getvalue()[:-1])
            return
        changed = self._shown != before
        rows, columns = (np.flatnonzero(changed.any(axis=axis)) for axis in (1, 0))
        # One pixel where nothing has changed.
        top, bottom = (rows[0], rows[-1] + 1) if len(rows) else (0, 1)
        left, right = (columns[0], columns[-1] + 1) if len(rows) else (0, 1)
        part = np.where(changed, self._shown, np.uint8(UNCHANGED))[top:bottom, left:right]
        self._file.write(b''.join(getdata(
            Image.fromarray(np.ascontiguousarray(part)), (int(left), int(top)),
            duration=self._duration, transparency=UNCHANGED, disposal=1)))

    def _numbers(self, picture):
        """Return the numbers in the palette of a picture's colours, shape (height, width)."""
        return np.asarray(picture.quantize(palette=self._palette, dither=Image.Dither.NONE))

    def close(self):
        """Write the end."""
        self._file.write(b';')
