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


"""
Where joints are to be, by time: waves about a motion, trajectories from messages, circles.

Every quantity is an array over the joints driven, in one order. A circle is that of a point of a
mechanism: smooth, periodic, from rest.

"""

from dataclasses import dataclass
import math

from closedloop_dynamics.visual.motion import body_poses, closure_errors, named_point, pose_of
import numpy as np
from scipy.interpolate import BPoly
from scipy.interpolate import CubicSpline

# Of what a point of a trajectory gives, in the order of the derivatives.
KEYS = ('positions', 'velocities', 'accelerations')
# Positions around the circle that the joints are solved for; their harmonics are exact to
# rounding for circles that keep away from singular configurations.
POSITIONS = 128
# Newton steps for each of them, and what must be left at most [m or rad].
ITERATIONS, TOLERANCE = 12, 1e-11
DIFFERENCE = 1e-6


@dataclass(frozen=True)
class Wave:
    """
    ``amplitude * sin(2 pi frequency t + phase)`` for every joint.

    Arrays of shape (n,): any unit, Hz, rad.

    """

    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def value(self, time):
        """Return the wave at a time [s]."""
        return self.amplitude * np.sin(2 * np.pi * self.frequency * time + self.phase)

    def rate(self, time):
        """Return its derivative with respect to time."""
        pulsation = 2 * np.pi * self.frequency
        return self.amplitude * pulsation * np.cos(pulsation * time + self.phase)

    def acceleration(self, time):
        """Return its second derivative with respect to time."""
        return -(2 * np.pi * self.frequency) ** 2 * self.value(time)


@dataclass(frozen=True)
class Reference:
    """
    Where a joint should be: a start, a constant velocity and a wave on top.

    Attributes
    ----------
    position, velocity : ndarray, shape (n,)
        At time 0 [rad or m], NaN: where the joint is then; [rad/s or m/s].
    wave : Wave
        [rad or m]; its value at time 0 is taken off, so that the reference
        begins at ``position`` whatever the phase.

    """

    position: np.ndarray
    velocity: np.ndarray
    wave: Wave

    def at(self, time, start):
        """Return position and velocity at a time [s] after the joints were at ``start``."""
        origin = np.where(np.isnan(self.position), start, self.position)
        wave = self.wave.value(time) - self.wave.value(0.0)
        return origin + self.velocity * time + wave, self.velocity + self.wave.rate(time)

    def acceleration(self, time):
        """Return the acceleration at a time [rad/s^2 or m/s^2]."""
        return self.wave.acceleration(time)


class TrajectoryError(ValueError):
    """A trajectory that cannot be followed; the message says what is wrong with it."""


@dataclass(frozen=True)
class Points:
    """
    The points of a trajectory.

    Attributes
    ----------
    stamp : float
        When its time begins [s]; 0: with the next state.
    times : ndarray, shape (n,)
        Of the points, from then on [s]; increasing.
    derivatives : list of ndarray, shape (n, number of joints)
        Positions; and velocities; and accelerations: as many as the points give.

    """

    stamp: float
    times: np.ndarray
    derivatives: list


def points_of(message, joints):
    """
    Return the Points of a JointTrajectory of all the joints, in their order.

    Raises TrajectoryError for what cannot be followed.

    """
    names = list(message.joint_names)
    if sorted(names) != sorted(joints):
        raise TrajectoryError(f'expected the joints {", ".join(joints)}, each once; got '
                              f'{", ".join(names) or "none"}')
    if not message.points:
        raise TrajectoryError('it has no points')
    order = [names.index(joint) for joint in joints]
    derivatives = []
    for key in KEYS:
        rows = [getattr(point, key) for point in message.points]
        if not any(map(len, rows)):
            break
        for index, row in enumerate(rows):
            if len(row) != len(joints):
                raise TrajectoryError(f'points[{index}].{key}: expected {len(joints)} values, '
                                      f'as other points have, got {len(row)}')
        values = np.array(rows, dtype=float)[:, order]
        if not np.isfinite(values).all():
            raise TrajectoryError(f'{key}: expected finite numbers')
        derivatives.append(values)
    if not derivatives:
        raise TrajectoryError('its points give no positions')
    for index, point in enumerate(message.points):
        if len(point.effort) or len(derivatives) < 2 and len(point.accelerations):
            raise TrajectoryError(f'points[{index}]: expected no effort, and accelerations only '
                                  'with velocities')
    times = np.array([_seconds(point.time_from_start) for point in message.points])
    if times[0] < 0.0 or np.any(np.diff(times) <= 0.0):
        raise TrajectoryError(
            f'time_from_start: expected increasing times from 0 s on, got {times.tolist()}')
    if len(derivatives) > 1 and np.any(derivatives[1][-1]):
        raise TrajectoryError('velocities: expected 0 in the last point, which is held')
    return Points(_seconds(message.header.stamp), times, derivatives)


def _seconds(time):
    return time.sec + 1e-9 * time.nanosec


class Trajectory:
    """
    The motion from a state through points, and rest at the last one.

    Polynomials of the fifth degree where the points give accelerations, of the third where they
    give velocities; else the cubic spline through their positions.

    Parameters
    ----------
    points : Points
        Those that are over are left out.
    time : float
        At which the joints are in the state [s], counted as ``points.stamp``; the time of the
        motion is zero then.
    position, velocity : ndarray, shape (number of joints,)
        The state.

    Raises
    ------
    TrajectoryError
        If it is over.

    """

    def __init__(self, points, time, position, velocity):
        times = points.times + (points.stamp - time if points.stamp else 0.0)
        ahead = times > 0.0
        if not ahead.any():
            raise TrajectoryError(f'it was over {-times[-1]:.3g} s ago')
        knots = np.concatenate(([0.0], times[ahead]))
        state = position, velocity, np.zeros_like(position)
        rows = [np.vstack([first, values[ahead]])
                for first, values in zip(state, points.derivatives)]
        if len(rows) > 1:
            motion = BPoly.from_derivatives(knots, np.stack(rows, axis=1))
        else:
            motion = CubicSpline(knots, rows[0], bc_type=(
                (1, velocity), (1, np.zeros_like(position))))
        self._end, self._rest = knots[-1], rows[0][-1]
        self._motion, self._rate = motion, motion.derivative()
        self._acceleration = self._rate.derivative()

    def at(self, time, start):
        """Return position and velocity at a time [s]; ``start`` is not looked at."""
        if time >= self._end:
            return self._rest, np.zeros_like(self._rest)
        return self._motion(time), self._rate(time)

    def acceleration(self, time):
        """Return the acceleration at a time [rad/s^2 or m/s^2]."""
        if time >= self._end:
            return np.zeros_like(self._rest)
        return self._acceleration(time)


class CircleError(ValueError):
    """A circle that the mechanism cannot follow; the message says why."""


def residual(mechanism, position, point, place, angle):
    """
    Return by how much loops are open and a point is away from a place.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Which is placed.
    position : ndarray, shape (..., nv)
        Joint coordinates [rad or m].
    point : mechanism.mechanism.Point
        That is to be in a place.
    place : ndarray, shape (2,)
        World [m].
    angle : float or None
        That its body is to have [rad]; None: any.

    Returns
    -------
    ndarray, shape (..., number of equations)

    """
    poses = body_poses(mechanism, position)
    parts = closure_errors(mechanism, poses)
    miss = named_point(mechanism, poses, point.name) - place
    parts += [miss[..., 0], miss[..., 1]]
    if angle is not None:
        parts.append(pose_of(mechanism, poses, point.body)[..., 2] - angle)
    return np.stack(parts, axis=-1)


def solve(mechanism, position, point, place, angle):
    """
    Return the joint positions, shape (nv,), that close the loops and bring a point to a place.

    ``position`` is nearby; the rest is as for ``residual``. Raises CircleError where there are
    none nearby, or many.

    """
    position = np.array(position, dtype=float)
    steps = DIFFERENCE * np.eye(len(position))
    for _ in range(ITERATIONS):
        left, *shifted = residual(
            mechanism, np.vstack([position, position + steps, position - steps]), point, place,
            angle)
        if np.abs(left).max() < TOLERANCE:
            return position
        count = len(position)
        jacobian = (np.array(shifted[:count]) - shifted[count:]).T / (2.0 * DIFFERENCE)
        move, _, rank, _ = np.linalg.lstsq(jacobian, -left, rcond=1e-9)
        if rank < count:
            break
        position = position + move
    raise CircleError(
        f"the mechanism cannot bring '{point.name}' to ({place[0]:.4g}, {place[1]:.4g}), or is "
        'singular there')


class Circle:
    """
    Positions, velocities and accelerations of joints while a point goes round.

    It begins at rest in the position given, on the circle, gains its speed within the first
    turn, and keeps the angle of the point's body where the mechanism has the freedom to.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        With two or three degrees of freedom.
    start : ndarray, shape (nv,)
        Where the joints begin, loops closed [rad or m].
    name : str
        Of the point.
    radius : float
        [m].
    frequency : float
        Turns per second [Hz].
    phase : float
        Angle at which it begins, seen from the centre [rad].
    joints : sequence of str
        Whose motion is asked for.

    Raises
    ------
    CircleError
        Where the mechanism cannot follow it.

    """

    def __init__(self, mechanism, start, name, radius, frequency, phase, joints):
        self.frequency = frequency
        freedoms = len(mechanism.joints) - mechanism.number_of_equations
        point = next((point for point in mechanism.points if point.name == name), None)
        if point is None:
            raise CircleError(
                f'expected one of the points of {mechanism.name} '
                f"({', '.join(each.name for each in mechanism.points)}), got '{name}'")
        if freedoms not in (2, 3):
            raise CircleError(
                f'{mechanism.name} has {freedoms} degrees of freedom by its equations; a circle '
                'of a point needs two, or three where the angle of its body is kept, too')
        poses = body_poses(mechanism, np.array(start))
        angle = pose_of(mechanism, poses, point.body)[2] if freedoms == 3 else None
        turn = np.linspace(0.0, 2.0 * math.pi, POSITIONS, endpoint=False)
        ways = radius * np.stack([np.cos(turn + phase), np.sin(turn + phase)], axis=1)
        self.center = named_point(mechanism, poses, name) - ways[0]
        table = [np.array(start, dtype=float)]
        for way in [*ways, ways[0]]:
            table.append(solve(mechanism, table[-1], point, self.center + way, angle))
        if np.abs(table[-1] - table[1]).max() > 1e-6:
            raise CircleError('the joints do not come back to where they began: the circle goes '
                              'round a singular configuration; choose a smaller one')
        chosen = [mechanism.joint_names.index(joint) for joint in joints]
        self._harmonics = np.fft.rfft(np.array(table[1:-1])[:, chosen], axis=0) / POSITIONS
        self._harmonics[1:] *= 2.0
        self._orders = 1j * np.arange(len(self._harmonics))[:, np.newaxis]

    def at(self, time, start=None):
        """Return position and velocity at a time [s]; ``start`` is not looked at."""
        position, slope, _, (turn_rate, _) = self._shape(time)
        return position, slope * turn_rate

    def acceleration(self, time):
        """Return the accelerations at a time [rad/s^2 or m/s^2]."""
        _, slope, curvature, (turn_rate, turn_acceleration) = self._shape(time)
        return curvature * turn_rate ** 2 + slope * turn_acceleration

    def place(self, turn):
        """Return positions at an angle travelled [rad]."""
        return np.real(self._harmonics * np.exp(self._orders * turn)).sum(axis=0)

    def _shape(self, time):
        """Return positions, their derivatives by the angle travelled, and its own by time."""
        turn, *rates = self._turn(max(0.0, time))
        waves = self._harmonics * np.exp(self._orders * turn)
        return (np.real(waves).sum(axis=0), np.real(self._orders * waves).sum(axis=0),
                np.real(self._orders ** 2 * waves).sum(axis=0), rates)

    def _turn(self, time):
        """Return the angle travelled, its rate and its acceleration; at rest in the beginning."""
        speed, ramp = 2.0 * math.pi * self.frequency, 1.0 / self.frequency
        share = time / ramp
        if share >= 1.0:
            return speed * (time - ramp / 2.0), speed, 0.0
        return (speed * ramp * (share ** 3 - share ** 4 / 2.0),
                speed * (3.0 * share ** 2 - 2.0 * share ** 3),
                speed * 6.0 * share * (1.0 - share) / ramp)
