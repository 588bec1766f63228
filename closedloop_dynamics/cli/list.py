# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop list``: the shipped scenes, by the names that every command takes."""

from .command import Command
from ..mechanism.config import config_directory
from ..scene.loading import load_scene, scene_names
from ..visual.tables import text_table

HEADER = ('scene', '', 'bodies', 'cut joints', 'drives', 'description')


def _row(name):
    """Return the line of a scene."""
    scene = load_scene(name)
    mechanism = scene.mechanism
    drives = sum(joint.actuated for joint in (*mechanism.joints, *mechanism.cut_joints))
    return (name, 'plane' if mechanism.planar else 'space', str(len(mechanism.bodies)),
            str(len(mechanism.cut_joints)), str(drives),
            scene.description or mechanism.description)


def _run(arguments):
    print(text_table(HEADER, [_row(name) for name in scene_names()]))
    print(f'\nThe files are in {config_directory() / "scenes"}; '
          '`closedloop check SCENE` describes one.')
    return 0


COMMAND = Command(
    name='list',
    summary='the shipped scenes, by the names that every command takes',
    description="""\
List the shipped scenes: the name that every command takes, whether it moves in
the plane or in space, how many bodies, cut joints and drives it has, and what
it is.
""",
    examples=('list',),
    run=_run,
    reads_scenes=False)
