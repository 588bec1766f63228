# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop simulate``: run a scene offline, under constant torques, into a CSV file."""

import argparse
from contextlib import contextmanager
import math
from pathlib import Path
import sys
import warnings

from .command import (
    Argument, checked_torques, Command, complain, FAILED, Group, mapping, MOTION, OVERWRITE,
    positive, reading_options, require_free, SCENE, scene_of, SET, TABLE, TORQUE, UsageError)
from ..mechanism.errors import InaccuracyWarning, SimulationError
from ..recording.cost import allowance, probe
from ..recording.rows import write_scene
from ..recording.run import columns, ErrorEstimate, headings, Report, run
from ..scene.integrators import ADAPTIVE, AUTO, INTEGRATORS, STABILISATIONS
from ..scene.records import SMALLEST_STEP
from ..simulation.monitor import energy_in_words
from ..simulation.rollout_run import TIME_ROUNDING
from ..simulation.signals import program_watch
from ..simulation.simulation import Simulation
from ..visual.progress import announced, progress_to

STANDARD_OUTPUT = '-'
# Simulated time up to which the error is estimated unless set otherwise [s].
LONGEST_ESTIMATED = 10.0
# Beyond it the numbers of rows are not exact.
MOST_ROWS = 1e15
LOADING = 'Loading; code is generated for a mechanism that is new ...'


def _run(arguments):
    simulation, torque = _prepared(arguments)
    estimated = arguments.error_estimate or (
        arguments.error_estimate is None and arguments.duration <= LONGEST_ESTIMATED)
    if arguments.dry_run:
        return _print_cost(simulation, torque, estimated, arguments)
    report, failure = Report(), None
    estimate = ErrorEstimate(simulation) if estimated else None
    all_forces = arguments.forces == 'all'
    with _opened(arguments.output) as write, \
            program_watch.noting() as received, progress_to(
                arguments.duration, 's', simulation.scene.name) as show, \
            warnings.catch_warnings():
        # The summary has it.
        warnings.simplefilter('ignore', InaccuracyWarning)

        def on_row(values):
            write(','.join(map(repr, values)))
            show(values[0])

        # A device or pipe has nothing beside it.
        if _is_file(arguments.output):
            write_scene(arguments.output, simulation.scene)
        write(','.join(headings(simulation, all_forces, arguments.costs)))
        try:
            run(simulation, arguments.duration, arguments.rate, torque, report=report,
                on_row=on_row, keep_going=lambda: not received, all_forces=all_forces,
                estimate=estimate, costs=arguments.costs)
        except SimulationError as error:
            failure = error
    if failure is not None:
        complain(arguments, failure)
    elif not report.finished:
        complain(arguments, f'interrupted at t = {report.time:.6g} s of {arguments.duration:g} s')
    summary = _summary(simulation, report, arguments, estimate)
    # The standard output belongs to the rows where they go there.
    print(summary, file=sys.stderr if arguments.output == STANDARD_OUTPUT else sys.stdout)
    if _is_file(arguments.output):
        # Names of files are not always text.
        _report_path(arguments.output).write_text(summary + '\n' + (
            f'  FAILED    {failure}\n  Rows after t = {report.time:.9g} s are not to be trusted.\n'
            if failure else '' if report.finished else
            f'  ended     at t = {report.time:.9g} s of {arguments.duration:g} s\n'),
            encoding='utf-8', errors='backslashreplace')
    return 128 + received[0] if received else FAILED if failure else 0


def _print_cost(simulation, torque, estimated, arguments):
    """Print the predicted cost of the run."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', InaccuracyWarning)
        costs = probe(simulation, arguments.duration, arguments.rate, torque, estimated)
    run_cost, _ = costs
    print('\n'.join(f'{simulation.scene.name}: {cost}' for cost in costs))
    if not run_cost.failure:
        print(f'  with rows{" and the run that gives the error" if estimated else ""} '
              f'{run_cost.whole:.2g} s; {run_cost.share:.2%} of real time')
    if simulation.scene.method.by_budget:
        print(f'  {allowance(simulation.scene.method.budget, costs)}')
    return FAILED if run_cost.failure else 0


def _prepared(arguments):
    """Return the simulation and the torques; errors here are the user's."""
    torque = mapping(arguments.torque, '--torque')
    if arguments.duration < SMALLEST_STEP:
        raise UsageError(f'--duration: expected at least {SMALLEST_STEP:g} s, got '
                         f'{arguments.duration:g}')
    if arguments.duration * arguments.rate > MOST_ROWS:
        raise UsageError(f'--rate: expected at most {MOST_ROWS:g} rows in all, got '
                         f'{arguments.rate:g} a second for {arguments.duration:g} s')
    for option in ('accuracy', 'budget'):
        if getattr(arguments, option) is not None:
            if arguments.integrator not in (None, AUTO):
                raise UsageError(f'--{option}: expected it without --integrator, got both')
            arguments.integrator = AUTO
    if arguments.output not in (None, STANDARD_OUTPUT):
        path = Path(arguments.output)
        # Devices and pipes have names without an ending.
        device = path.exists() and not path.is_file()
        require_free(arguments, path, endings=() if device else TABLE)
    scene = scene_of(arguments)
    integrator = arguments.integrator or scene.method.integrator
    if arguments.tolerance is not None and (
            integrator == AUTO or INTEGRATORS[integrator].kind != ADAPTIVE):
        raise UsageError('--tolerance: expected it with an error-controlled integrator, such as '
                         f'--integrator dop853, got {integrator}')
    with announced(LOADING):
        simulation = checked_torques(
            arguments.scene, scene, torque, lambda scene: Simulation.from_scene(
                scene, step_size=arguments.step_size, integrator=arguments.integrator,
                stabilisation=arguments.stabilisation, tolerance=arguments.tolerance,
                accuracy=arguments.accuracy, budget=arguments.budget))
    return simulation, torque


@contextmanager
def _opened(output):
    """Yield a function that writes a line, whole, to a file, to the standard output, nowhere."""
    if output is None:
        yield lambda line: None
    elif output == STANDARD_OUTPUT:
        yield print
    else:
        try:
            # Line by line, so that whatever ends the run leaves whole rows.
            with open(output, 'w', buffering=1, encoding='ascii') as file:
                yield lambda line: file.write(line + '\n')
        except OSError as error:
            raise OSError(f'cannot write {output}: {error.strerror}') from None


def _is_file(output):
    """Return whether the rows are in a file, which others may be written beside."""
    return output not in (None, STANDARD_OUTPUT) and Path(output).is_file()


def _report_path(output):
    """Return the file of the summary, beside that of the rows."""
    return Path(f'{output}.report.txt')


def _summary(simulation, report, arguments, estimate):
    method = simulation.scene.method
    change = report.last_energy - report.first_energy
    work = ' (work of the torques included)' if any(simulation.effort) else ''
    share = report.cpu_time / report.time if report.time else 0.0
    cost = simulation.report()
    lines = [
        f'{simulation.scene.name}: simulated {report.time:.9g} s {_resolution(method, arguments)} '
        f'({method.integrator}, {method.stabilisation})',
        f'  closure   largest error of the loops {report.largest_closure:.2g} m or rad',
        f'  energy    {report.first_energy:.9g} J at the start, changed by {change:+.3g} J{work}; '
        f'balance: {energy_in_words(cost.energy_error, cost.energy_moved)}',
        f'  CPU time  {report.cpu_time:.3g} s, {share:.2%} of real time; '
        f'{1e6 * cost.time_per_step:.3g} us per step',
    ]
    if math.isfinite(cost.budget):
        lines.insert(1, f'  budget    {cost.budget:g} of real time: accuracy {cost.accuracy:g} at '
                        f'the end, the best that it allows')
    if cost.branch_undecided:
        lines.insert(1, '  error     unknown: on which branch the run is, is undecided')
    elif math.isfinite(report.error):
        lines.insert(1, f'  error     at most about {report.error:.2g} rad or m, by a second run '
                        f'with {estimate.method}')
    elif estimate is not None and report.rows:
        lines.insert(1, '  error     unknown: the second, finer run for its estimate failed')
    if math.isfinite(cost.local_error):
        lines.insert(2, f'  steps     local error {cost.local_error:.2g} rad or m in the worst '
                        f'step checked')
    shared = simulation.data.shared_forces
    if shared:
        lines.append(f'  forces    of {", ".join(shared)} are not unique, as equations repeat '
                     'others: the least are written')
    lines += [f'  WARNING   {finding}' for finding in cost.findings]
    if arguments.output not in (None, STANDARD_OUTPUT):
        lines.append(f'  output    {arguments.output}: {report.rows} '
                     f'row{"s" if report.rows != 1 else ""} of '
                     f'{len(columns(simulation, arguments.forces == "all", arguments.costs))} '
                     'columns')
    return '\n'.join(lines)


def _resolution(method, arguments):
    """Return the steps in words; one that ends at a row may be shorter."""
    if INTEGRATORS[method.integrator].kind == ADAPTIVE:
        key = 'budget' if method.by_budget else 'accuracy' if method.integrator == AUTO else (
            'tolerance')
        return f'with {key} {getattr(method, key):g}'
    steps_in_a_row = 1.0 / (arguments.rate * method.step_size)
    if steps_in_a_row < 1.0 - TIME_ROUNDING:
        return (f'in steps of {1.0 / arguments.rate:g} s, from row to row, '
                f'instead of {method.step_size:g} s')
    whole = abs(steps_in_a_row - round(steps_in_a_row)) < TIME_ROUNDING
    return f'in steps of {"" if whole else "at most "}{method.step_size:g} s'


COMMAND = Command(
    name='simulate',
    summary='simulate a scene offline and write its motion and forces to a file',
    description="""\
Simulate a scene from its start, under constant torques, as fast as possible.

Columns of the output: time, position.JOINT, velocity.JOINT, acceleration.JOINT
and effort.JOINT of every joint; force.CUT.x and force.CUT.y of every cut joint
(and force.CUT.torque of a fixed or prismatic one), which body B exerts on
body A, in world axes; with --forces all force.JOINT.x, .y and .torque of all
joints of the tree, too, which the parent exerts on the child;
motion.NAME.force and .power of every prescribed motion, NAME being that of the
effect (motion_JOINT of --motion JOINT=...), and the force that of effort.JOINT;
point.NAME.x and point.NAME.y of every named point; effect.NAME.READING of every
other effect that is on, such as normal_force of a contact; closure, the largest error
of the loops; energy, kinetic and potential; with --costs error, largest of a
joint coordinate by the second run (of an orientation the angle), accuracy that
is kept, evaluation_rate and cpu_share per simulated second since the row
before. In space force.CUT and force.JOINT
have .z, and .torque_x, .torque_y and .torque_z for .torque, point.NAME has .z.
.least is behind the name of a force that is not unique, as closure equations
repeat others: of those possible it is the least.
SI units and radians; numbers with all their digits. An existing file is not
replaced unless asked for. Ctrl-C leaves all rows so far. Beside FILE are written
FILE.scene.json, the scene with all overrides, from which plot, animate and view
draw the rows, and FILE.report.txt, the summary.
""",
    examples=(
        'simulate three_rrr',
        'simulate three_rrr --torque theta_1=5 --torque theta_6=-3 --output run.csv',
        'simulate carpet_scraper --motion theta_1=4.7124*t --output run.csv',
        'simulate delta_robot --duration 600 --dry-run',
        'simulate four_bar --set mechanism.bodies.crank.mass=2',
        'simulate carpet_scraper --duration 600 --step-size 5e-4 --rate 10 --output long.csv'),
    arguments=(
        SCENE,
        *reading_options(short=False),
        Group(
            'what to do',
            Argument('--duration', type=positive, default=2.0, metavar='SECONDS',
                     help='simulated time (default: 2)'),
            TORQUE, MOTION, SET,
            Argument('--output', metavar='FILE.csv',
                     help='where to write a row of numbers for each instant; - is the standard '
                          'output (default: no rows, only a summary)'),
            Argument('--rate', type=positive, default=100.0, metavar='HZ',
                     help='rows per simulated second, at exact multiples of 1 / HZ (default: '
                          '100)'),
            OVERWRITE,
            Argument('--forces', choices=('cuts', 'all'), default='cuts',
                     help='whose forces are written: those of the cut joints, or of all joints '
                          '(default: cuts)'),
            Argument('--costs', action='store_true',
                     help='write what accuracy costs, too: the error of each row, and '
                          'evaluations and CPU time per simulated second'),
            Argument('--dry-run', action='store_true',
                     help='print what the run will cost, from a probe of its first part that '
                          'takes a second or so, and write nothing'),
            Argument('--error-estimate', action=argparse.BooleanOptionalAction,
                     help='run a second, finer simulation that estimates the error (default: up '
                          f'to {LONGEST_ESTIMATED:g} s)')),
        Group(
            'how to compute it (default: as the scene says)',
            Argument('--step-size', type=positive, metavar='SECONDS'),
            Argument('--integrator', choices=INTEGRATORS),
            Argument('--tolerance', type=positive, metavar='ERROR',
                     help='local error that an error-controlled integrator named here or in the '
                          'scene allows per step'),
            Argument('--accuracy', type=positive, metavar='ERROR',
                     help='error of positions that the integrator auto keeps within a second '
                          '[rad or m]; with --budget, at the start'),
            Argument('--budget', type=positive, metavar='SHARE',
                     help='computing time per simulated second that the integrator auto may '
                          'take: it keeps the best accuracy that this allows'),
            Argument('--stabilisation', choices=STABILISATIONS,
                     help='how the loops are kept closed'))),
    run=_run)
