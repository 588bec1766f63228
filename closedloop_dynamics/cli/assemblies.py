# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop assemblies``: the ways in which a mechanism can be put together."""

import numpy as np

from .command import (
    Argument, Command, picture_option, READING_OPTIONS, SCENE, scene_to_change, SET, UsageError)
from .kinematics import drive_and_count, drives_given, of_option
from ..mechanism.errors import AssemblyError
from ..recording.kinematics import assemblies, held
from ..visual.tables import text_table


def _run(arguments):
    scene = scene_to_change(arguments)
    given = {name: one for name, (one, *_) in drives_given(arguments, scene).items()}
    try:
        found = assemblies(scene, given or held(scene))
    except AssemblyError as error:
        raise UsageError(f'{scene.name}: {error}') from None
    except ValueError as error:
        raise UsageError(of_option(error)) from None
    header = ('branch', *(name.removeprefix('position.')
                          for name in scene.mechanism.coordinates.columns('position')))
    rows = [[str(number), *(f'{value:.6g}' for value in position)]
            for number, position in enumerate(found.positions, 1)]
    print(f'{scene.name}: assemblies {found}: {found.reason}')
    print(text_table(header, rows))
    if arguments.picture is not None:
        # Only here, as it takes long to load.
        from ..visual.pictures import shapes
        shapes(scene.mechanism, {
            str(number): np.array([position]) for number, position in enumerate(
                found.positions, 1)}, f'{scene.name}: assemblies').savefig(arguments.picture)
        print(f'  output    {arguments.picture}')
    return 0


COMMAND = Command(
    name='assemblies',
    summary='all ways in which a mechanism can be put together, with pictures',
    description="""\
List the positions in which the loops close while drives are held: where the scene starts,
or where --drive says. In the plane all are found, and it is proved; where it is not, and
in space, those are found that random starts lead to. `closedloop kinematics --branch N`
goes on from one of them.
""",
    examples=(
        'assemblies four_bar',
        'assemblies four_bar --drive crank_joint=60deg --picture four_bar.png'),
    arguments=(
        SCENE, *READING_OPTIONS,
        Argument('--drive', type=drive_and_count, action='append', default=[],
                 metavar='JOINT=VALUE',
                 help='hold a joint, or a coordinate of a point (tool.x), there; units deg, rad, '
                      'mm, cm, m, inch (default: rad and m). As many as there are degrees of '
                      'freedom (default: the joints that the scene holds, or that are actuated, '
                      'where it starts)'),
        SET,
        picture_option('all of them')),
    run=_run)
