# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop effects``: cost and influence of each effect of a scene."""

from .command import (
    Argument, assignment, checked_torques, Command, directory_options, free_paths, mapping, MOTION,
    positive, READING_OPTIONS, SCENE, scene_of, SET, TORQUE, UsageError)
from ..kinematics.motions import with_motions
from ..studies import effects_report
from ..studies.effects import study_effects
from ..visual.progress import parts_bar


def _run(arguments):
    scene = scene_of(arguments)
    torque, rates = mapping(arguments.torque, '--torque'), mapping(
        arguments.joint_rate, '--joint-rate')
    _check(arguments, scene, torque, rates)
    with parts_bar('parts', scene.name) as progress:
        study = study_effects(scene, arguments.duration, torque, rates, matters=arguments.matters,
                              progress=progress)
    print(effects_report.table(study))
    print(f'\n{effects_report.NOTE}\n\n{effects_report.summary(study)}\n\n'
          f'{effects_report.advice(study, arguments.matters)}')
    if arguments.output is not None:
        print('\n' + '\n'.join(map(str, effects_report.write(study, arguments.output))))
    return 0


def _check(arguments, scene, torque, rates):
    """Check arguments that would fail only after a while."""
    if not scene.effects:
        raise UsageError(f'{arguments.scene}: this scene lists no effects, there is nothing to '
                         'compare')
    if torque and rates:
        raise UsageError('--joint-rate: expected either --torque or --joint-rate, got both')
    actuated = with_motions(scene).actuated_joints
    if rates and set(rates) != set(actuated):
        raise UsageError('--joint-rate: expected one for every actuated joint '
                         f'({", ".join(actuated)}), got {", ".join(rates)}')
    free_paths(arguments, *effects_report.file_names(scene))
    checked_torques(arguments.scene, scene, torque)


COMMAND = Command(
    name='effects',
    summary='measure cost and influence of each effect of a scene',
    description="""\
Run a scene as it is, without each type of its effects, and with each type alone:
what the effects cost, in the time of one evaluation of the accelerations and in
the number of evaluations that the motion takes, and what they change in motion,
efforts, forces at the cut joints and energy. Then which of them matter, and what
leaving out the others saves. The drives get constant torques, or keep
constant rates. With --output: the table as CSV and Markdown, a picture of the
changes, and for every contact one of torque, contact forces and forces at the
cut joints over a turn of the drive.
""",
    examples=(
        'effects three_rrr_payload_friction --output results',
        'effects stewart_platform --matters 1e-4',
        'effects carpet_scraper_on_carpet --joint-rate theta_1=4.7124 --output results'),
    arguments=(
        SCENE, *READING_OPTIONS,
        *directory_options('SCENE_effects.csv, .md and .png, and a picture of every contact'),
        Argument('--duration', type=positive, default=2.0, metavar='SECONDS',
                 help='simulated time (default: 2)'),
        TORQUE, MOTION, SET,
        Argument('--matters', type=positive, default=1e-3, metavar='CHANGE',
                 help='change of positions that matters [rad or m]: effects that change less are '
                      'advised against (default: 1e-3)'),
        Argument('--joint-rate', type=assignment, action='append', default=[],
                 metavar='JOINT=VALUE',
                 help='keep an actuated joint at this rate [rad/s, m/s] instead; one for every '
                      'actuated joint')),
    run=_run)
