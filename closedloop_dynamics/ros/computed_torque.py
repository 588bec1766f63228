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
Computed torque: accelerations that a controller asks for, made by the model of a scene.

A mechanism with closed loops may need a hundred times the torque in one
position that it needs in another, for the same acceleration. Gains that hold
it in the one shake it to pieces in the other. With the model between them, the
controller sees a unit inertia everywhere.

"""

import math

from closedloop_dynamics.ros.trajectory import Trajectory
import numpy as np

# A torque answers a state, acts from that state on and is held for one period:
# in the middle of which, half a period ahead, it should be right.
LEAD_PERIODS = 0.5
# The period is the shortest time between two states; by this share a longer one makes it longer.
# States that were missed, as on a busy machine, must not make it longer: a state carried forward
# by a hundredth of a second too much may be on the other side of a dead centre.
RELAXATION = 0.01


class ComputedTorque:
    """
    Torques of all actuated joints for the accelerations that a controller asks for.

    Parameters
    ----------
    simulation : Simulation
        The model; its own state is not used.
    controller : torque_laws.ProportionalDerivative
        Its torques are taken for accelerations [rad/s^2 or m/s^2].
    feedforward : ndarray, shape (n,)
        Added always [N m or N].
    limit : ndarray, shape (n,)
        Largest magnitude [N m or N]; infinite: none.

    """

    def __init__(self, simulation, controller, feedforward, limit):
        self._simulation = simulation
        self._controller = controller
        self._feedforward = feedforward
        self._limit = limit
        self._actuated = [
            simulation.joint_names.index(name) for name in simulation.actuated_joints]
        self._torque = np.zeros(len(self._actuated))
        self._last = None

    def tune(self, kp, kd, ki, feedforward, limit):
        """Take other gains."""
        none = np.zeros_like(limit)
        self._controller.tune(kp, kd, ki, none, none + np.inf)
        self._feedforward, self._limit = feedforward, limit

    def restart(self):
        """Let the next state be the first one."""
        self._last = None
        self._torque[:] = 0.0
        self._controller.restart()

    def follow(self, points, time, position, velocity):
        """
        Follow a trajectory from the present state, in place of the reference there was.

        Parameters
        ----------
        points : trajectory.Points
            In the order of the joints.
        time : float
            Of the state [s].
        position, velocity : ndarray, shape (nv,)
            Of all joints of the scene [rad or m, and per s].

        Raises
        ------
        TrajectoryError
            If it is over.

        """
        self._controller.follow(Trajectory(
            points, time, position[self._actuated], velocity[self._actuated]), time)

    def torque(self, time, position, velocity):
        """
        Return the torques for a state.

        Parameters
        ----------
        time : float
            [s], from any origin.
        position, velocity : ndarray, shape (nv,)
            Of all joints of the scene [rad or m, and per s].

        Returns
        -------
        ndarray, shape (n,)

        """
        lead = self._lead(time)
        acceleration, _ = self._simulation.forward_dynamics(position, velocity, self._torque)
        position = position + lead * velocity + 0.5 * lead ** 2 * acceleration
        velocity = velocity + lead * acceleration
        wanted = self._controller.torque(
            time + lead, position[self._actuated], velocity[self._actuated])
        torque = self._torque_for(wanted, position, velocity) + self._feedforward
        if np.isfinite(torque).all():
            self._torque = np.clip(torque, -self._limit, self._limit)
        return self._torque

    def _torque_for(self, wanted, position, velocity):
        """Solve the actuated rows of ``qdd = free + response tau`` for tau."""
        units = np.eye(len(self._actuated))
        free, *responses = (
            self._simulation.forward_dynamics(position, velocity, torque)[0][self._actuated]
            for torque in (np.zeros(len(units)), *units))
        response = np.transpose(responses) - free[:, np.newaxis]
        try:
            return np.linalg.solve(response, wanted - free)
        except np.linalg.LinAlgError:
            # A position in which the actuated joints cannot move on their own.
            return np.full(len(units), np.nan)

    def _lead(self, time):
        """Return half the period between states; 0 until there is one."""
        if self._last is None or time < self._last:
            self._period = math.inf
        elif time > self._last:
            self._period = min(time - self._last, (1.0 + RELAXATION) * self._period)
        self._last = time
        return LEAD_PERIODS * self._period if math.isfinite(self._period) else 0.0
