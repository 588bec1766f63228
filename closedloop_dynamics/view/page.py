# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The page: one HTML file made of the parts beside this one, with or without a motion in it."""

import base64
from importlib.resources import files
import json

import numpy as np

PARTS = ('algebra.js', 'history.js', 'meshes.js', 'parts.js', 'guides.js', 'ropes.js', 'trails.js',
         'arrows.js', 'overlay.js', 'camera.js', 'scene.js', 'plot.js', 'plots.js', 'panels.js',
         'timeline.js', 'compare.js', 'vector.js', 'export.js', 'edit.js', 'drawing.js',
         'gears.js', 'expression.js', 'reading.js', 'board.js', 'machine.js', 'standalone.js',
         'planar.js', 'editor.js', 'page.js')
STYLES = ('page.css', 'edit.css', 'board.css', 'time.css')


def live_page(title, others=()):
    """
    Return a page, HTML, that shows the messages of its server.

    ``others``: titles of all pages of the server, this one among them, where there are several.
    """
    return _page(title, {'pages': list(others)})


def recorded_page(title, description, times, rows):
    """
    Return a page, HTML, that has a motion in it and needs nothing else.

    ``description`` is by ``description.describe``; ``times``, shape (n,) [s], do not fall;
    ``rows``, float32, shape (n, width), are as the description says.
    """
    return _page(title, {
        'scene': description, 'count': len(times),
        'times': packed(times, np.float64), 'rows': packed(rows, np.float32)})


def standalone_page(title, description, machine):
    """
    Return a page, HTML, that simulates a machine by itself and needs nothing else.

    ``description`` and ``machine`` are by ``standalone.standalone``.
    """
    return _page(title, {'description': description, 'machine': machine})


def editor_page(title, method):
    """
    Return a page, HTML, to draw machines in the plane and simulate them; it needs nothing else.

    ``method`` is ``standalone.METHOD``.
    """
    return _page(title, {'editor': method})


def packed(values, kind):
    """Return numbers in base64, least significant byte first."""
    values = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder('<'))
    return base64.b64encode(values.tobytes()).decode('ascii')


def _page(title, given):
    folder = files(__package__) / 'page'
    script = '\n'.join((folder / part).read_text(encoding='utf-8') for part in PARTS)
    style = '\n'.join((folder / part).read_text(encoding='utf-8') for part in STYLES)
    # In a script, '</' would end it.
    data = json.dumps(given, allow_nan=False).replace('<', '\\u003c')
    text = (folder / 'page.html').read_text(encoding='utf-8')
    for mark, part in (('/*STYLE*/', style),
                       ('TITLE', _escaped(title)), ('/*DATA*/', data), ('/*SCRIPT*/', script)):
        text = text.replace(mark, part, 1)
    return text


def _escaped(text):
    return text.replace('&', '&amp;').replace('<', '&lt;')
