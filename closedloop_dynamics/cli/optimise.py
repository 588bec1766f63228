# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop optimise``: the numbers of a machine that make an expression least."""

from dataclasses import replace
import math
from pathlib import Path

import numpy as np

from .command import (
    Argument, Command, complain, directory_options, free_paths, Group, interrupted, mapping,
    READING_OPTIONS, require_writable, SCENE, scene_to_change, SET, UsageError, whole)
from .kinematics import drive_options, interval, paced
from ..mechanism.csv_columns import read_columns
from ..mechanism.errors import AssemblyError
from ..mechanism.fields import at, FieldError
from ..scene.edit import MECHANISM, write_with_numbers
from ..scene.key_paths import numbers
from ..scene.loading import load_scene
from ..scene.text import write_scene
from ..simulation.signals import program_watch
from ..studies.objectives import places_named
from ..studies.optimise import aims_of, FRONT, OptimumFileError, POSES, problem_of, solve, STARTS
from ..studies.quantities import Infeasible
from ..visual.progress import announced, parts_bar
from ..visual.tables import short, text_table, write_csv

OPTIMISED, RESULTS, PATHS, FRONT_TABLE, PICTURE = (
    'optimised.yaml', 'results.jsonl', 'paths.png', 'front.csv', 'front.png')
# A number this near to the end of its range, of the range, is at it.
AT_END = 1e-6
# Relative difference between an aim of the file that was written and its optimum.
SAME = 1e-6
MOST_REASONS = 5
DIGITS = '.6g'
# Poses at least of paths that are drawn.
FINE = 361


def _run(arguments):
    if len(arguments.minimise) > 2:
        raise UsageError(f'--minimise: expected it once or twice, got {len(arguments.minimise)}')
    if arguments.resume and arguments.output is None:
        raise UsageError('--resume: expected it with --output')
    two = len(arguments.minimise) == 2
    if two and arguments.front < 3:
        raise UsageError(f'--front: expected 3 machines or more, got {arguments.front}')
    directory = arguments.output
    if not arguments.resume:
        scenes = [OPTIMISED] if not two else _front_names(arguments.front)
        free_paths(arguments, RESULTS, PATHS, *scenes, *(
            MECHANISM.format(Path(name).stem) for name in scenes),
            *([FRONT_TABLE, PICTURE] if two else []))
    if directory is not None:
        directory.mkdir(parents=True, exist_ok=True)
        require_writable(directory, '--output')
    scene = scene_to_change(arguments)
    with program_watch.noting() as received:
        problem = _problem(arguments, scene)
        with parts_bar('searches', scene.name) as show:
            try:
                optimum = solve(
                    problem, arguments.starts, arguments.front,
                    None if directory is None else directory / RESULTS, arguments.resume,
                    arguments.workers, show, lambda: not received)
            except (FieldError, OptimumFileError) as error:
                raise UsageError(str(error)) from None
    best = optimum.best
    print(_summary(optimum))
    if not optimum.finished:
        return interrupted(arguments, received[0], directory is not None)
    if best is None or (two and not optimum.front):
        return complain(arguments, 'no machine was found that meets all requirements')
    if directory is None:
        return 0
    machines = {OPTIMISED: best} if not two else dict(
        zip(_front_names(len(optimum.front)), optimum.front))
    written = [file for name, one in machines.items()
               for file in _write(arguments, optimum, one, directory / name)]
    try:
        with announced('Drawing ...'):
            written += _draw(optimum, machines, directory)
    except Infeasible as error:
        raise UsageError(f'--drive: expected more poses, as between them {error}') from None
    print('\n'.join(map(str, [*written, directory / RESULTS])))
    return 0


def _front_names(count):
    """Return the names of the scenes of a front."""
    return [f'front_{number}.yaml' for number in range(1, count + 1)]


def _problem(arguments, scene):
    """Return the problem of a command line."""
    count = 2 if scene.mechanism.planar else 3
    try:
        drives, poses, speed = paced(arguments, scene, POSES)
    except AssemblyError as error:
        raise UsageError(f'{scene.name}: {error}') from None
    except ValueError as error:
        raise error if isinstance(error, UsageError) else UsageError(
            f'--drive: {error}') from None
    texts = [*arguments.minimise, *arguments.subject_to]
    try:
        with at('distance'):
            paths = {name: np.transpose(read_columns(name, Path(), count))
                     for text in texts for name in places_named(text)}
        return problem_of(
            scene, mapping(arguments.vary, '--vary'), arguments.minimise, arguments.subject_to,
            drives, poses=poses, speed=speed, branch=arguments.branch, seed=arguments.seed,
            paths=paths)
    except FieldError as error:
        option = str(error).partition(':')[0]
        raise UsageError(f'--{str(error).replace("subject_to", "subject-to")}' if option in (
            'minimise', 'subject_to', 'distance') else f'--vary: {error}') from None
    except ValueError as error:
        raise UsageError(f'--drive: {error}') from None


def _summary(optimum):
    """Return the result as text."""
    problem, best = optimum.problem, optimum.best
    all_found = optimum.starts.values()
    lines = [f'{problem.scene.name}: {len(optimum.starts)} searches, '
             f'{sum(one.evaluations for one in all_found)} machines driven, '
             f'{sum(one.gradients for one in all_found)} of them with derivatives']
    if optimum.refused:
        lines.append(f'  {sum(optimum.refused.values())} more could not be assembled or driven:')
        lines += [f'  {count:8}  {reason}'
                  for reason, count in optimum.refused.most_common(MOST_REASONS)]
    if problem.before is None:
        lines.append(f'  before: {problem.without}')
    if best is None:
        return '\n'.join(lines)
    known = numbers(problem.scene)
    before = problem.before or [math.nan] * len(problem.aims)
    shown = optimum.front or [best]
    header = ['', 'before', *(['after'] if len(shown) == 1 else map(str, range(
        1, len(shown) + 1))), 'range']
    rows = [[one.text, short(value, DIGITS), *(short(each.aims[k], DIGITS) for each in shown), '']
            for k, (one, value) in enumerate(zip(problem.aims, before))]
    rows += [[one.text, '', *('met' for _ in shown), ''] for one in problem.requirements]
    for k, one in enumerate(problem.variables):
        values = [each.values[k] for each in shown]
        rows.append([one.key, short(known[one.key], DIGITS), *(
            short(value, DIGITS) + _end(value, one) for value in values),
            f'{one.low:.6g} to {one.high:.6g}'])
    lines.append(text_table(header, rows))
    if any('*' in cell for row in rows for cell in row[2:-1]):
        lines.append('  *: at the end of its range')
    return '\n'.join(lines)


def _end(value, variable):
    room = AT_END * (variable.high - variable.low)
    return ' *' if min(value - variable.low, variable.high - value) <= room else ''


def _write(arguments, optimum, found, path):
    """Write the scene of a machine, and see that it is this machine."""
    scene = optimum.problem.scene
    values = {**mapping(arguments.set, '--set'), **{
        key: value for key, value in numbers(optimum.scene(found)).items()
        if key.startswith('initial.position.')},
        **dict(zip((one.key for one in optimum.problem.variables), found.values))}
    files, kept = write_with_numbers(scene, values, path)
    if not _has_aims(optimum.problem, path, found):
        write_scene(optimum.scene(found), path)
        files, kept = [path], False
        if not _has_aims(optimum.problem, path, found):
            raise UsageError(f'{path}: the scene that was written does not close its loops as '
                             'the machine that was found does')
    if not kept:
        complain(arguments, f'{path.name}: the whole scene, without the comments of its file, '
                 'which does not have these numbers in places of their own')
    return files


def _has_aims(problem, path, found):
    try:
        aims = aims_of(problem, load_scene(path))
    except Infeasible:
        return False
    # Relative to the size before as well, as an aim may be zero.
    sizes = np.abs(problem.before or found.aims) + np.abs(found.aims)
    return bool((np.abs(np.subtract(aims, found.aims)) <= SAME * sizes + 1e-12).all())


def _draw(optimum, machines, directory):
    """Draw paths before and after, and the front; return the files."""
    # Only here, as it takes long to load.
    from ..mechanism.kinematics import named_paths
    from ..visual import pictures
    from ..visual.views import FRONT as FROM_THE_FRONT, PLANE
    problem, files = optimum.problem, []
    traced, driven = {}, replace(
        optimum.problem.driven, poses=max(FINE, optimum.problem.driven.poses))
    if problem.before is not None:
        run = driven.run(problem.scene)
        traced['before'] = named_paths(run.mechanism, run.position)
    for name, one in machines.items():
        run = driven.run(optimum.scene(one))
        label = 'after' if len(machines) == 1 else Path(name).stem.replace('_', ' ')
        traced[label] = named_paths(run.mechanism, run.position)
    if problem.scene.mechanism.points:
        view = PLANE if problem.scene.mechanism.planar else FROM_THE_FRONT
        pictures.overlaid_paths(
            traced, view, f'{problem.scene.name}: paths of named points',
            list(problem.paths.values())).savefig(directory / PATHS)
        files.append(directory / PATHS)
    if len(problem.aims) == 2:
        front = np.array([one.aims for one in optimum.front])
        labels = [one.text for one in problem.aims]
        write_csv(directory / FRONT_TABLE, ['scene', *labels, *(
            one.key for one in problem.variables)], [
                [name, *one.aims, *one.values] for name, one in machines.items()])
        others = [one.aims for one in optimum.starts.values()
                  if one.feasible and (np.abs(front - one.aims) > SAME * np.abs(
                      front)).any(axis=1).all()]
        pictures.pareto_front(
            front, np.array(others), problem.before, labels,
            f'{problem.scene.name}: Pareto front').savefig(directory / PICTURE)
        files += [directory / FRONT_TABLE, directory / PICTURE]
    return files


COMMAND = Command(
    name='optimise',
    summary='the numbers of a machine that make an expression least, or the front of two',
    description="""\
Vary numbers of a scene within ranges so that an expression of its quantities over a driven
motion becomes least, under requirements; of two expressions, find the Pareto front. Several
starts are gone through by SciPy's optimisers (least_squares, SLSQP) with derivatives. A machine
that cannot be assembled, or not be driven all the way, is not a result; their number is reported.

Expressions are arithmetic (+ - * / **, sqrt, abs, sin, ...) of numbers (with units deg, rad, mm,
m), numbers of the scene (parameters.l) and, over the motion:

  max(Q), min(Q), mean(Q), rms(Q)      of quantities Q: force.JOINT, torque.DRIVE, power.DRIVE,
                                       position.JOINT, velocity.JOINT, acceleration.JOINT,
                                       POINT.x, transmission_angle, shaking_force,
                                       shaking_moment, deviation(POINT)
  straightness(POINT)                  largest distance of its path from a straight line
  distance(POINT, FILE.csv)            of places x,y in a file from its path, root mean square
  part(Q, FROM, TO)                    Q where the drive is between two values
""",
    examples=(
        'optimise four_bar --vary mechanism.cut_joints.cut_1.point_b.0=0.2:0.3 '
        '--vary mechanism.joints.coupler_joint.position.0=50mm:120mm '
        '--minimise "max(force.cut_1)" --subject-to "min(transmission_angle) >= 40deg" '
        '--subject-to "max(position.rocker_joint) - min(position.rocker_joint) >= 30deg"',
        'optimise four_bar --vary mechanism.points.coupler_point.position.0=0:0.3 '
        '--vary mechanism.points.coupler_point.position.1=-0.1:0.2 --output straight '
        '--minimise "straightness(part(coupler_point, 90deg, 270deg))"'),
    failure='no machine meets all requirements',
    arguments=(
        SCENE, *READING_OPTIONS,
        Group(
            'problem',
            Argument('--vary', type=interval('KEY=LOW:HIGH'), action='append', required=True,
                     metavar='KEY=LOW:HIGH',
                     help='a number of the scene or its mechanism by its key path, and its '
                          'range; units deg, rad, mm, m; may be repeated'),
            Argument('--minimise', action='append', required=True, metavar='EXPRESSION',
                     help='of quantities over the motion, see below; given twice, the Pareto '
                          'front of both is found'),
            Argument('--subject-to', action='append', default=[], metavar='REQUIREMENT',
                     help='"EXPRESSION >= EXPRESSION", or <=; may be repeated')),
        *drive_options(' (default: one turn of the one actuated joint, or from limit to limit, in '
                       f'{POSES} poses)'),
        SET,
        Group(
            'how to search',
            Argument('--starts', type=whole(1), default=STARTS, metavar='N',
                     help='the scene as it is, and N - 1 machines that are drawn (default: '
                          f'{STARTS})'),
            Argument('--front', type=whole(1), default=FRONT, metavar='N',
                     help=f'machines on the front of two aims, 3 or more (default: {FRONT})'),
            Argument('--seed', type=whole(), default=0, metavar='N',
                     help='of the draws; the same seed finds the same (default: 0)'),
            Argument('--workers', type=whole(1), metavar='N',
                     help='processes on this machine (default: one for each processor, as soon '
                          'as there is enough to do)'),
            Argument('--resume', action='store_true',
                     help='continue the search in the directory')),
        *directory_options(
            f'{OPTIMISED}, {PATHS} (before and after) and {RESULTS}; of two aims {FRONT_TABLE}, '
            f'{PICTURE} and a scene of each machine, front_1.yaml, ...')),
    run=_run)
