# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop cognates``: the other four-bar linkages of a coupler curve."""

from .command import (
    add_directory, add_reading, add_scene, add_set, Command, free_paths, scene_to_change,
    write_variants)
from ..mechanism.four_bar import four_bar
from ..mechanism.mechanism import GROUND
from ..simulation.cognates import cognates
from ..visual.tables import text_table

FILES = 'cognate_1.yaml', 'cognate_2.yaml'


def _add_arguments(parser):
    add_scene(parser)
    add_reading(parser)
    add_set(parser)
    parser.add_argument('--point', metavar='NAME',
                        help='the point of the coupler that traces the curve (default: its first '
                             'one)')
    add_directory(parser, ', '.join(FILES), '')


def _run(arguments):
    files = free_paths(arguments, *FILES)
    arguments.output.mkdir(parents=True, exist_ok=True)
    scene = scene_to_change(arguments)
    found = {}

    def made():
        found.update(zip(files, cognates(scene, arguments.point)))
        return found

    code = write_variants(arguments, made)
    rows = [_row(scene.name, scene.mechanism), *(
        _row(one.scene.name, one.scene.mechanism) for one in found.values())]
    print(text_table(('', 'base [m]', 'input [m]', 'coupler [m]', 'output [m]', 'kind'), rows))
    return code


def _row(name, mechanism):
    driven = [joint.name for joint in mechanism.joints if joint.parent == GROUND]
    driven.sort(key=lambda one: one not in mechanism.actuated_joints)
    bars = four_bar(mechanism, driven[0])
    return name, *(f'{length:.6g}' for length in bars.lengths), bars.kind


COMMAND = Command(
    name='cognates',
    summary='write the other two four-bar linkages with the same coupler curve',
    description="""\
Write the two cognates of a four-bar linkage (Roberts and Chebyshev) as scenes: linkages of
other lengths on other pivots, of which the same point traces the same coupler curve. The second
one is driven at its input link, which turns as that of the linkage does; the first one at its
shortest link, which turns round where that of the linkage does. Their links are uniform rods
with as much mass to a length as those of the linkage have together. Weight acts as before;
other effects are left out, and named.
""",
    epilog="""\
examples:
  closedloop cognates four_bar --output cognates
  closedloop kinematics cognates/cognate_2.yaml --drive input_joint=30:390deg:361
""",
    add_arguments=_add_arguments,
    run=_run)
