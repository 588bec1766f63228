# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of trajectories, checked on arrival."""

from closedloop_dynamics.control.references import TrajectoryError, Waypoints
import numpy as np

# Fields of a trajectory point, in the order of the derivatives.
KEYS = ('positions', 'velocities', 'accelerations')


def points_of(message, joints, held=True):
    """
    Return the Points of a JointTrajectory of all the joints, in their order.

    Of what is ``held`` at the last point the velocity must be zero there. Raises TrajectoryError
    for what cannot be followed.
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
    times = np.array([seconds_of(point.time_from_start) for point in message.points])
    if times[0] < 0.0 or np.any(np.diff(times) <= 0.0):
        raise TrajectoryError(
            f'time_from_start: expected increasing times from 0 s on, got {times.tolist()}')
    if held and len(derivatives) > 1 and np.any(derivatives[1][-1]):
        raise TrajectoryError('velocities: expected 0 in the last point, which is held')
    return Waypoints(seconds_of(message.header.stamp), times, derivatives)


def seconds_of(time):
    """Return a time or duration of a message [s]."""
    return time.sec + 1e-9 * time.nanosec
