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

"""Trajectories of joints: points with times, checked on arrival, and the motion through them."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly
from scipy.interpolate import CubicSpline

# Of what a point of a trajectory gives, in the order of the derivatives.
KEYS = ('positions', 'velocities', 'accelerations')


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
    Return the points of a message.

    Parameters
    ----------
    message : trajectory_msgs.msg.JointTrajectory
        Of all the joints, in any order.
    joints : sequence of str
        Those to drive; their order is that of the points.

    Returns
    -------
    Points

    Raises
    ------
    TrajectoryError

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
        """
        Return position and velocity at a time.

        Parameters
        ----------
        time : float
            [s].
        start : object
            Not looked at.

        Returns
        -------
        tuple of 2 ndarrays

        """
        if time >= self._end:
            return self._rest, np.zeros_like(self._rest)
        return self._motion(time), self._rate(time)

    def acceleration(self, time):
        """Return the acceleration at a time [rad/s^2 or m/s^2]."""
        if time >= self._end:
            return np.zeros_like(self._rest)
        return self._acceleration(time)
