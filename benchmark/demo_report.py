# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""Report of a demonstration: wanted and recorded motion in words, pictures and a verdict."""

from dataclasses import dataclass, replace

from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.mechanism.kinematics import body_poses, named_point
from closedloop_dynamics.recording.reading import Bag
from closedloop_dynamics.recording.recording import read_recording
from closedloop_dynamics.visual import pictures
from closedloop_dynamics.visual.trajectory import Trajectory
import numpy as np

NANOSECONDS = 1e-9
SETTLING = 1.0
TURN = 2.0 * np.pi
FIRST_LATE = 0.1
HEADSTARTS = np.arange(0.0, 1.0, 0.005)
# What is as wanted. Mean speed and its ripple (rms), distance from a circle (largest): as shares
# of the speed and the radius; positions (rms) [rad or m]; closure [m or rad].
MEAN_SPEED, RIPPLE, OFF_CIRCLE, OFF_POSITION, OPEN = 0.01, 0.05, 0.05, 0.02, 1e-6
# How near a place is reached, as a share of the distance between places.
OFF_PLACE = 0.01
# What is representative: time dropped and states missing, states answered, as shares; the longest
# time without a command, in periods.
LOST, ANSWERED, SILENCE = 0.01, 0.9, 5.0


@dataclass(frozen=True)
class Run:
    """Contents of a bag for one scene."""

    motion: Trajectory  # From the last state at rest on; its time is that of the stamps since then
    simulated: float  # Simulated time of the motion [s]
    #: Times at which the messages of each topic were received [s], relative as above; those before
    #: the motion are negative (dict of str to ndarray).
    arrivals: dict

    def rate(self, topic):
        """Return the average number of messages per second [Hz]; NaN for fewer than two."""
        times = self.arrivals[topic]
        return (len(times) - 1) / np.ptp(times) if len(times) > 1 else np.nan


def read_run(path, namespace):
    """
    Read a bag of the demonstration, of a simulator in a namespace.

    Raises RecordingError where no states are in it, BagReadError where it cannot be read.
    """
    recording = read_recording(path, namespace=namespace)
    whole, stamps = recording.motion, recording.stamps
    # Time does not advance until the first command.
    begin = max(0, int(np.argmax(whole.time > whole.time[0])) - 1)
    motion = replace(whole.part(slice(begin, None)),
                     time=(stamps[begin:] - stamps[begin]) * NANOSECONDS)
    received = {}
    for message in Bag(path).serialised():
        topic = message.topic.name.removeprefix(f'{namespace}/')
        received.setdefault(topic, []).append(message.time)
    return Run(motion, whole.time[-1] - whole.time[begin], {
        topic: (np.array(times) - stamps[begin]) * NANOSECONDS
        for topic, times in received.items()})


def wanted_motion(motion, aim):
    """
    Return positions and velocities that all joints were to have, shape (n, nv), and a headstart.

    NaN where nothing was wanted. The headstart is the time by which the reference was ahead of the
    motion [s]: the torque source starts its reference with the first state that it answers; the
    motion begins when that answer has arrived, which may be a period later. How much is found
    from the motion, as the shift that fits best. It is never negative, so that a joint that lags
    behind is not made to look better.
    """
    position, velocity = (np.full_like(motion.velocity, np.nan) for _ in range(2))
    if aim is None:
        return position, velocity, 0.0
    actuated = np.array(_actuated(motion.mechanism))
    found = by_freedom(motion)[:, actuated]
    start = found[0]
    instants = np.arange(0.0, motion.time[-1] + HEADSTARTS[-1] + 0.01, 0.005)
    table = np.array([np.concatenate(aim.reference.at(time, start)) for time in instants])

    def wanted(headstart):
        values = [np.interp(motion.time + headstart, instants, column) for column in table.T]
        return np.split(np.array(values).T, 2, axis=1)

    candidates = HEADSTARTS if aim.led.any() else HEADSTARTS[:1]
    misses = [np.linalg.norm((wanted(shift)[0] - found)[:, aim.led])
              for shift in candidates]
    headstart = float(candidates[int(np.argmin(misses))])
    places, velocity[:, actuated] = wanted(headstart)
    position[:, actuated[aim.led]] = places[:, aim.led]
    return position, velocity, headstart


def summary(run):
    """Return a summary of the recording: key and text of each line."""
    motion = run.motion
    count, width = sum(map(len, run.arrivals.values())), max(map(len, run.arrivals))
    return [
        ('recorded', f'{count} messages, {motion.time[-1]:.2f} s of motion'),
        *(('', f'{topic:{width}}  {len(times):6} message'
           + (f's at {run.rate(topic):6.1f} Hz' if len(times) > 1 else '')
           + (f', from {times[0]:.1f} s of motion on' if times[0] > FIRST_LATE else ''))
          for topic, times in sorted(run.arrivals.items())),
        ('closure', f'loops closed within {_closure(motion):.1e} m or rad in all '
         f'{len(motion.time)} states of it')]


def _closure(motion):
    equations = Geometry(motion.mechanism).equations
    return max(equations.move(q).closure_error() for q in motion.position)


def compared(motion, aim):
    """
    Compare a motion with the desired one.

    Returns what is to be said of each aim, and what was not as wanted or None.
    """
    lines = []
    if aim is not None:
        settled = motion.time >= min(SETTLING, motion.time[-1] / 2.0)
        wanted, _, headstart = wanted_motion(motion, aim)
        led = []
        speeds = getattr(aim.reference, 'velocity', np.zeros(len(aim.led)))
        for joint, speed in zip(_actuated(motion.mechanism), speeds):
            if speed != 0.0:
                lines.append(_speed(motion, settled, joint, speed))
            elif np.isfinite(wanted[0, joint]):
                led.append(joint)
        if led:
            lines.append(_positions(motion, wanted, settled, led, headstart))
        if aim.circle:
            lines.append(_circle(motion, settled, *aim.circle))
        if aim.places:
            lines.append(_reached(motion, *aim.places))
    return lines


def open_loops(motion):
    """Return what is to be said of loops that did not stay closed: a list, empty if they did."""
    off = _closure(motion)
    return [] if off < OPEN else [f'the loops were open by {off:.1e} m or rad']


def _speed(motion, settled, joint, wanted):
    """Compare the speed of a joint, over whole turns if there are any."""
    time, angle, speed = (
        values[settled] for values in
        (motion.time, by_freedom(motion)[:, joint], motion.velocity[:, joint]))
    travelled = np.abs(angle - angle[0])
    turns = int(travelled[-1] / TURN)
    end = np.interp(turns * TURN, travelled, time) if turns else time[-1]
    mean = (np.interp(end, time, angle) - angle[0]) / (end - time[0])
    ripple = np.sqrt(np.mean((speed - wanted) ** 2))
    name = motion.mechanism.coordinates.names[joint]
    failure = None
    if mean * wanted < 0.0:
        failure = f'{name} turned backwards, at {mean:.4g} rad/s instead of {wanted:.4g} rad/s'
    elif not abs(mean - wanted) <= MEAN_SPEED * abs(wanted):
        failure = f'{name} turned at {mean:.4g} rad/s instead of {wanted:.4g} rad/s'
    elif not ripple <= RIPPLE * abs(wanted):
        failure = (f'the speed of {name} had a ripple of {ripple:.2g} rad/s (rms), more than '
                   f'{100.0 * RIPPLE:g} % of {wanted:.4g} rad/s')
    return (f'{name} turns at {mean:.4f} rad/s over {turns} whole turns (wanted: {wanted:.4f}); '
            f'ripple {ripple:.2g} rad/s (rms), {np.abs(speed - wanted).max():.2g} rad/s '
            '(largest)', failure)


def _positions(motion, wanted, settled, led, headstart):
    """Compare the positions of joints with a reference that moves."""
    error = (by_freedom(motion) - wanted)[np.ix_(settled, led)]
    rms, names = np.sqrt(np.mean(error ** 2)), ', '.join(
        motion.mechanism.coordinates.names[joint] for joint in led)
    ahead = f' (it began {headstart:.2f} s before them)' if headstart else ''
    failure = None
    if not rms <= OFF_POSITION:
        failure = f'{names} were {rms:.2g} rad (rms) away from their reference'
    return (f'{names} follow their reference{ahead} within {rms:.2g} rad (rms), '
            f'{np.abs(error).max():.2g} rad (largest), once settled', failure)


def _circle(motion, settled, point, center, radius):
    """Compare the path of a point with a circle."""
    places = named_point(motion.mechanism, body_poses(motion.mechanism, motion.position), point)
    x, y, *height = (places - center).T
    off = np.abs(np.hypot(x, y) - radius)
    # In space the circle is a horizontal one.
    off = np.max(np.hypot(off, height[0] if height else 0.0)[settled])
    failure = None
    if not off <= OFF_CIRCLE * radius:
        failure = f'{point} was {1e3 * off:.2g} mm away from its circle of {radius:g} m radius'
    return (f'{point} stays within {1e3 * off:.2g} mm of a circle of {radius:g} m radius, once '
            'settled', failure)


def _reached(motion, point, places, period):
    """Compare the path of a point with the places that it is to reach."""
    path = named_point(motion.mechanism, body_poses(motion.mechanism, motion.position), point)
    miss = max(np.linalg.norm(path - place, axis=1).min() for place in places)
    extent, failure = np.linalg.norm(np.ptp(places, axis=0)), None
    if motion.time[-1] < period:
        return f'{point} had not the time for all its {len(places)} places', None
    if not miss <= OFF_PLACE * extent:
        failure = f'{point} came no nearer than {1e3 * miss:.2g} mm to one of its places'
    return f'{point} comes within {1e3 * miss:.2g} mm of each of its {len(places)} places', failure


def by_freedom(motion):
    """Return the positions of joints as velocities have them, shape (n, nv); 0 of rotations."""
    places = motion.mechanism.coordinates.place
    return np.where(places >= 0, motion.position[:, places], 0.0)


def not_representative(run, duration):
    """
    Return why a run of a duration [s] does not show how the same nodes run given time.

    Empty where it is representative.
    """
    time, reasons = run.motion.time, []
    if len(time) < 3 or not run.simulated > 0.5 * duration:
        return [f'only {run.simulated:.2f} s of {duration:g} s were simulated, in '
                f'{len(time)} recorded states']
    period = np.median(np.diff(time))
    dropped = time[-1] - run.simulated
    if dropped > LOST * time[-1]:
        reasons.append(f'{dropped:.2f} s of {time[-1]:.2f} s were dropped, as simulating took '
                       'longer than the time there was')
    missing = int(np.sum(np.round(np.diff(time) / period) - 1))
    if missing > LOST * len(time):
        reasons.append(f'{missing} of {len(time) + missing} states are missing')
    commands = run.arrivals.get('torque_command', np.zeros(0))
    commands = commands[commands > 0.0]
    if len(commands) > 1:
        # The recorder may find the torque source late.
        states = np.sum((time >= commands[0]) & (time <= commands[-1]))
        if len(commands) < ANSWERED * states:
            reasons.append(f'{len(commands)} of {states} states were answered by a command')
        silence = np.diff(commands).max()
        if silence > SILENCE * period:
            reasons.append(f'for {silence:.2f} s no command came')
    return reasons


def draw(motion, aim, scene, directory):
    """Write the pictures of a motion into a directory; return their paths."""
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
    return list(mechanism.coordinates.actuated)
