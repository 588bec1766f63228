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
Laws of the torque source: torques as a function of time and joint state.

Every quantity is an array over the joints driven, in one order. They know
nothing of a mechanism.

"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Wave:
    """
    ``amplitude * sin(2 pi frequency t + phase)`` for every joint.

    Attributes
    ----------
    amplitude : ndarray, shape (n,)
    frequency : ndarray, shape (n,)
        [Hz].
    phase : ndarray, shape (n,)
        [rad].

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
    position : ndarray, shape (n,)
        At time 0 [rad or m]; NaN: where the joint is then.
    velocity : ndarray, shape (n,)
        [rad/s or m/s].
    wave : Wave
        [rad or m]; its value at time 0 is taken off, so that the reference
        begins at ``position`` whatever the phase.

    """

    position: np.ndarray
    velocity: np.ndarray
    wave: Wave

    def at(self, time, start):
        """
        Return position and velocity at a time.

        Parameters
        ----------
        time : float
            Since the first state [s].
        start : ndarray, shape (n,)
            Position of the joints at time 0.

        Returns
        -------
        tuple of 2 ndarrays

        """
        origin = np.where(np.isnan(self.position), start, self.position)
        wave = self.wave.value(time) - self.wave.value(0.0)
        return origin + self.velocity * time + wave, self.velocity + self.wave.rate(time)

    def acceleration(self, time):
        """Return the acceleration at a time [rad/s^2 or m/s^2]."""
        return self.wave.acceleration(time)


class ProportionalDerivative:
    """
    Proportional-derivative torques towards a reference, with integral and limit.

    ``tau = feedforward + kp e + kd de/dt + ki integral``, e the position error.
    The integral is that of the position error, and for a joint with kp = 0,
    whose speed is controlled and not its position, that of the velocity error.
    It rests while the torque of its joint is at the limit and would grow.

    Parameters
    ----------
    reference : Reference or studies.circle.Circle
    kp, kd, ki : ndarray, shape (n,)
        [N m/rad], [N m s/rad] and [N m/(rad s)], of a joint with kp = 0
        [N m/rad].
    feedforward : ndarray, shape (n,)
        [N m].
    limit : ndarray, shape (n,)
        Largest magnitude of the torque [N m]; infinite: none.
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
        """Take other gains; the torque of the integral goes on from what it is."""
        if self._first is not None:
            self._integral *= np.divide(self.ki, ki, out=np.zeros_like(ki), where=ki > 0.0)
        self.kp, self.kd, self.ki = kp, kd, ki
        self.feedforward, self.limit = feedforward, limit

    def restart(self):
        """Let the next state be the first one."""
        self._first = None

    def follow(self, reference, time):
        """Follow another reference, whose time 0 is the time given [s]; the integral stays."""
        if self._first is None:
            raise ValueError('no state has been answered yet')
        self.reference, self._first = reference, time

    def torque(self, time, position, velocity):
        """
        Return the torques for a state.

        Parameters
        ----------
        time : float
            [s], from any origin. The first state, and one from before the
            last (a simulation that was reset), starts the reference anew.
        position, velocity : ndarray, shape (n,)
            Of the joints [rad or m, and per s].

        Returns
        -------
        ndarray, shape (n,)

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
