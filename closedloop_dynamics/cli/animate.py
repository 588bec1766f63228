# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop animate``: a run as a moving picture."""

from .command import (
    Argument, Command, Output, positive, recording_arguments, recording_of, UsageError)
from ..recording.recording import since_the_last_reset
from ..visual.progress import announced, progress_to


def _run(arguments):
    # Only here, as it takes libraries of an extra.
    from ..visual.animation import (
        Animation, AnimationError, frame_times, require_writable, write)
    try:
        require_writable(arguments.output)
    except AnimationError as error:
        raise UsageError(f'--output: {error}') from None
    recording = recording_of(arguments, arguments.recording)
    motion = _chosen(recording.motion, arguments)
    try:
        times = frame_times(motion, arguments.rate, arguments.speed)
    except AnimationError as error:
        raise UsageError(f'{error}: choose a part with --start and --duration, or a greater '
                         '--speed') from None
    name = recording.scene.name
    with announced('Preparing the picture ...'):
        animation = Animation(motion, name, times, _point(motion.mechanism, arguments.point))
    with progress_to(len(times), 'frames', name) as show:
        write(animation, arguments.output, arguments.rate, show)
    print(f'{arguments.output}: {len(times)} frames, {motion.time[-1] - motion.time[0]:.3g} s of '
          f'{name} at {arguments.speed:g} x its speed, '
          f'{arguments.output.stat().st_size / 1e6:.2g} MB')
    return 0


def _chosen(motion, arguments):
    """Return the part of a motion that is to be shown."""
    motion = since_the_last_reset(motion)
    kept = motion.time >= arguments.start
    if arguments.duration is not None:
        kept &= motion.time <= arguments.start + arguments.duration
    if not kept.any():
        raise UsageError(
            f'--start, --duration: expected a part of the recording, {motion.time.min():g} to '
            f'{motion.time.max():g} s; got none')
    return motion.part(kept)


def _point(mechanism, name):
    names = [point.name for point in mechanism.points]
    if name is not None and name not in names:
        raise UsageError(f'--point: expected one of {", ".join(names) or "none"}, got {name}')
    return name


COMMAND = Command(
    name='animate',
    summary='make an animation of a run, with the forces at the cut joints',
    description="""\
Draw a recorded or simulated run as a moving picture: the mechanism, the path of a point, the
constraint forces as arrows and over time. What is shown after a reset is the run since then.
""",
    examples=(
        'animate my_bag --output run.gif',
        'simulate three_rrr --torque theta_1=5 --output run.csv',
        'animate run.csv --output run.gif --speed 0.5'),
    arguments=(
        *recording_arguments(),
        Output('--output', 'FILE', 'where to write it: a .gif, or a .mp4 where ffmpeg is '
               'installed', required=True),
        Argument('--point', metavar='NAME',
                 help='whose path is drawn (default: the first one of the mechanism)'),
        Argument('--rate', metavar='HZ', type=positive, default=20.0,
                 help='frames per second (default: 20)'),
        Argument('--speed', metavar='FACTOR', type=positive, default=1.0,
                 help='seconds of motion per second; below 1: slow motion (default: 1)'),
        Argument('--start', metavar='SECONDS', type=float, default=0.0,
                 help='time at which it begins (default: 0)'),
        Argument('--duration', metavar='SECONDS', type=positive,
                 help='how much of the motion is shown (default: all)')),
    run=_run)
