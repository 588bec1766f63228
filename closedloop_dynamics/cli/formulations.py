# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop formulations``: time and rounding error of formulations over size."""

from .command import (
    Argument, Command, directory_options, free_paths, read_scene, READING_OPTIONS, whole)
from ..studies import formulations_report
from ..studies.formulations import SIZES, study_formulations, study_scenes
from ..visual.progress import parts_bar

FILES = ('formulations.csv', 'formulations.png')


def _run(arguments):
    paths = free_paths(arguments, *FILES)
    scenes = [read_scene(name, arguments) for name in arguments.scene]
    with parts_bar('mechanisms', 'formulations') as progress:
        rows = study_scenes(scenes, progress) if scenes else study_formulations(
            arguments.largest, arguments.quick, progress)
    print(formulations_report.table(rows))
    if not scenes:
        print(f'\n{formulations_report.growth_text(rows)}')
    if paths:
        arguments.output.mkdir(parents=True, exist_ok=True)
        formulations_report.write(rows, *paths)
        print('\n' + '\n'.join(map(str, paths)))
    return 0


COMMAND = Command(
    name='formulations',
    summary='measure time and rounding error of the formulations as mechanisms grow',
    description="""\
Measure one evaluation of accelerations and constraint forces by the subsystem-
level method, by the system-level and by the augmented formulation: its CPU time
without the call from Python, and its largest rounding error against extended
precision, relative to the largest value. On the 3-RRR and the carpet scraper,
on ladders of N four-bar loops and on chains of N links with one cut joint; the
dense formulations end where one evaluation would take more than a second.

With scenes, in the plane or in space, with all their effects, as they move after
0.3 s without torques: time, and largest relative difference from the median of
all formulations, which solve the same equations of motion in different ways.
""",
    epilog="""\
examples:
  closedloop formulations --quick
  closedloop formulations --output results
  closedloop formulations stewart_platform delta_robot
""",
    arguments=(
        Argument('scene', metavar='SCENE', nargs='*',
                 help='scenes to measure on, by name or file (default: two shipped mechanisms, '
                      'ladders and chains that grow)'),
        *READING_OPTIONS,
        *directory_options(' and the picture '.join(FILES)),
        Argument('--largest', type=whole(1), default=max(SIZES), metavar='N',
                 help=f'no ladder or chain larger than this (default: {max(SIZES)})'),
        Argument('--quick', action='store_true', help='fewer and smaller ones')),
    run=_run)
