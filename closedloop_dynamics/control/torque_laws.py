# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Torques from the state of joints and where they are to be.

For the same acceleration a mechanism with closed loops may need a hundred times the torque in one
position that it needs in another, so that gains that are stable in one position are unstable in
another. With the model between them (computed torque), the controller sees a unit inertia
everywhere.
"""

import math

import numpy as np

from .references import Trajectory

# A torque answers a state, acts from that state on and is held for one period:
# in the middle of which, half a period ahead, it should be right.
LEAD_PERIODS = 0.5
# The period is the shortest time between two states; by this share a longer one makes it longer.
# States that were missed, as on a busy machine, must not make it longer: a state carried forward
# by a hundredth of a second too much may be on the other side of a dead centre.
RELAXATION = 0.01


class ProportionalDerivative:
    """
    Proportional-derivative torques towards a reference, with integral and limit.

    ``tau = feedforward + kp e + kd de/dt + ki integral``, e the position error.
    The integral is that of the position error, and for a joint with kp = 0,
    whose speed is controlled and not its position, that of the velocity error.
    It rests while the torque of its joint is at the limit and would grow.

    Parameters
    ----------
    reference : references.Reference, references.CircularPath or references.PointToPointPath
    kp, kd, ki : ndarray, shape (n,)
        [N m/rad], [N m s/rad] and [N m/(rad s)], of a joint with kp = 0 [N m/rad].
    feedforward, limit : ndarray, shape (n,)
        Torque added, largest magnitude of the torque (infinite: none) [N m].
    inertia : float
        By which the acceleration of the reference is multiplied, to be added: 1 where the
        torques are taken for accelerations.

    """

    def __init__(self, reference, kp, kd, ki, feedforward, limit, inertia=0.0):
        self.reference = reference
        self.inertia = inertia
        self.kp, self.kd, self.ki = kp, kd, ki
        self.feedforward = feedforward
        self.limit = limit
        self._first = None

    def tune(self, kp, kd, ki, feedforward, limit):
        """Set other gains; the torque of the integral stays continuous."""
        if self._first is not None:
            self._integral *= np.divide(self.ki, ki, out=np.zeros_like(ki), where=ki > 0.0)
        self.kp, self.kd, self.ki = kp, kd, ki
        self.feedforward, self.limit = feedforward, limit

    def restart(self):
        """Treat the next state as the first one."""
        self._first = None

    def follow(self, reference, time):
        """Follow another reference, whose time 0 is the time given [s]; the integral stays."""
        if self._first is None:
            raise ValueError('no state has been answered yet')
        self.reference, self._first = reference, time

    def desired(self, time):
        """Return positions and velocities of the reference at a time [s], shape (2, n)."""
        return np.array(self.reference.at(time - self._first, self._start))

    def torque(self, time, position, velocity):
        """
        Return the torques for a state, shape (n,).

        The time [s] has any origin: the first state, and one from before the last (a simulation
        that was reset), starts the reference again. Position and velocity have shape (n,).
        """
        if self._first is None or time < self._last:
            self._first = self._last = time
            self._start = np.array(position)
            self._integral = np.zeros_like(self._start)
        target, target_rate = self.reference.at(time - self._first, self._start)
        error, error_rate = target - position, target_rate - velocity
        integrand = np.where(self.kp == 0.0, error_rate, error)
        integral = self._integral + integrand * (time - self._last)
        self._last = time
        wanted = (self.feedforward + self.kp * error + self.kd * error_rate
                  + self.ki * integral)
        if self.inertia:
            wanted = wanted + self.inertia * self.reference.acceleration(time - self._first)
        torque = np.clip(wanted, -self.limit, self.limit)
        winding_up = (wanted != torque) & (self.ki * integrand * wanted > 0.0)
        self._integral = np.where(winding_up, self._integral, integral)
        return torque


class ComputedTorque:
    """
    Torques of all actuated joints for requested accelerations.

    Of the simulation, the model, the state is not used. The controller's torques are taken for
    accelerations [rad/s^2 or m/s^2]. ``feedforward`` is added always, ``limit`` is the largest
    magnitude, infinite: none; both of shape (n,) [N m or N].
    """

    def __init__(self, simulation, controller, feedforward, limit):
        self._simulation = simulation
        self.controller = controller
        self._feedforward = feedforward
        self.torque_limit = limit
        self._actuated = simulation.data.actuated
        self._coordinates = simulation.coordinates
        self._torque = np.zeros(len(self._actuated))
        self._last = None

    def tune(self, kp, kd, ki, feedforward, limit):
        """Set other gains."""
        none = np.zeros_like(limit)
        self.controller.tune(kp, kd, ki, none, none + np.inf)
        self._feedforward, self.torque_limit = feedforward, limit

    def restart(self):
        """Treat the next state as the first one."""
        self._last = None
        self._torque[:] = 0.0
        self.controller.restart()

    def follow(self, points, time, position, velocity):
        """
        Follow ``references.Waypoints`` from the present state, in place of the last reference.

        Time [s], position, shape (nq,), and velocity, shape (nv,), are those of the state. Raises
        TrajectoryError if the trajectory is over.
        """
        position = self._coordinates.by_freedom(position)
        self.controller.follow(Trajectory(
            points, time, position[self._actuated], velocity[self._actuated]), time)

    def desired(self, time):
        """Return positions and velocities of the reference at a time [s], shape (2, n)."""
        return self.controller.desired(time)

    def torque(self, time, position, velocity):
        """Return the torques, shape (n,), for a state, shapes (nq,), (nv,), at a time [s]."""
        position, velocity = self._simulation.closed(position, velocity)
        # A state that closes no loops changes nothing.
        lead = self._lead(time)
        acceleration, _ = self._simulation.forward_dynamics(position, velocity, self._torque)
        if len(self._coordinates.balls):
            position = self._coordinates.moved(
                position, lead * velocity + 0.5 * lead ** 2 * acceleration)
        else:
            position = position + lead * velocity + 0.5 * lead ** 2 * acceleration
        velocity = velocity + lead * acceleration
        wanted = self.controller.torque(
            time + lead, self._coordinates.by_freedom(position)[self._actuated],
            velocity[self._actuated])
        torque = self._torque_for(wanted, position, velocity) + self._feedforward
        if np.isfinite(torque).all():
            self._torque = np.clip(torque, -self.torque_limit, self.torque_limit)
        return self._torque

    def _torque_for(self, wanted, position, velocity):
        """Solve the actuated rows of ``qdd = free + response tau`` for tau."""
        units = np.eye(len(self._actuated))
        position, velocity = self._simulation.closed(position, velocity)
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
