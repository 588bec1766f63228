# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop import``: a model in another format as a mechanism and a scene to edit."""

import os
from pathlib import Path

from .command import (
    Argument, Command, complain, Output, positive, reading, READING_OPTIONS, UsageError, YAML)
from ..formats.building import lines
from ..formats.registry import read_model, READERS
from ..formats.yaml_text import mechanism_text, scene_text
from ..kinematics.modeling import extent
from ..mechanism.digits import digit_notes
from ..scene.model_scene import assembled
from ..visual.progress import announced


def _run(arguments):
    if arguments.end_stops is not None and arguments.scene is None:
        raise UsageError('--end-stops: expected it with --scene, which they are written into')
    with announced('Reading the model ...'):
        imported = read_model(
            arguments.file, arguments.end_stops, **reading(arguments, arguments.file))
    notes = [*digit_notes(imported.mechanism), *lines(imported, extent(imported.mechanism))]
    if arguments.scene is not None:
        with announced('Closing the loops ...'):
            imported, found, assembly_notes = assembled(imported)
        notes = [*assembly_notes, *notes]
    arguments.output.write_text(mechanism_text(imported.mechanism, notes), encoding='utf-8')
    if arguments.scene is not None:
        beside = os.path.relpath(arguments.output, arguments.scene.parent)
        arguments.scene.write_text(
            scene_text(imported, found.q, os.path.join(os.curdir, beside)), encoding='utf-8')
    mechanism = imported.mechanism
    print(f'{arguments.output}: {len(mechanism.bodies)} bodies, {len(mechanism.joints)} joints, '
          f'{len(mechanism.cut_joints)} that close loops')
    for note in notes:
        complain(arguments, note)
    return 0


COMMAND = Command(
    name='import',
    summary='write a model in another format (URDF, ...) as a mechanism to edit',
    description="""\
Read a model of a robot or machine in another format and write it as a mechanism,
and a scene where one is wanted. Links that are fixed together become one body;
loops that are drawn open are closed in the scene. What is left out is listed. A model
need not be imported to be simulated: check, simulate and the nodes take its file.
""",
    examples=(
        'import robot.urdf --output my_robot.yaml',
        'import robot.urdf --output my_robot.yaml --scene my_robot_scene.yaml'),
    arguments=(
        Argument('file', metavar='FILE', type=Path,
                 help=f'a model: a name that ends with {", ".join(READERS)}'),
        Output('--output', 'FILE.yaml', 'where to write the mechanism', YAML, required=True),
        Output('--scene', 'FILE.yaml', 'where to write a scene of it, its loops closed (default: '
               'nowhere)', YAML),
        Argument('--end-stops', metavar='STIFFNESS', type=positive,
                 help='make limits of joints end stops of this stiffness, in the scene [N m/rad; '
                      'N/m] (default: leave them out)'),
        *READING_OPTIONS),
    run=_run,
    reads_scenes=False)
