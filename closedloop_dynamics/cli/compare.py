# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop compare``: machines driven over the same motion, side by side."""

from argparse import ArgumentTypeError, Namespace
import math

from .command import (
    Argument, assignment, Command, complain, directory_options, FAILED, free_paths, read_scene,
    READING_OPTIONS, UsageError, with_numbers)
from .kinematics import drive_options, driven_run
from ..mechanism.rotations import in_three
from ..recording import design
from ..recording.quantities import by_name, forces, torques
from ..recording.rows import write_scene
from ..visual.progress import announced, progress_to
from ..visual.tables import short, text_table, write_csv

PATHS, CURVES, TABLE = 'paths.png', 'curves.png', 'differences.csv'


def _assignments(text):
    """Convert ``KEY=VALUE,KEY=VALUE`` to a list of pairs."""
    try:
        return [assignment(part) for part in text.split(',')]
    except ArgumentTypeError:
        raise ArgumentTypeError(f'expected KEY=NUMBER[,KEY=NUMBER], got {text!r}') from None


def _run(arguments):
    machines = _machines(arguments)
    rows = [f'{number}.csv' for number in range(1, len(machines) + 1)]
    files = free_paths(arguments, PATHS, CURVES, TABLE, *rows)
    runs = {}
    for label, scene in machines.items():
        with announced(f'Following the branch of {label} ...'):
            try:
                run = driven_run(arguments, scene)
            except UsageError as error:
                raise UsageError(f'{label}: {error}') from None
            if len(run.time) < 2:
                raise UsageError(f'{label}: {run.end.reason}')
        with progress_to(len(run.time) - 1, 'poses', label) as show:
            runs[label] = run, run.table(show)
    numbers = {label: design.key_numbers(run, table) for label, (run, table) in runs.items()}
    header, lines = _differences(numbers)
    print('\n'.join(f'{number}: {label}' for number, label in enumerate(numbers, 1)))
    titles = ['', *map(str, range(1, len(numbers) + 1)), *(
        f'{number} against 1' for number in range(2, len(numbers) + 1))]
    print(text_table(titles, [[
        name, *(short(value, '.6g') for value in values[:len(numbers)]),
        *map(_percent, values[len(numbers):])] for name, *values in lines]))
    if files:
        arguments.output.mkdir(parents=True, exist_ok=True)
        paths, curves, table, *tables = files
        write_csv(table, header, lines)
        for path, (run, one) in zip(tables, runs.values()):
            write_scene(path, run.scene)
            write_csv(path, *one)
        with announced('Drawing ...'):
            _draw(runs, paths, curves)
        print('\n'.join(map(str, files)))
    ended = [f'{label}: pose {len(run.time)}: {run.end.reason}'
             for label, (run, _) in runs.items() if run.end is not None]
    for text in ended:
        complain(arguments, text)
    return FAILED if ended else 0


def _machines(arguments):
    """Return the scenes to compare, by name."""
    names, sets = arguments.scene, arguments.set
    if len(names) > 1 and sets:
        raise UsageError(f'--set: expected it with one scene, got {len(names)}')
    if len(names) == 1 and not sets:
        raise UsageError('expected two scenes or more, or one with --set, got one')
    found = {}
    scenes = [(name, []) for name in names] if not sets else [
        (names[0], pairs) for pairs in ([[], *sets] if len(sets) == 1 else sets)]
    for name, pairs in scenes:
        scene = with_numbers(read_scene(name, arguments), Namespace(set=pairs))
        label = ', '.join([scene.name, *(f'{key} = {value:g}' for key, value in pairs)])
        if label in found and not sets:
            # Files of the same name.
            label = name
        if label in found:
            raise UsageError(f'expected different machines, got {label} twice')
        found[label] = scene
    return found


def _differences(numbers):
    """Return header and rows of a table: each number of each machine, and its relative change."""
    first, *others = numbers
    rows = []
    for name in dict.fromkeys(name for each in numbers.values() for name in each):
        values = [each.get(name, math.nan) for each in numbers.values()]
        rows.append([name, *values, *(
            (value - values[0]) / abs(values[0]) if values[0] else math.nan
            for value in values[1:])])
    return ['', *numbers, *(f'{label} against {first}' for label in others)], rows


def _percent(value):
    return '-' if math.isnan(value) else f'{100.0 * value:+.3g} %'


def _draw(runs, paths, curves):
    # Only here, as it takes long to load.
    from ..mechanism.kinematics import named_paths
    from ..visual import pictures
    from ..visual.views import FRONT, PLANE
    title, shown, traced = 'drive torques and joint forces', {}, {}
    labels, planar = set(), True
    for label, (run, table) in runs.items():
        column, drive = by_name(table), run.drive.shown
        labels.add(drive.label)
        for what, unit, lines in (('drive', 'N m or N', torques(run, column)),
                                  ('force', 'N', forces(column))):
            for name, one in lines.items():
                shown.setdefault(f'{what} {name}\n[{unit}]', {})[label] = drive.values, one.values
        mechanism = run.mechanism
        planar = planar and mechanism.planar
        traced[label] = named_paths(mechanism, run.position)
    if not planar:
        # A plane among others in space: its points lie at z = 0.
        traced = {label: {name: in_three(places) for name, places in points.items()}
                  for label, points in traced.items()}
    pictures.overlaid_paths(traced, PLANE if planar else FRONT, 'paths of named points').savefig(
        paths)
    pictures.over_drive(
        shown, labels.pop() if len(labels) == 1 else 'drive [deg or m]', title,
        list(runs)).savefig(curves)


COMMAND = Command(
    name='compare',
    summary='machines driven over the same motion: paths, torques and forces in one picture',
    description="""\
Drive several scenes, or one scene with several sets of numbers, over the same motion, and
compare: the paths of their named points, drive torques and joint forces in one picture each,
and a table of strokes, transmission angles, largest torques and forces, with the changes
against the first machine. Every machine's rows are written with its scene beside them.
""",
    examples=(
        'compare four_bar --set mechanism.bodies.coupler.mass=2 --output heavier',
        'compare my_scene.yaml --set parameters.b=0.36 --set parameters.b=0.38 --output two',
        'compare three_rrr_vertical three_rrr_horizontal --drive theta_1=2:2.1:11 '
        '--drive theta_6=3.4 --drive theta_7=4.7'),
    failure='a machine does not reach the end of the motion',
    arguments=(
        Argument('scene', metavar='SCENE', nargs='+',
                 help='shipped scenes by their names, or YAML files; two or more, or one with '
                      '--set'),
        *READING_OPTIONS,
        *drive_options(' (default: one turn of the one actuated joint, or from limit to limit)'),
        Argument('--set', type=_assignments, action='append', default=[],
                 metavar='KEY=VALUE[,KEY=VALUE]',
                 help='another machine: the one scene with other numbers, by their key paths; '
                      'may be repeated. Given once, it is compared with the scene as it is'),
        *directory_options(
            f'{PATHS}, {CURVES}, {TABLE}, and the rows of each machine, 1.csv, ...')),
    run=_run)
