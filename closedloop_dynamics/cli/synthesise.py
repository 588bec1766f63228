# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop synthesise``: linkages through precision positions."""

from argparse import ArgumentTypeError
import math
from pathlib import Path

import numpy as np

from .command import (
    Argument, Command, directory_options, free_paths, positive, UsageError, whole)
from ..mechanism.csv_columns import read_columns
from ..mechanism.fields import FieldError
from ..scene.text import write_scene
from ..visual.progress import announced
from ..visual.tables import text_table

PATH, FUNCTION, MOTION = 'path', 'function', 'motion'
COLUMNS = {PATH: 2, FUNCTION: 2, MOTION: 3}
PICTURE = 'paths.png'
# Poses of the crank of which a path is drawn.
POSES = 181


def _pins(word):
    try:
        return np.reshape([float(one) for one in word.split(',')], (2, 2))
    except ValueError:
        raise ArgumentTypeError(f'expected four numbers X1,Y1,X2,Y2, got {word!r}') from None


def _run(arguments):
    # Here, as SciPy's optimisers take long to load.
    from ..studies import synthesis
    try:
        columns = np.array(read_columns(arguments.positions, Path(), COLUMNS[arguments.task]))
    except FieldError as error:
        raise UsageError(error) from None
    names = [f'linkage_{k}' for k in range(1, arguments.most + 1)]
    files = free_paths(arguments, *(f'{name}.yaml' for name in names), PICTURE)
    options = {'kind': arguments.linkage, 'starts': arguments.starts}
    try:
        with announced('Searching linkages ...'):
            if arguments.task == PATH:
                found = synthesis.path_generation(columns.T, **options)
            elif arguments.task == FUNCTION:
                found = synthesis.function_generation(*columns, base=arguments.base, **options)
            else:
                found = synthesis.motion_generation(
                    columns[:2].T, columns[2], pins=arguments.pins, **options)
    except synthesis.SynthesisError as error:
        raise UsageError(error) from None
    shown = dict(zip(names, found.linkages))
    bars = ('crank', 'coupler') if arguments.linkage == synthesis.SLIDER_CRANK else (
        'base', 'crank', 'coupler', 'rocker')
    print(text_table(
        ('', *(f'{bar} [m]' for bar in bars), 'largest error', 'transmission angle [deg]'),
        [(name, *(f'{length:.6g}' for length in one.lengths), f'{one.error:.2g}',
          f'{math.degrees(one.transmission):.1f}') for name, one in shown.items()]))
    print(f'{len(found.linkages)} of {found.found} linkages take the positions in their order; '
          f'{found.defective} change branch or order and are left out')
    if files:
        arguments.output.mkdir(parents=True, exist_ok=True)
        for (name, one), path in zip(shown.items(), files):
            write_scene(one.scene(name, f'{arguments.task} through {columns.shape[1]} positions'),
                        path)
            print(path)
        _draw(shown, columns if arguments.task != FUNCTION else None, files[-1])
        print(files[-1])
    return 0


def _draw(linkages, columns, path):
    """Draw the paths of the points between the first and the last position."""
    from ..visual import pictures
    from ..visual.views import PLANE
    traced = {}
    for name, one in linkages.items():
        places = one.at(np.linspace(0.0, one.turns[-1], POSES))[2]
        traced[name] = {'traced': np.column_stack([places.real, places.imag])}
    pictures.overlaid_paths(
        traced, PLANE, 'Paths of the coupler points',
        [] if columns is None else [columns[:2].T]).savefig(path)


COMMAND = Command(
    name='synthesise',
    summary='four-bars and slider-cranks through precision positions',
    description="""\
Find four-bars or slider-cranks whose coupler point goes through places (path, a file with lines
x,y), whose coupler goes through poses (motion, x,y,angle), or whose output follows the crank
(function, angle of the crank, angle of the rocker or stroke of the slider). Lengths in m, angles
in rad. Up to five positions are met exactly, in general, more of them as nearly as can be.
Linkages that take the positions in another order, change their branch or lock between them are
left out; where none remains, the exit code is 2.
""",
    examples=(
        'synthesise path places.csv --output found',
        'synthesise motion poses.csv --pins=-0.05,0.25,0.1,0.3',
        'synthesise function angles.csv --linkage slider_crank'),
    arguments=(
        Argument('task', choices=tuple(COLUMNS), help='what the positions are of'),
        Argument('positions', metavar='FILE.csv', help='a position in a line [m, rad]'),
        Argument('--linkage', choices=('four_bar', 'slider_crank'), default='four_bar',
                 help='(default: %(default)s)'),
        Argument('--pins', metavar='X1,Y1,X2,Y2', type=_pins,
                 help='moving pins of a four-bar in the first of three poses [m]'),
        Argument('--base', metavar='M', type=positive, default=1.0,
                 help='distance of the pivots of a four-bar for a function [m] (default: '
                      '%(default)s)'),
        Argument('--starts', metavar='N', type=whole(1), default=150,
                 help='of the search (default: %(default)s)'),
        Argument('--most', metavar='N', type=whole(1), default=5,
                 help='linkages that are printed and written (default: %(default)s)'),
        *directory_options(f'linkage_1.yaml, ... and {PICTURE}')),
    run=_run,
    reads_scenes=False)
