# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop benchmark``: the benchmark problems that the community publishes, solved."""

import platform
import warnings

from .command import Argument, Command, directory_options, free_paths, positive, UsageError, whole
from ..mechanism.errors import InaccuracyWarning
from ..studies.published_benchmarks import ACCURACIES, PROBLEMS, processor, REPEATS, solve
from ..visual.progress import announced
from ..visual.tables import seconds, short, text_table, write_csv

SUMMARY = 'benchmark.csv'


def _run(arguments):
    names = [problem.name for problem in PROBLEMS]
    for name in arguments.problem:
        if name not in names:
            raise UsageError(f'expected problems of {", ".join(names)}, got {name!r}')
    problems = [one for one in PROBLEMS if one.name in (arguments.problem or names)]
    accuracies = arguments.accuracy or ACCURACIES
    paths = free_paths(arguments, SUMMARY, *(f'{one.name}_results.txt' for one in problems))
    # The table has the error.
    warnings.simplefilter('ignore', InaccuracyWarning)
    with announced('Solving the problems ...'):
        solutions = [solve(problem, accuracy, arguments.repeats)
                     for problem in problems for accuracy in accuracies]
    rows = [(one.problem.name, one.problem.scene, one.problem.duration, one.accuracy,
             one.energy_error, one.position_error, one.cpu_time) for one in solutions]
    print(text_table(
        ('problem', 'scene', 'duration [s]', 'accuracy', 'energy error [J]',
         'position error [rad]', 'CPU time'),
        [(name, scene, f'{duration:g}', f'{accuracy:g}', short(energy), short(position),
          seconds(cpu_time))
         for name, scene, duration, accuracy, energy, position, cpu_time in rows]))
    print(f'{processor()}, one thread, {platform.system()} {platform.release()}; CPU time of the '
          'whole run without its start, with the outputs')
    if paths:
        arguments.output.mkdir(parents=True, exist_ok=True)
        write_csv(paths[0], ('problem', 'scene', 'duration', 'accuracy', 'energy_error',
                             'position_error', 'cpu_time'), rows)
        # The last solution of each problem, that of the accuracy named last.
        last = {one.problem.name: one for one in solutions}
        for path, one in zip(paths[1:], last.values()):
            one.write(path)
        print('\n' + '\n'.join(map(str, paths)))
    return 0


COMMAND = Command(
    name='benchmark',
    summary='solve the benchmark problems of the IFToMM library: error and CPU time',
    description="""\
Solve problems A01 to A05 of the IFToMM library of computational benchmark problems
(pendulum, four-bars that pass singular positions, Andrews' squeezer, Bricard's linkage,
stiff flyball governor) by the default method. Columns: the largest error of the energy
balance over the outputs, which the library compares; the largest error of positions,
where the motion is known: in closed form for A01 and A02, from the Test Set for IVP
Solvers at 0.03 s for A03, to 1.4e-9 rad; the CPU time of a run, the median of repeats.
""",
    examples=(
        'benchmark',
        'benchmark A03 --accuracy 1e-9',
        'benchmark --output results'),
    arguments=(
        Argument('problem', metavar='PROBLEM', nargs='*',
                 help=f'which ones: {", ".join(one.name for one in PROBLEMS)} (default: all)'),
        Argument('--accuracy', type=positive, action='append', metavar='ERROR',
                 help='of the default method [rad or m within a second]; may be repeated '
                      f'(default: {", ".join(f"{one:g}" for one in ACCURACIES)})'),
        Argument('--repeats', type=whole(1), default=REPEATS, metavar='NUMBER',
                 help=f'runs that the CPU time is the median of (default: {REPEATS})'),
        *directory_options(f'{SUMMARY} and PROBLEM_results.txt, the motion in the columns that '
                           'the library collects')),
    reads_scenes=False,
    run=_run)
