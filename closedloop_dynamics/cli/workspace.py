# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop workspace``: reach, conditioning and singularities of a platform."""

from argparse import ArgumentTypeError
from pathlib import Path

import numpy as np

from .command import (
    Argument, assignment, Command, Group, interrupted, mapping, picture_option, positive,
    READING_OPTIONS, require_free, SCENE, scene_to_change, SET, UsageError, whole)
from .kinematics import interval, motion_of, value_of
from ..kinematics.driven import BranchEndError
from ..mechanism.errors import AssemblyError
from ..recording.workspace import (
    compute, MEANINGS, QUANTITIES, REACHED, Request, WorkspaceFileError)
from ..simulation.signals import program_watch
from ..visual.progress import announced, parts_bar

STATUS = 'status'
# Percentage of a share of 1.
PERCENT = 100.0
# What a request is made of.
OPTIONS = 'point', 'grid', 'orientation', 'turn', 'limit', 'clearance', 'torque-limit', 'stiffness'


def _axis(text):
    """Convert ``NAME=FROM:TO:COUNT`` or ``NAME=VALUE`` to a name and its range."""
    name, drive, count = motion_of(text)
    return name, (drive.start, drive.end, count or 1)


def _angles(text):
    """Convert one angle or three."""
    values = [value_of(part) for part in text.split(',')]
    if len(values) not in (1, 3) or None in values:
        raise ArgumentTypeError(f'expected ANGLE or ANGLE,ANGLE,ANGLE, got {text!r}')
    return tuple(values)


def _run(arguments):
    if arguments.resume and arguments.output is None:
        raise UsageError('--resume: expected --output FILE.nc beside it')
    if arguments.show is not None and arguments.picture is None:
        raise UsageError('--show: expected it with --picture')
    if arguments.show is not None and arguments.turn:
        raise UsageError('--show: expected it without --turn, whose picture shows in how many '
                         'orientations a place is reached')
    if arguments.output is not None and not (arguments.resume and arguments.output.exists()):
        require_free(arguments, arguments.output, endings=('.nc',))
    scene = scene_to_change(arguments)
    request = Request(
        _point(arguments, scene), mapping(arguments.grid, '--grid'), arguments.orientation,
        mapping(arguments.turn, '--turn'), mapping(arguments.torque_limit, '--torque-limit'),
        mapping(arguments.stiffness, '--stiffness'), mapping(arguments.limit, '--limit'),
        arguments.clearance)
    with program_watch.noting() as received, parts_bar('nodes', scene.name) as show:
        try:
            found = compute(scene, request, arguments.workers, arguments.output,
                            arguments.resume, show, lambda: not received)
        except (BranchEndError, AssemblyError, WorkspaceFileError) as error:
            raise UsageError(f'{scene.name}: {error}') from None
        except ValueError as error:
            # The error names a field of the request, or the scene.
            option = str(error).partition(':')[0].replace('_', '-')
            raise UsageError(f'--{option}{str(error)[len(option):]}' if option in OPTIONS
                             else str(error)) from None
    print(summary(scene, found))
    if arguments.output is not None:
        print(f'  output    {arguments.output}')
    if received:
        return interrupted(arguments, received[0], arguments.output is not None)
    if arguments.picture is not None:
        with announced('Drawing ...'):
            _draw(arguments, scene, found)
        print(f'  picture   {arguments.picture}')
    return 0


def _point(arguments, scene):
    points = [point.name for point in scene.mechanism.points if point.body != 'ground']
    if arguments.point is not None:
        return arguments.point
    if len(points) != 1:
        raise UsageError(f'--point: expected one of {", ".join(points) or "none"}, got none')
    return points[0]


def summary(scene, found):
    """Return the numbers of a map as text."""
    unit = ('m', 'm', 'm^2', 'm^3')[sum(len(axis.values) > 1 for axis in found.axes)]
    shape = ' x '.join(str(len(axis.values)) for axis in found.axes)
    lines = [f'{scene.name}: {found.request.point} on {shape} nodes']
    angles = np.round(np.degrees(found.angles), 9) + 0.0
    if len(angles) == 1:
        held = ', '.join(f'{angle:.6g}' for angle in angles[0])
        lines[0] += f', orientation {held} deg' if found.turned else ''
        for k, meaning in enumerate(MEANINGS[1:], 1):
            count = int((found.status == k).sum())
            if count or k == REACHED:
                lines.append(f'  {meaning:<24} {count} nodes, {count * found.node_size:.6g} '
                             f'{unit}')
    else:
        some, whole = int((found.count > 0).sum()), int(found.dexterous.sum())
        lines[0] += f', {len(angles)} orientations'
        lines.append(f'  reached in one           {some} nodes, {some * found.node_size:.6g} '
                     f'{unit}')
        if found.finished:
            lines.append(f'  reached in all           {whole} nodes, '
                         f'{whole * found.node_size:.6g} {unit}')
        if found.missed:
            lines.append(f'  no way was found to {len(found.missed)} of the orientations')
    if not found.finished:
        lines[0] += '; not finished, this is what was found so far'
    for name, values in found.quantities.items():
        known = values[np.isfinite(values)]
        if len(known):
            lines.append(f'  {name:<24} {known.min():.6g} to {known.max():.6g} '
                         f'{QUANTITIES[name].unit}, median {np.median(known):.6g}')
    for kind in dict.fromkeys(curve.kind for curve in found.curves):
        each = [curve for curve in found.curves if curve.kind == kind]
        length = sum(float(np.linalg.norm(np.diff(curve.places, axis=0), axis=1).sum())
                     for curve in each)
        lines.append(f'  {kind + " curves":<24} {len(each)}, together {length:.6g} m')
    lines += [f'  not computed: {note}' for note in found.notes]
    return '\n'.join(lines)


def _draw(arguments, scene, found):
    # Only here, as it takes long to load.
    from ..mechanism.kinematics import body_poses
    from ..visual.workspace_picture import workspace_picture
    long = [axis for axis in found.axes if len(axis.values) > 1]
    shape = tuple(len(axis.values) for axis in long)
    several = len(found.angles) > 1
    shown = arguments.show or 'condition'
    values, label = found.quantities.get(shown), shown
    if several:
        values = np.where(found.count > 0, PERCENT * found.count / len(found.angles), np.nan)
        label = 'orientations reached [%]'
    elif values is not None:
        label = QUANTITIES[shown].label
    machine = None
    if scene.mechanism.planar and found.position is not None:
        places = np.argwhere(found.status == REACHED)
        if len(places):
            middle = places[np.abs(places - places.mean(axis=0)).sum(axis=1).argmin()]
            machine = scene.mechanism, body_poses(
                scene.mechanism, found.position[tuple(middle)][np.newaxis])
    workspace_picture(
        [(axis.name, axis.values) for axis in long], found.status.reshape(shape),
        None if values is None else values.reshape(shape), label,
        f'{scene.name}: workspace of {found.request.point}', MEANINGS,
        [(curve.kind, curve.places) for curve in found.curves],
        found.dexterous.reshape(shape) if several else None, machine,
        not several and shown == 'condition').savefig(arguments.picture)


COMMAND = Command(
    name='workspace',
    summary='what a platform reaches: map, singular curves, forces, stiffness',
    description="""\
Map what a point of a platform reaches in an orientation that is held, or in many: from
the scene's start the machine is driven from node to node of a grid, and the branch (the
working mode) is never left. Pieces that are not connected with it are looked for from
random starts; small ones may be missed.

Of every node in one orientation: the condition number of the Jacobian, the largest force
in every direction that the actuated joints hold within their torque limits, the least
stiffness of the point. On a grid along two axes, the curves of type-1 (serial) and type-2
(parallel) singularities of the branch, which are followed, not sampled.

FILE.nc is a NetCDF file. Ctrl-C leaves a valid one, which --resume goes on with.
""",
    examples=(
        'workspace three_rrr --point platform_center --picture map.png',
        'workspace three_rrr --point platform_center --orientation 20deg '
        '--grid x=-0.3:1.2:500 --grid y=-0.4:1.1:500 --clearance 0.02 --output map.nc',
        'workspace three_rrr --point platform_center --turn z=0:350deg:36',
        'workspace stewart_platform --point platform_center --limit leg_1=-0.1:0.2'),
    arguments=(
        SCENE, *READING_OPTIONS, SET,
        Group(
            'what is mapped',
            Argument('--point', metavar='NAME',
                     help='named point of the platform; its body is the platform (default: the '
                          'one named point on a body, if there is one)'),
            Argument('--grid', type=_axis, action='append', default=[],
                     metavar='AXIS=FROM:TO:COUNT',
                     help="values of the point's x, y or z, such as x=-200mm:600mm:500, or one "
                          'value that is held, z=0.5; units mm, m (default: around what is '
                          'reached, 200 values in the plane, 40 in space)'),
            Argument('--orientation', type=_angles, metavar='ANGLE[,ANGLE,ANGLE]',
                     help='that is held: one angle in the plane, in space three about x, y and z '
                          'of the world, one after the other; units deg, rad (default: that of '
                          "the scene's start)"),
            Argument('--turn', type=_axis, action='append', default=[],
                     metavar='AXIS=FROM:TO:COUNT',
                     help='many orientations instead, such as z=0:350deg:36: what is reached in '
                          'one of them, and in all (the dexterous workspace)'),
            Argument('--limit', type=interval('JOINT=LOW:HIGH'), action='append', default=[],
                     metavar='JOINT=LOW:HIGH', help='range of a joint; may be repeated'),
            Argument('--clearance', type=positive, metavar='METRES',
                     help='least distance of links that no joint joins, each a segment between '
                          'its joints (default: links may cross)'),
            Argument('--torque-limit', type=assignment, action='append', default=[],
                     metavar='JOINT=VALUE',
                     help='of an actuated joint [N m or N], for the map of forces (default: 1)'),
            Argument('--stiffness', type=assignment, action='append', default=[],
                     metavar='JOINT=VALUE',
                     help='of an actuated joint [N m/rad or N/m] (default: 1)')),
        Argument('--workers', type=whole(1), metavar='N',
                 help='threads (default: one for each processor)'),
        Argument('--output', type=Path, metavar='FILE.nc', help='where to write the map'),
        picture_option('it'),
        Argument('--show', choices=(*QUANTITIES, STATUS),
                 help='the quantity to draw (default: condition)'),
        Argument('--resume', action='store_true', help='go on with FILE.nc, if there is one')),
    run=_run)
