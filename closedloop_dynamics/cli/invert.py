# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop invert``: the same machine with another link as the ground."""

from .command import add_variant, Command, write_variant
from ..simulation.inversion import inverted


def _add_arguments(parser):
    add_variant(parser)
    parser.add_argument('--ground', metavar='LINK', required=True, help='the body that is held')


def _run(arguments):
    return write_variant(arguments, lambda scene: inverted(scene, arguments.ground))


COMMAND = Command(
    name='invert',
    summary='write a machine with another link as its ground (kinematic inversion)',
    description="""\
Write the kinematic inversion of a scene: the body that is named is held where it is at the
start, and the old ground moves, as the body `base`, without mass. Joints keep their names;
those between both grounds change parent and child. Weight acts as before, and so do springs,
dampers, friction, stops, drives and motions in joints and springs between points; what belongs
to the old world or to frames of bodies is left out, and named.
""",
    epilog="""\
examples:
  closedloop invert slider_crank --ground rod --output oscillating_cylinder.yaml
  closedloop kinematics oscillating_cylinder.yaml --drive crank_joint=60:420deg:361
""",
    add_arguments=_add_arguments,
    run=_run)
