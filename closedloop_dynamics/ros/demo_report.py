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
# On a busy machine DDS may take seconds to make nodes known to each other: said from here on [s].
LATE = 0.1
# Looked at when the beginning of the reference is found [s].
HEADSTARTS = np.arange(0.0, 1.0, 0.005)


def wanted_motion(motion, aim):
    """
    Return where all joints were to be, and how fast.

    Parameters
    ----------
    motion : studies.motion.Motion
        What they did.
    aim : torque_laws.ProportionalDerivative or None
        What led the actuated joints.

    Returns
    -------
    position, velocity : ndarray, shape (n, nv)
        NaN where nothing was wanted.
    headstart : float
        Time by which the reference was ahead of the motion [s].

    Notes
    -----
    The torque source starts its reference with the first state that it answers; the motion
    begins when that answer has arrived, which may be a period later. How much is found from the
    motion, as the shift that fits best. It is never negative, so that a joint that lags behind
    is not made to look better.

    """
    position, velocity = (np.full_like(motion.position, np.nan) for _ in range(2))
    if aim is None:
        return position, velocity, 0.0
    actuated = np.array(_actuated(motion.mechanism))
    led = aim.kp != 0.0
    time, start = motion.time[:, np.newaxis], motion.position[0, actuated]
    candidates = HEADSTARTS if led.any() else HEADSTARTS[:1]
    misses = [np.linalg.norm((aim.reference.at(time + shift, start)[0]
                              - motion.position[:, actuated])[:, led]) for shift in candidates]
    headstart = float(candidates[int(np.argmin(misses))])
    wanted, velocity[:, actuated] = aim.reference.at(time + headstart, start)
    position[:, actuated[led]] = wanted[:, led]
    return position, velocity, headstart


def summary(recording, aim):
    """
    Say what happened.

    Parameters
    ----------
    recording : demo_recording.Recording
        What happened.
    aim : torque_laws.ProportionalDerivative or None
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
        *(('', f'{topic:{width}}  {len(times):6} message'
           + (f's at {recording.rate(topic):6.1f} Hz' if len(times) > 1 else '')
           + (f', from {times[0]:.1f} s of motion on' if times[0] > LATE else ''))
          for topic, times in sorted(recording.arrivals.items())),
        ('closure', f'loops closed within {error:.1e} m or rad in all {len(motion.time)} '
         'states of it'),
        *(('tracking', text) for text in _tracking(motion, aim)),
    ]


def _tracking(motion, aim):
    """Yield what is to be said about each kind of aim."""
    if aim is None:
        return
    settled = motion.time >= min(SETTLING, motion.time[-1] / 2.0)
    wanted, _, headstart = wanted_motion(motion, aim)
    led = []
    for joint, speed in zip(_actuated(motion.mechanism), aim.reference.velocity):
        if speed != 0.0:
            yield _speed(motion, settled, joint, speed)
        elif np.isfinite(wanted[0, joint]):
            led.append(joint)
    if led:
        error = (motion.position - wanted)[np.ix_(settled, led)]
        names = ', '.join(motion.mechanism.joint_names[joint] for joint in led)
        ahead = f' (it began {headstart:.2f} s before them)' if headstart else ''
        yield (f'{names} follow their reference{ahead} within {np.sqrt(np.mean(error ** 2)):.2g} '
               f'rad (rms), {np.abs(error).max():.2g} rad (largest), once settled')


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


def draw(recording, aim, scene, directory):
    """
    Write the pictures.

    Parameters
    ----------
    recording : demo_recording.Recording
        What happened.
    aim : torque_laws.ProportionalDerivative or None
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
            motion, f'{scene}: joint motion', wanted_motion(motion, aim)[:2]),
        'constraint_forces.png': pictures.constraint_forces(
            motion, f'{scene}: constraint forces in world axes'),
        'positions.png': pictures.positions(motion, f'{scene}: positions and forces'),
    }
    for name, figure in figures.items():
        figure.savefig(directory / name)
    return [directory / name for name in figures]


def _actuated(mechanism):
    return [index for index, joint in enumerate(mechanism.joints) if joint.actuated]
