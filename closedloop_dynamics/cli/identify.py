# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop identify``: parameters of a mechanism from a recorded motion."""

from .command import (
    Argument, Command, complain, FAILED, Group, measured_options, picture_option, positive, SCENE,
    SET, UsageError, whole, with_numbers)
from ..kinematics.passive_joint_solver import PassiveJointError
from ..recording.measurements import read_measurements
from ..scene.loading import load_scene
from ..studies.excitation import excite
from ..studies.identification import driven_joints, identify, measured_joints
from ..visual.progress import announced
from ..visual.tables import text_table

AMPLITUDE, HARMONICS = 0.3, 3


def _run(arguments):
    if (arguments.recording is None) == (arguments.excite is None):
        raise UsageError('expected a recording to identify from, or --excite, which needs none')
    scene = with_numbers(load_scene(arguments.scene), arguments)
    try:
        joints = tuple(arguments.joints or measured_joints(scene))
        return (_identify if arguments.excite is None else _excite)(arguments, scene, joints)
    except PassiveJointError as error:
        return complain(arguments, error)
    except (OSError, ValueError) as error:
        raise UsageError(str(error)) from None


def _excite(arguments, scene, joints):
    with announced('Looking for a motion ...'):
        found = excite(scene, arguments.vary, arguments.excite, arguments.amplitude,
                       arguments.harmonics, joints=joints)
    print(f'{scene.name}: condition number {found.condition:.4g}, of a motion at random '
          f'{found.first:.4g}')
    for name, series in found.series.items():
        print(f'--motion "{name}={series}"')
    return 0


def _identify(arguments, scene, joints):
    with announced('Reading and compiling ...'):
        driven = driven_joints(scene)
        measured = read_measurements(arguments.recording, scene, joints, driven,
                                     arguments.deviation, arguments.namespace)
        found = identify(
            scene, arguments.vary, measured.motion, measured.effort, measured.others)
    print(f'{arguments.recording}: {len(found.samples)} of {len(measured.time)} instants of '
          f'{scene.name}, motion from {", ".join(joints)}, efforts of '
          f'{", ".join(driven) or "no joint"}; condition number {found.condition:.4g}')
    if found.estimates:
        print(text_table(('key', 'value', 'standard deviation', 'relative', ''), [
            (key, f'{one.value:.8g}', f'{one.deviation:.2g}', f'{100.0 * one.relative:.2g} %',
             'identified' if one.identified else 'not identified')
            for key, one in found.estimates.items()]))
    if found.combinations:
        print('sums and moments that are known:')
    for one in found.combinations:
        print(f'  {one}' + ('' if one.estimate is None else (
            f' = {one.estimate.value:.8g}, standard deviation {one.estimate.deviation:.2g}')))
    for what, names in (('not known alone', found.unknown),
                        ('without influence on this motion', found.unseen)):
        if names:
            print(f'{what}: {", ".join(names)}')
    for name, deviation in found.deviations.items():
        print(f'left of the efforts: {deviation:.3g} N m or N in {name} (standard deviation)')
    if arguments.picture is not None:
        _draw(arguments, scene, measured, found)
        print(f'picture in {arguments.picture}')
    for name, share in found.impossible.items():
        complain(arguments, f'mechanism.bodies.{name}: no distribution of mass has these numbers: '
                 f'an eigenvalue of the pseudo-inertia matrix is {share:.2g} of the largest')
    return FAILED if found.impossible else 0


def _draw(arguments, scene, measured, found):
    # Only here, as it takes long to load.
    from ..visual.pictures import over_drive
    time = measured.time[found.samples]
    curves = {'recorded effort [N m, N]': {
        name: (time, effort[found.samples]) for name, effort in measured.effort.items()}}
    curves['left of it [N m, N]'] = {
        name: (time, left) for name, left in zip(found.deviations, found.residuals.T)}
    over_drive(curves, 'time [s]', f'{scene.name}: efforts, and what the identified numbers leave '
               'of them').savefig(arguments.picture)


COMMAND = Command(
    name='identify',
    summary='parameters of a mechanism from a recorded motion',
    description="""\
Read a motion and the efforts of the drives, and find the numbers of the scene that
explain them: masses, centres of mass and inertias by linear least squares, in which forces
of the loops have no part; lengths, friction, springs and other numbers by nonlinear
ones. For each: the standard deviation, and whether it is below 10 % of the value. Where the
motion shows sums of parameters alone, these are named, and their parts get no numbers.
Numbers begin as they are in the scene.
""",
    examples=(
        'identify run.csv four_bar --vary mechanism.bodies.coupler.mass',
        'identify my_bag three_rrr_horizontal --vary mechanism.bodies --picture left.png',
        'identify four_bar --vary mechanism.bodies --excite 2 --amplitude 1'),
    failure='a body came out that cannot exist, or the motion does not follow from the '
            'measured joints',
    arguments=(
        Argument('recording', metavar='BAG_OR_CSV', nargs='?',
                 help='a bag, or what `closedloop simulate --output` wrote; none with --excite'),
        SCENE,
        Argument('--vary', metavar='KEY', nargs='+', action='extend', required=True,
                 help='numbers to be identified, by their key paths: '
                      'mechanism.bodies.crank.mass, effects.grease.coefficient, parameters.l; '
                      'mechanism.bodies.crank: mass, centre of mass and inertia; '
                      'mechanism.bodies: those of all bodies'),
        SET,
        *measured_options('driven ones, where they determine all others', 'rates and '
                          'accelerations are those of splines as smooth as it allows (default: '
                          '0, those recorded)'),
        Argument('--namespace', metavar='NAME',
                 help='of the simulator, where several are in the bag'),
        picture_option('recorded efforts, and what is left of them'),
        Group(
            'a motion to record',
            Argument('--excite', metavar='SECONDS', type=positive,
                     help='find a motion of this period that shows the numbers well, in place of '
                          'identifying them'),
            Argument('--amplitude', metavar='SIZE', type=positive, default=AMPLITUDE,
                     help='the most that a joint moves away from its start [rad or m] (default: '
                          f'{AMPLITUDE})'),
            Argument('--harmonics', metavar='N', type=whole(2, 20), default=HARMONICS,
                     help=f'terms of each Fourier series (default: {HARMONICS})'))),
    run=_run)
