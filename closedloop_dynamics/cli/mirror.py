# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop mirror``: the mirror image of a machine."""

from .command import add_variant, Command, write_variant
from ..simulation.mirror import AXES, mirrored


def _add_arguments(parser):
    add_variant(parser)
    parser.add_argument('--axis', choices=tuple(AXES), default='x',
                        help='the coordinate that changes its sign (default: x)')


def _run(arguments):
    return write_variant(arguments, lambda scene: mirrored(scene, arguments.axis))


COMMAND = Command(
    name='mirror',
    summary='write the mirror image of a machine as a scene',
    description="""\
Write the mirror image of a scene, which moves as the machine does in a mirror: a left
leg from a right one. Bodies, joints, points and loops are mirrored, and so is the start;
masses stay. Weight, springs, dampers, friction, stops, drives and motions of joints, and
forces at points are mirrored, too; effects that have shapes or tables of their own (contacts,
cables, tendons, bushings, laws) are left out, and named.
""",
    epilog="""\
examples:
  closedloop mirror hoeken_pantograph_leg --output right_leg.yaml
  closedloop mirror delta_robot --axis z --output from_below.yaml
""",
    add_arguments=_add_arguments,
    run=_run)
