# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop report``: the key figures of a mechanism, on one page."""

from argparse import ArgumentTypeError
import time

from .command import (
    Argument, Command, mapping, Output, reading_options, SCENE, scene_to_change, SET, UsageError)
from .kinematics import drive_options, driven_run, ending, value_of
from ..mechanism.extras import require
from ..recording.design import TOLERANCES
from ..recording.design_report import write_report
from ..visual.progress import announced, progress_to


def _run(arguments):
    require('matplotlib')
    scene = scene_to_change(arguments)
    begin = time.process_time()
    with announced('Following the branch ...'):
        run = driven_run(arguments, scene)
    if len(run.time) < 3:
        raise UsageError(f'--drive: expected three poses or more, got {len(run.time)}'
                         f'{f"; {run.end.reason}" if run.end else ""}')
    with progress_to(len(run.time) - 1, 'poses', scene.name) as show:
        table = run.table(show)
    spent = time.process_time() - begin
    with announced('Finding sensitivities and drawing ...'):
        try:
            text = write_report(arguments.output, scene, run, table,
                                mapping(arguments.tolerance, '--tolerance'),
                                mapping(arguments.set, '--set'), spent)
        except ValueError as error:
            raise UsageError(f'--{error}') from None
    print(text)
    print(arguments.output)
    return ending(arguments, run)


def _tolerance(text):
    """Convert ``VALUE``, of lengths, or ``WHAT=VALUE``, with units."""
    what, equals, value = text.rpartition('=')
    number = value_of(value)
    if number is None or not number > 0.0 or bool(equals) != bool(what):
        raise ArgumentTypeError(f'expected a finite number > 0, or WHAT=NUMBER, got {text!r}')
    return what or 'length', number


COMMAND = Command(
    name='report',
    summary='what a designer asks of a mechanism, on one page',
    description="""\
Drive a mechanism over a cycle and write one HTML page that needs no other file (print
it for a PDF): pictures, degrees of freedom, Grashof class and where a four-bar linkage
folds, strokes, dwells, time ratios and a timing chart, transmission angles, mechanical
advantage and dead centres, drive torque and power, work per cycle, the largest force in
every joint with its place, its hodograph and load spectrum, shaking force and moment,
sensitivity to every length, and tolerances.
""",
    examples=(
        'report four_bar --output four_bar.html',
        'report four_bar --speed 20 --set mechanism.bodies.coupler.mass=2 --output heavy.html',
        'report slider_crank --drive crank_joint=0:360deg:721 --output slider.html'),
    arguments=(
        SCENE,
        *reading_options(short=False),
        *drive_options(' (default: one turn of the one actuated joint, or from limit to limit)'),
        SET,
        Argument('--tolerance', type=_tolerance, action='append', default=[],
                 metavar='[WHAT=]VALUE',
                 help='plus or minus, three standard deviations: of every length [m, mm], or, '
                      'with WHAT=, of a kind (length, lead, angle, ratio) or of one parameter; '
                      'may be repeated (default: ' + ', '.join(
                          f'{one.name}={one.values:g} {one.unit}'
                          for one in TOLERANCES.values()) + ')'),
        Output('--output', 'FILE.html', 'where to write the page; FILE.pdf: a document of the '
               'same', ('.html', '.pdf'), required=True)),
    run=_run)
