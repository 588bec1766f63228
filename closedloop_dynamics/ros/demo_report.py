# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What happened in a demonstration, in words and pictures."""

from closedloop_dynamics.studies import pictures
from closedloop_dynamics.studies.motion import closure
import numpy as np

# After which a controller should have led the joints to their reference [s]; less in a short run.
SETTLING = 1.0
TURN = 2.0 * np.pi


def wanted_motion(recording, reference):
    """
    Return where all joints were to be, and how fast.

    Parameters
    ----------
    recording : demo_recording.Recording
        What they did.
    reference : torque_laws.Reference or None
        Of the actuated joints.

    Returns
    -------
    tuple of 2 ndarrays, shape (n, nv), or None
        NaN where nothing was wanted.

    """
    if reference is None:
        return None
    motion = recording.motion
    position, velocity = (np.full_like(motion.position, np.nan) for _ in range(2))
    actuated = _actuated(motion.mechanism)
    start = motion.position[0, actuated]
    for row, time in enumerate(motion.time):
        position[row, actuated], velocity[row, actuated] = reference.at(time, start)
    return position, velocity


def summary(recording, reference):
    """
    Say what happened.

    Parameters
    ----------
    recording : demo_recording.Recording
        What happened.
    reference : torque_laws.Reference or None
        What was to happen.

    Returns
    -------
    list of (str, str)
        Key and text of each line.

    """
    motion = recording.motion
    error = closure(motion.mechanism, motion.position).max()
    width = max(map(len, recording.arrivals))
    return [
        ('recorded', f'{recording.count} messages, {motion.time[-1]:.2f} s of motion'),
        *(('', f'{topic:{width}}  {len(times):6} messages at {recording.rate(topic):6.1f} Hz')
          for topic, times in sorted(recording.arrivals.items())),
        ('closure', f'loops closed within {error:.1e} m or rad in all {len(motion.time)} '
         'states of it'),
        *(('tracking', text) for text in _tracking(recording, reference)),
    ]


def _tracking(recording, reference):
    """Yield what is to be said about each kind of reference."""
    if reference is None:
        return
    motion = recording.motion
    settled = motion.time >= min(SETTLING, motion.time[-1] / 2.0)
    wanted, _ = wanted_motion(recording, reference)
    actuated = _actuated(motion.mechanism)
    turning = np.array(reference.velocity) != 0.0
    for k, joint in enumerate(actuated):
        if turning[k]:
            yield _speed(motion, settled, joint, reference.velocity[k])
    led = [joint for k, joint in enumerate(actuated) if not turning[k]]
    if led:
        error = (motion.position - wanted)[np.ix_(settled, led)]
        names = ', '.join(motion.mechanism.joint_names[joint] for joint in led)
        yield (f'{names} follow their reference within {np.sqrt(np.mean(error ** 2)):.2g} rad '
               f'(rms), {np.abs(error).max():.2g} rad (largest), once settled')


def _speed(motion, settled, joint, wanted):
    """Say how well a joint holds its speed, over whole turns if there are any."""
    time, angle, speed = (
        values[settled] for values in
        (motion.time, motion.position[:, joint], motion.velocity[:, joint]))
    travelled = np.abs(angle - angle[0])
    turns = int(travelled[-1] / TURN)
    end = np.interp(turns * TURN, travelled, time) if turns else time[-1]
    mean = (np.interp(end, time, angle) - angle[0]) / (end - time[0])
    ripple = speed - wanted
    return (f'{motion.mechanism.joint_names[joint]} turns at {mean:.4f} rad/s over {turns} whole '
            f'turns (wanted: {wanted:.4f}); ripple {np.sqrt(np.mean(ripple ** 2)):.2g} rad/s '
            f'(rms), {np.abs(ripple).max():.2g} rad/s (largest)')


def draw(recording, reference, scene, directory):
    """
    Write the pictures.

    Parameters
    ----------
    recording : demo_recording.Recording
        What happened.
    reference : torque_laws.Reference or None
        What was to happen.
    scene : str
        Its name.
    directory : pathlib.Path
        Where to.

    Returns
    -------
    list of pathlib.Path

    """
    motion = recording.motion
    figures = {
        'joint_motion.png': pictures.joint_motion(
            motion, f'{scene}: joint motion', wanted_motion(recording, reference)),
        'constraint_forces.png': pictures.constraint_forces(
            motion, f'{scene}: constraint forces in world axes'),
        'positions.png': pictures.positions(motion, f'{scene}: positions and forces'),
    }
    for name, figure in figures.items():
        figure.savefig(directory / name)
    return [directory / name for name in figures]


def _actuated(mechanism):
    return [index for index, joint in enumerate(mechanism.joints) if joint.actuated]
