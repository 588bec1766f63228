# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Trajectories in the time of their stamps."""

from closedloop_dynamics.control.references import Trajectory, TrajectoryError, Waypoints
import numpy as np
import pytest


def test_a_stamped_trajectory_reaches_its_points_at_the_times_of_its_stamp():
    places = np.array([[0.2, 0.0], [0.5, -0.3], [1.0, 0.4]])
    points = Waypoints(4.0, np.array([1.0, 2.0, 3.0]), [places])
    now = 5.5
    # The first point is over; the motion begins where the joints are.
    motion = Trajectory(points, now, np.array([0.3, -0.1]), np.array([0.7, 0.2]))
    np.testing.assert_allclose(motion.at(0.0, None), [[0.3, -0.1], [0.7, 0.2]], atol=1e-12)
    for time, place in ((6.0, places[1]), (7.0, places[2]), (9.0, places[2])):
        np.testing.assert_allclose(motion.at(time - now, None)[0], place, atol=1e-12)
    np.testing.assert_allclose(motion.at(7.0 - now, None)[1], 0.0, atol=1e-12)
    with pytest.raises(TrajectoryError, match='it was over 0.5 s ago'):
        Trajectory(points, 7.5, places[0], places[0])
