# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop kinematics``: motion, drive torques and joint forces of a driven mechanism."""

from argparse import ArgumentTypeError
import math

from .command import (
    Argument, Command, complain, DRAWING, mapping, OneOf, Output, pair, picture_option, positive,
    READING_OPTIONS, SCENE, scene_to_change, SET, TABLE, UsageError, whole, write_drawing)
from ..kinematics.driven import BranchEndError
from ..mechanism.coordinates import unit_of
from ..mechanism.errors import AssemblyError
from ..mechanism.expressions import ANGLES, LENGTHS, UNITS
from ..recording.cycle import advantages, transmission_extremes
from ..recording.design import cycle, POSES, stops_met
from ..recording.kinematics import AXES, Drive, DrivenRun
from ..recording.quantities import by_name, curves, forces, Quantity, torques
from ..recording.rows import write_scene
from ..visual.progress import announced, progress_to
from ..visual.tables import write_csv
from ..visual.trajectory import from_rows

MOST_POSES = 1_000_000


def driven_run(arguments, scene):
    """Return the driven run of a command line; raise UsageError."""
    try:
        drives, count, speed = paced(arguments, scene)
        return DrivenRun(scene, drives, count, speed, arguments.branch)
    except BranchEndError as error:
        raise UsageError(f'--drive: {error}') from None
    except AssemblyError as error:
        raise UsageError(f'{scene.name}: {error}') from None
    except UsageError:
        raise
    except ValueError as error:
        raise UsageError(of_option(error)) from None


def of_option(error):
    """Return the message of a ValueError with its option in front."""
    message = str(error).removeprefix('drives: ')
    return f'--{"" if message.startswith("branch") else "drive: "}{message}'


def paced(arguments, scene, poses=POSES):
    """
    Return drives by name, the number of poses and the speed of a command line.

    UsageError; ValueError for a scene without a cycle, where no drives are given.
    """
    drives, count = drives_of(arguments, scene) if arguments.drive else (cycle(scene), poses)
    speed = arguments.speed
    if arguments.duration is not None:
        # The speed is that of the first drive that moves; a run refuses drives that all rest.
        moves = [abs(drive.end - drive.start) for drive in drives.values()
                 if drive.end != drive.start]
        speed = moves[0] / arguments.duration if moves else speed
    return drives, count, speed


def drives_of(arguments, scene):
    """Return the drives by name, and how many poses they have."""
    given = drives_given(arguments, scene)
    counts = {name: count for name, (_, count, _) in given.items() if count is not None}
    if len(set(counts.values())) != 1:
        raise UsageError('--drive: expected the same COUNT in all that move, got ' + (
            ', '.join(f'{count} of {name}' for name, count in counts.items()) or 'none that does'))
    return {name: drive for name, (drive, *_) in given.items()}, next(iter(counts.values()))


def drives_given(arguments, scene):
    """Return drives with their counts and units, by name; raise UsageError for a wrong unit."""
    given = mapping(arguments.drive, '--drive')
    mechanism = scene.mechanism
    points = {f'{point.name}.{axis}' for point in mechanism.points for axis in AXES}
    for name, (*_, units) in given.items():
        if name in points.union(mechanism.coordinates.names, mechanism.cut_coordinates.names):
            known = LENGTHS if unit_of(mechanism, 'position', name) == 'm' else ANGLES
            for unit in set(units).difference(known):
                raise UsageError(f'--drive: {name}: expected {" or ".join(known)}, got {unit}')
    return given


def drive_and_count(text):
    """Convert ``NAME=FROM:TO:COUNT`` or ``NAME=VALUE`` to a name, its drive and the count."""
    name, drive, count = motion_of(text)
    ends = text.partition('=')[2].split(':')[:2]
    return name, (drive, count, [unit for _, unit in map(_value, ends) if unit])


def motion_of(text):
    """
    Convert ``NAME=FROM:TO:COUNT`` or ``NAME=VALUE`` to a name, a ``Drive`` and the count.

    The count is None of a single value. Units are as for ``--drive``.
    """
    name, equals, ends = text.partition('=')
    parts = ends.split(':')
    values = [_value(part) for part in parts[:2]]
    if not (name and equals and None not in values and (
            len(parts) == 1 or len(parts) == 3 and parts[2].isdecimal()
            and 2 <= int(parts[2]) <= MOST_POSES)):
        raise ArgumentTypeError(
            f'expected NAME=FROM:TO:COUNT with COUNT from 2 to {MOST_POSES}, or NAME=VALUE, got '
            f'{text!r}')
    units = [unit for _, unit in values if unit]
    start, *end = (number * UNITS[unit or (units or ['rad'])[0]] for number, unit in values)
    return name, Drive(start, *(end or [start])), int(parts[2]) if end else None


def value_of(text):
    """Return a number with its unit in rad or m, or None."""
    found = _value(text)
    return None if found is None else found[0] * UNITS[found[1] or 'rad']


def _value(text):
    """Return a number and its unit or None; None where the text is not a number."""
    unit = next((unit for unit in UNITS if text.endswith(unit)), None)
    try:
        number = float(text.removesuffix(unit) if unit else text)
    except ValueError:
        return None
    return (number, unit) if math.isfinite(number) else None


def interval(form):
    """Return the conversion of ``NAME=LOW:HIGH``, with units; ``form`` is for messages."""
    def convert(text):
        name, ends = pair(form)(text)
        values = tuple(value_of(part) for part in ends.split(':'))
        if len(values) != 2 or None in values:
            raise ArgumentTypeError(f'expected {form}, got {text!r}')
        return name, values
    return convert


def ending(arguments, run):
    """Report where a driven run ended early, if it did; return the exit code."""
    return 0 if run.end is None else complain(
        arguments, f'pose {len(run.time)}: {run.end.reason}')


def _run(arguments):
    scene = scene_to_change(arguments)
    with announced('Following the branch ...'):
        run = driven_run(arguments, scene)
    with progress_to(max(len(run.time) - 1, 1), 'poses', scene.name) as show:
        table = run.table(show)
    if arguments.output is not None:
        write_scene(arguments.output, run.scene)
        write_csv(arguments.output, *table)
    if arguments.picture is not None:
        _draw(arguments, run, table)
    if arguments.drawing is not None:
        write_drawing(arguments, from_rows(run.mechanism, *table), run.scene.name)
    print(summary(run, table))
    for path in (arguments.output, arguments.picture, arguments.drawing):
        if path is not None:
            print(f'  output    {path}')
    return ending(arguments, run)


def summary(run, table):
    """Return the largest torques and forces of a driven run, with their places, as text."""
    column, drive, at = by_name(table), run.drive, run.drive.text
    name = drive.name
    lines = [f'{run.scene.name}: {len(run.time)} poses, {name} from {at(drive.values[0])} to '
             f'{at(drive.values[-1])} in {run.time[-1]:.6g} s; loops closed to '
             f'{column["closure"].max():.2g} m or rad']
    for what, torque in torques(run, column).items():
        most = torque.largest(drive)
        lines.append(f'  torque    {what}: at most {most.value:.6g} N m or N at {name} = '
                     f'{at(most.drive)}, rms {torque.rms:.6g}')
    for what, force in forces(column).items():
        most = force.extreme(drive)
        lines.append(f'  force     {what}: at most {most.value:.6g} N at {name} = '
                     f'{at(most.drive)}')
    for (what, joint), most in stops_met(run, table).items():
        lines.append(f'  end stop  {what}: {joint} goes beyond it by at most {most.value:.6g} '
                     f'at {name} = {at(most.drive)}')
    if len(run.driven) == 1 and len(run.time) > 2:
        lines += [f'  transmission angle {math.degrees(one.value):.4f} deg at {name} = '
                  f'{at(one.drive)}' for one in transmission_extremes(run)]
        lines += [f'  advantage {what}: at least {one.least.value:.5g} at {name} = '
                  f'{at(one.least.drive)}; dead centres at '
                  f'{", ".join(map(at, one.dead_centres)) or "none"}'
                  for what, one in advantages(run).items()]
    return '\n'.join(lines)


def _draw(arguments, run, table):
    # Only here, as it takes long to load.
    from ..visual.pictures import over_drive
    over = run.drive.shown if arguments.over == 'drive' else Quantity('time', 's', run.time)
    shown = {quantity: {name: (over.values, each) for name, each in lines.items()}
             for quantity, lines in curves(run, table).items()}
    over_drive(shown, over.label, f'{run.scene.name}: driven').savefig(arguments.picture)


def drive_options(default=''):
    """Return the options of drives, for ``driven_run``; without a default they are due."""
    return (
        Argument('--drive', type=drive_and_count, action='append', default=[],
                 required=not default, metavar='JOINT=FROM:TO:COUNT',
                 help='drive a joint, or a coordinate of a point (tool.x), through COUNT values, '
                      'such as crank_joint=0:360deg:361; units deg, rad, mm, cm, m, inch, a unit '
                      'after one of both counts for both (default: rad and m). JOINT=VALUE holds '
                      f'it. As many as there are degrees of freedom{default}'),
        OneOf(
            Argument('--speed', type=positive, default=1.0, metavar='RATE',
                     help='constant speed of the first drive that moves [rad/s or m/s]; the '
                          'others take the same time (default: 1)'),
            Argument('--duration', type=positive, metavar='SECONDS',
                     help='how long the motion takes instead')),
        Argument('--branch', type=whole(1), metavar='N',
                 help='number of the assembly at the first pose, as `closedloop assemblies` '
                      "(default: the branch of the scene's start, followed to there)"))


COMMAND = Command(
    name='kinematics',
    summary='motion, drive torques and joint forces over a driven motion',
    description="""\
Drive joints, or coordinates of points, through values at constant speed, and write
positions, velocities, accelerations, the torques that the drives exert, and the forces
in all joints, against the drive and the time. The branch of the start is followed and
never left: where it ends, it is said where and why (a dead centre, the edge of what can
be reached, a change point), and the rows before it are written.

Driven joints exert what the motion takes (columns motion.drive_JOINT.force and .power,
and effort.JOINT); where points are driven, the actuated joints do (effort.JOINT). All
columns are those of `closedloop simulate --forces all`. Beside FILE.csv is written
FILE.csv.scene.json, the scene with all overrides: plot, animate and view show it.
""",
    examples=(
        'kinematics four_bar --drive crank_joint=0:360deg:361 --speed 10 --output turn.csv',
        'kinematics four_bar --drive crank_joint=0:360deg:361 --duration 2 --over time '
        '--picture turn.png',
        'kinematics four_bar --drive rocker_joint=90:160deg:71',
        'kinematics four_bar --drive crank_joint=60deg:420deg:361 --picture turn.png',
        'kinematics four_bar --drive crank_joint=60deg:420deg:361 --drawing four_bar.svg',
        'kinematics three_rrr --drive theta_1=2:2.2:21 --drive theta_6=3.4 --drive theta_7=4.7'),
    failure='the branch of the start ends before the last pose',
    arguments=(
        SCENE, *READING_OPTIONS,
        *drive_options(),
        SET,
        Output('--output', 'FILE.csv', 'where to write a row for each pose', TABLE),
        picture_option('it'),
        Argument('--over', choices=('drive', 'time'), default='drive',
                 help='the abscissa of the picture (default: drive)'),
        DRAWING),
    run=_run)
