# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""GIFs show what was drawn, at its rate, and are written frame by frame."""

import io

from closedloop_dynamics.visual.gif import Gif
import numpy as np
from PIL import Image, ImageDraw, ImageSequence
import pytest

BLUE, ORANGE, SIZE = (0, 114, 178), (213, 94, 0), (131, 97)


def drawn(x):
    """Return a picture with a line and a disk that are elsewhere for each x."""
    picture = Image.new('RGBA', SIZE, 'white')
    draw = ImageDraw.Draw(picture)
    draw.line((x, 5, 130 - x, 90), fill=BLUE, width=4)
    draw.ellipse((100 - x, x, 120 - x, x + 20), fill=ORANGE, outline='black', width=2)
    return np.asarray(picture)


def written(pictures, sample, rate=25.0):
    """Return the bytes of a GIF, and how long it was after each picture."""
    file, sizes = io.BytesIO(), []
    gif = Gif(file, sample, rate)
    for picture in pictures:
        gif.add(picture)
        sizes.append(file.tell())
    gif.close()
    return file.getvalue(), sizes


def test_a_gif_shows_what_was_drawn_pixel_by_pixel():
    # In some of them nothing moves; only a corner does in the last one.
    pictures = [drawn(5 + 10 * min(k, 6)) for k in range(9)]
    pictures.append(pictures[-1].copy())
    pictures[-1][-3:, -2:] = 0, 0, 0, 255
    content, sizes = written(pictures, np.concatenate(pictures))
    with Image.open(io.BytesIO(content)) as gif:
        assert (gif.n_frames, gif.info['duration'], gif.info['loop']) == (10, 40, 0)
        for frame, picture in zip(ImageSequence.Iterator(gif), pictures, strict=True):
            np.testing.assert_array_equal(np.asarray(frame.convert('RGB')), picture[..., :3])
    # None waits for others, and what does not change takes next to nothing.
    added = np.diff(sizes)
    assert added.min() > 0 and added[6:].max() < 50 < added[:6].min()


def test_areas_have_their_own_colors_among_many_others():
    rng = np.random.default_rng(7)
    sample = np.full((60, 400, 4), 255, dtype=np.uint8)
    sample[:20, :200, :3], sample[20:40, :200, :3] = BLUE, (235, 235, 235)
    # As at the smooth edges of a drawing: mixed with white, most of them almost white.
    share = rng.random((10, 400, 1)) ** 3
    inks = rng.choice([BLUE, ORANGE, (0, 0, 0), (0, 158, 115)], (10, 400))
    sample[50:, :, :3] = 255.0 * (1.0 - share) + inks * share
    content, _ = written([sample], sample)
    with Image.open(io.BytesIO(content)) as gif:
        shown = np.asarray(gif.convert('RGB')).astype(int)
    np.testing.assert_array_equal(shown[:50], sample[:50, :, :3])
    assert np.abs(shown - sample[..., :3]).mean() < 10.0


@pytest.mark.parametrize('rate, duration', [(20.0, 50), (60.0, 20), (1000.0, 20), (3.0, 330)])
def test_frames_are_shown_for_hundredths_of_seconds(rate, duration):
    pictures = [drawn(5), drawn(9)]
    with Image.open(io.BytesIO(written(pictures, pictures[0], rate)[0])) as gif:
        for frame in ImageSequence.Iterator(gif):
            assert frame.info['duration'] == duration
