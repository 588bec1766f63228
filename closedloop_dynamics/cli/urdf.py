# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop urdf``: a mechanism as a URDF robot description."""

from pathlib import Path

from .command import Argument, Command, Output, UsageError
from ..effects.end_stop import stops_of
from ..formats.urdf_loops import CONSTRAINT, DRAKES, LOOP
from ..scene.loading import load_scene_or_mechanism
from ..simulation.simulation import Simulation
from ..visual.srdf import srdf
from ..visual.urdf import urdf


def _run(arguments):
    subject = load_scene_or_mechanism(arguments.scene)
    mechanism = getattr(subject, 'mechanism', subject)
    hardware = None
    if arguments.hardware is not None:
        if subject is mechanism:
            raise UsageError(f'--hardware: expected a scene, got the mechanism {arguments.scene}')
        if not arguments.hardware.is_file():
            raise UsageError('--hardware: expected the C of the scene, compiled as a library, got '
                             f'no file {arguments.hardware}')
        hardware = arguments.hardware.resolve(), subject.method.step_size, arguments.sensors
    elif arguments.sensors:
        raise UsageError('--sensors: expected --hardware, which has them, got none')
    try:
        text = urdf(mechanism, loops=arguments.loops,
                    limits=stops_of(getattr(subject, 'effects', {})), hardware=hardware)
        if arguments.srdf is not None:
            states = {} if subject is mechanism else {
                'start': Simulation.from_scene(subject).position}
            arguments.srdf.write_text(srdf(mechanism, states), encoding='utf-8')
    except ValueError as error:
        raise UsageError(str(error)) from None
    if arguments.output is None:
        print(text, end='')
        return 0
    arguments.output.write_text(text, encoding='utf-8')
    return 0


COMMAND = Command(
    name='urdf',
    summary='write the robot description (URDF) of a mechanism',
    description="""\
Write the spanning tree of a mechanism as URDF, for robot_state_publisher, RViz,
Foxglove and whatever else reads robot descriptions. Links and joints have the
names of the bodies and joints; the root link is world, ground is fixed to it. The
plane of a planar mechanism is the x-y plane. URDF itself knows no loops: cut joints
are elements beside the tree that other parsers pass over, joint_states of the
simulator close them.
""",
    examples=(
        'urdf three_rrr',
        'urdf delta_robot --loops drake',
        'urdf delta_robot --output delta.urdf --srdf delta.srdf',
        'urdf three_rrr --hardware three_rrr.so --output three_rrr.urdf',
        'urdf carpet_scraper --output carpet_scraper.urdf'),
    arguments=(
        Argument('scene', metavar='SCENE',
                 help='a shipped scene or mechanism by its name, or a YAML file'),
        Output('--output', 'FILE.urdf', 'where to write it (default: the standard output)',
               ('.urdf',)),
        Argument('--loops', choices=(CONSTRAINT, LOOP, DRAKES), default=CONSTRAINT,
                 help='how loops are written: as proposed for URDF (the default), as in URDF+, '
                      'or as ball constraints of Drake'),
        Output('--srdf', 'FILE.srdf', 'also write the SRDF for MoveIt: the group of the driven '
               'joints, the start of a scene as its state, all others passive', ('.srdf',)),
        Argument('--hardware', metavar='MODEL', type=Path,
                 help='have ros2_control simulate the scene, by closedloop_hardware: MODEL is '
                      'the C of `closedloop export`, compiled as a library'),
        Argument('--sensors', action='store_true',
                 help='with --hardware: the force in each cut joint is a sensor')),
    run=_run)
