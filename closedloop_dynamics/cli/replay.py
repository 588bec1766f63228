# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop replay``: simulate a recording again and compare."""

import math

from .command import (
    Argument, Command, complain, picture_option, positive, recording_arguments, recording_of)
from ..recording.replay import PERTURBATION, replay, table
from ..visual.progress import announced, progress_to


def _run(arguments):
    with announced('Reading ...'):
        recording = recording_of(arguments, arguments.bag, other_machine=True)
    with progress_to(len(recording.motion.time), 'states', recording.scene.name) as show:
        result = replay(recording, show)
    _print_summary(arguments, recording, result)
    if arguments.picture:
        from ..visual import pictures
        title = f'{recording.scene.name}: recorded minus re-simulated'
        pictures.deviations(result, title).savefig(arguments.picture)
        print(f'picture in {arguments.picture}')
    return _judged(arguments, result)


def _judged(arguments, result):
    """Print deviations beyond the tolerance; return the exit code."""
    if arguments.tolerance is not None:
        why = (None if result.largest <= arguments.tolerance
               else f'by up to {result.largest:.3g}, more than {arguments.tolerance:g}')
    else:
        why = (None if result.unexplained is None
               else f'from {result.unexplained:.6g} s on by more than can be explained, up to '
                    f'{result.largest:.3g}')
    return 0 if why is None else complain(arguments, f'positions are off {why}')


def _print_summary(arguments, recording, result):
    motion = recording.motion
    print(f'{arguments.bag}: {len(motion.time)} states of {recording.scene.name}, '
          f'{motion.time.max() - motion.time.min():.6g} s, simulated again')
    if not recording.finished:
        print('the recording was cut short; what could be read of it is compared')
    for time, why in result.starts:
        print(f'  at {time:.6g} s: {why}')
    for note in result.notes:
        print(f'  note: {note}')
    print(f'\n{table(result)}\n\nlargest deviation of a position: {result.largest:.3g} rad or m')
    print(f'a difference of {PERTURBATION:g} at each start becomes {_grown(result)} by the end')


def _grown(result):
    growth = result.growth[-1]
    return (f'{growth * PERTURBATION:.2g} rad or m ({growth:.2g} times as much)'
            if math.isfinite(growth) else 'so large that the simulation fails')


COMMAND = Command(
    name='replay',
    summary='repeat a recorded simulation and report the deviations',
    description="""\
Simulate again what was recorded, from the recorded commands, and compare positions,
velocities, efforts and constraint forces of every state. The topics scene and replay_log
of the simulator make this exact: on the same machine the deviations are zero, elsewhere
those of rounding. Without replay_log, times are taken from the stamps and torques from the
efforts, which shows the motion but not the last digits. A second replay, started with a
difference of 1e-12, shows how sensitive the motion is, and so which deviations rounding
explains.
""",
    examples=(
        'replay my_bag',
        'replay my_bag --tolerance 1e-9 --picture deviations.png'),
    failure='a deviation is larger than rounding explains, or than --tolerance',
    arguments=(
        *recording_arguments('bag', 'BAG', what='directory of the bag, or one of its files'),
        Argument('--tolerance', metavar='ERROR', type=positive,
                 help='exit with 1 if a position is further off [rad or m] (default: than '
                      'rounding explains)'),
        picture_option('the deviations over time')),
    run=_run)
