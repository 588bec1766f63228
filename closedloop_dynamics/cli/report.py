# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop report``: the key figures of a mechanism, on one page."""

import time

from .command import (
    Argument, Command, mapping, Output, positive, reading_options, SCENE, scene_to_change, SET,
    UsageError)
from .kinematics import drive_options, driven_run, ending
from ..recording.design_report import write_report
from ..visual.progress import announced, progress_to


def _run(arguments):
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
        text = write_report(arguments.output, scene, run, table, arguments.tolerance,
                            mapping(arguments.set, '--set'), spent)
    print(text)
    print(arguments.output)
    return ending(arguments, run)


COMMAND = Command(
    name='report',
    summary='what a designer asks of a mechanism, on one page',
    description="""\
Drive a mechanism over a cycle and write one HTML page that needs no other file (print
it for a PDF): pictures, degrees of freedom, Grashof class and where a four-bar linkage
folds, strokes, dwells and time ratios, transmission angle, drive torque and power, work
per cycle, the largest force in every joint with its place, shaking force and moment,
sensitivity to every length, and tolerances.
""",
    epilog="""\
examples:
  closedloop report four_bar --output four_bar.html
  closedloop report four_bar --speed 20 --set mechanism.bodies.coupler.mass=2 --output heavy.html
  closedloop report slider_crank --drive crank_joint=0:360deg:721 --output slider.html
""",
    arguments=(
        SCENE,
        *reading_options(short=False),
        *drive_options(' (default: one turn of the one actuated joint, or from limit to limit)'),
        SET,
        Argument('--tolerance', type=positive, default=1e-4, metavar='LENGTH',
                 help='of every length, plus or minus [m]; three standard deviations (default: '
                      '1e-4)'),
        Output('--output', 'FILE.html', 'where to write the page', ('.html',), required=True)),
    run=_run)
