# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop accuracy``: error against computing time, on a scene of one's own."""

import warnings

from .command import (
    Argument, checked_torques, Command, directory_options, free_paths, mapping, MOTION, OneOf,
    positive, READING_OPTIONS, SCENE, scene_of, SET, TORQUE)
from ..mechanism.errors import InaccuracyWarning
from ..studies import accuracy_report
from ..studies.accuracy import study_accuracy
from ..studies.advice import for_budget, for_target
from ..visual.progress import parts_bar

TARGET = 1e-6


def _run(arguments):
    scene = scene_of(arguments)
    torque = mapping(arguments.torque, '--torque')
    paths = free_paths(arguments, *(
        f'{scene.name}_accuracy.{ending}' for ending in ('csv', 'png')))
    # Fails at once where the study would fail only after a while.
    checked_torques(arguments.scene, scene, torque)
    # The table has the error of each method.
    warnings.simplefilter('ignore', InaccuracyWarning)
    with parts_bar('parts', scene.name) as progress:
        study = study_accuracy(scene, torque, arguments.duration, arguments.quick,
                               progress=progress)
    print(f'{accuracy_report.title(study)}\n{study.reference.description}\n')
    print(accuracy_report.table(study))
    if paths:
        arguments.output.mkdir(parents=True, exist_ok=True)
        accuracy_report.write(study, *paths)
        print('\n' + '\n'.join(map(str, paths)))
    advice = (for_target(study, arguments.target or TARGET) if arguments.budget is None
              else for_budget(study, arguments.budget))
    print(f'\n{advice.text}')
    return 0


COMMAND = Command(
    name='accuracy',
    summary='measure error and cost of every method on a scene, and advise',
    description="""\
Measure errors and costs of all methods on a scene, under constant torques, over
step sizes or tolerances: every integrator, and every way to keep the loops
closed with RK4. The reference is computed first, and again with another
integrator and with independent coordinates; the larger
of the two differences is its own error. Where they differ by more than 1e-6, as
in chaotic motion, or where no two methods go on, the comparison ends.

Columns of the table: largest errors, over 100 instants, of positions [rad or
m], of orientations as rotation angles, of velocities [rad/s or m/s] and forces
at the cut joints [N or N m]; largest closure error [m or rad]; largest change of
energy less the work done [J]; evaluations of the accelerations, and CPU time,
for one simulated second (median of repeats, in turn). A method that fails
has the reason in its row. Then the cheapest setting that holds a target, as lines to paste
into a scene.
""",
    examples=(
        'accuracy three_rrr --quick',
        'accuracy three_rrr --torque theta_1=5 --duration 2 --output results',
        'accuracy carpet_scraper --target 1e-9',
        'accuracy stewart_platform --quick',
        'accuracy carpet_scraper --motion theta_1=4.7124*t',
        'accuracy my_robot.urdf --duration 0.5',
        'accuracy my/scene.yaml --budget 0.05'),
    arguments=(
        SCENE, *READING_OPTIONS,
        *directory_options('SCENE_accuracy.csv and the diagram SCENE_accuracy.png'),
        Argument('--duration', type=positive, default=1.0, metavar='SECONDS',
                 help='simulated time (default: 1)'),
        TORQUE, MOTION, SET,
        Argument('--quick', action='store_true',
                 help='fewer and coarser settings: half a minute instead of two'),
        OneOf(
            Argument('--target', type=positive, metavar='ERROR',
                     help='print the cheapest setting whose positions are off by no more [rad or '
                          f'm] (default: {TARGET:g}, unless --budget is given)'),
            Argument('--budget', type=positive, metavar='SHARE',
                     help='print the most accurate setting that takes no more than this share of '
                          'real time, such as 0.05'))),
    run=_run)
