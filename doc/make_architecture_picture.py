# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Draw the folders of the package and who imports whom: ``doc/pictures/architecture.png``.

    python doc/make_architecture_picture.py

Floors are the layers of the contract in setup.cfg, and the line in each box is the first of the
folder's docstring. Arrows are imports in the code; those that follow from others are left out.
"""

import ast
from configparser import ConfigParser
import math
from pathlib import Path
import re
from textwrap import fill

import grimp
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'closedloop_dynamics'
WIDTH, HEIGHT, FLOOR = 3.9, 0.86, 1.5
LINE = '#5b6b7b'


def floors():
    """Return the folders of each layer, from top to bottom."""
    contracts = ConfigParser()
    contracts.read(ROOT / 'setup.cfg')
    layers = contracts['importlinter:contract:rooms']['layers'].split('\n')
    return [re.findall(r'\w+', layer) for layer in layers if layer.strip()]


def arrows(rooms):
    """Return the pairs of folders that import, without those that follow from others."""
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    imported = {room: {
        name.split('.')[1]
        for module in graph.find_descendants(f'{PACKAGE}.{room}') | {f'{PACKAGE}.{room}'}
        for name in graph.find_modules_directly_imported_by(module)
        if name.startswith(f'{PACKAGE}.')} - {room} for room in rooms}

    def reached(room):
        return imported[room].union(*(reached(other) for other in imported[room]))

    return [(room, other) for room in rooms for other in imported[room]
            if not any(other in reached(between) for between in imported[room])]


def route(start, end):
    """Return the corners of an arrow between the centres of two boxes, beside those between."""
    (x, y), (to_x, to_y) = start, end
    out, into = y - HEIGHT / 2 - 0.06, to_y + HEIGHT / 2 + 0.06
    if y - to_y < 1.01 * FLOOR:
        return [(x, out), (to_x, into)]
    # Boxes of floors of one or three leave this room between them; outer ones look down freely.
    channel = x if abs(x) > WIDTH else math.copysign(0.625 * WIDTH, to_x)
    side = to_x if abs(to_x - channel) < 0.1 else to_x + math.copysign(
        0.3 * WIDTH, channel - to_x)
    # What comes in runs a little above what goes out.
    below, above = y - FLOOR / 2 - 0.1, to_y + FLOOR / 2 + 0.1
    return [(x, out), (x, below), (channel, below), (channel, above), (side, above), (side, into)]


def picture():
    """
    Draw the folders on their floors.

    Returns
    -------
    matplotlib.figure.Figure

    """
    layers = floors()
    figure = Figure(figsize=(11.0, 1.35 * len(layers)), dpi=120, layout='constrained')
    axes = figure.add_subplot()
    places = {}
    for floor, rooms in enumerate(reversed(layers)):
        for k, room in enumerate(rooms):
            places[room] = (1.25 * WIDTH * (k - 0.5 * (len(rooms) - 1)), FLOOR * floor)
    for room, (x, y) in places.items():
        folder = ROOT / PACKAGE / room
        axes.add_patch(FancyBboxPatch(
            (x - WIDTH / 2, y - HEIGHT / 2), WIDTH, HEIGHT, boxstyle='round,pad=0.06',
            facecolor='#eef3f8', edgecolor='#1f4e79', zorder=2))
        text = ast.get_docstring(ast.parse((folder / '__init__.py').read_text())).split('\n')[0]
        axes.text(x, y + 0.25, f'{room}/', ha='center', va='center', fontsize=11,
                  fontweight='bold', zorder=3)
        axes.text(x, y - 0.16, fill(text.replace('``', ''), 50), ha='center', va='center',
                  fontsize=8, zorder=3)
    for room, other in arrows(list(places)):
        way = route(places[room], places[other])
        axes.plot(*zip(*way[:-1]), color=LINE, linewidth=1.2, zorder=1)
        axes.annotate('', way[-1], way[-2], zorder=1, arrowprops={
            'arrowstyle': '->', 'color': LINE, 'linewidth': 1.2, 'shrinkA': 0.0, 'shrinkB': 0.0})
    axes.set_xlim(-1.8 * WIDTH, 1.8 * WIDTH)
    axes.set_ylim(-0.7, FLOOR * len(layers) - 0.8)
    axes.set_axis_off()
    return figure


if __name__ == '__main__':
    picture().savefig(ROOT / 'doc' / 'pictures' / 'architecture.png')
