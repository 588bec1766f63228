# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Joint sensors: noise, bias, resolution and delay of measured states.

    y(t) = resolution round((x(t - delay) + bias + noise n) / resolution)

with n normally distributed, drawn once for each instant that is asked for, by the seed. Only what
``Simulation.measured`` returns and the node publishes is changed, never the true state. When: to
see whether a controller or an estimator can live with its encoders.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from .effect import Effect
from ..mechanism.checks import not_negative, number
from ..mechanism.fields import FieldError, shown


@dataclass(frozen=True)
class Sensor(Effect):
    """
    Errors of the joint sensors, the same for all joints, cut ones among them.

    Attributes
    ----------
    position_noise, velocity_noise : float
        Standard deviation, zero or more [rad, m; rad/s, m/s].
    position_bias, velocity_bias : float
        Added [rad, m; rad/s, m/s].
    position_resolution, velocity_resolution : float
        Step of quantisation; 0 for none [rad, m; rad/s, m/s].
    delay : float
        Age of the measured state, zero or more [s]; interpolated between steps.
    seed : int
        Of the noise, zero or more.

    """

    CHECKS = {'position_noise': not_negative, 'velocity_noise': not_negative,
              'position_bias': number, 'velocity_bias': number,
              'position_resolution': not_negative, 'velocity_resolution': not_negative,
              'delay': not_negative}

    position_noise: float = 0.0
    velocity_noise: float = 0.0
    position_bias: float = 0.0
    velocity_bias: float = 0.0
    position_resolution: float = 0.0
    velocity_resolution: float = 0.0
    delay: float = 0.0
    seed: int = 0

    def __post_init__(self):
        """Refuse impossible sensor parameters."""
        super().__post_init__()
        if type(self.seed) is not int or self.seed < 0:
            raise FieldError('a whole number that is zero or more', shown(self.seed),
                             path=('seed',))

    def fit(self, mechanism):
        """Refuse joints with orientations: readings are one number for each degree of freedom."""
        if len(mechanism.coordinates.balls):
            raise FieldError(
                'a mechanism without spherical and free joints in its tree, as sensors measure '
                'joints of one number', mechanism.name)

    def instrument(self, sequence=()):
        """Return the instrument, with the memory that a delay and a seed need."""
        return Instrument(self, sequence)


class Chain:
    """
    Sensors in series, each measuring the output of the one before it.

    Parameters
    ----------
    records : sequence of Effect
        Those that do not measure are passed over; without any the true state is measured.
    sequence : tuple of int
        Numbers that distinguish noises of one seed.

    """

    def __init__(self, records, sequence=()):
        self.instruments = [
            instrument for record in records
            if (instrument := record.instrument(sequence)) is not None]
        self._time = self._measured = None

    @property
    def remembers(self):
        """Whether a reading depends on the states in between."""
        return any(instrument.remembers for instrument in self.instruments)

    def forget(self):
        """Discard the latest reading, so that the same time is measured again."""
        self._time = None

    def measure(self, time, position, velocity):
        """Return the reading of a true state, shape (nv,); the same again for the same time."""
        if not self.instruments:
            return position, velocity
        if time != self._time:
            self._time, self._measured = time, (position.copy(), velocity.copy())
            for instrument in self.instruments:
                instrument.show(time, *self._measured)
                self._measured = instrument.read()
        return self._measured


class Instrument:
    """A sensor at work."""

    def __init__(self, record, sequence=()):
        """Start with an empty memory; ``sequence`` distinguishes noises of one seed."""
        self._record = record
        self._random = np.random.default_rng((record.seed, *sequence) if sequence else record.seed)
        self._past = deque()

    @property
    def remembers(self):
        """Whether every step must be recorded, because of its delay."""
        return self._record.delay > 0.0

    def show(self, time, position, velocity):
        """Record the true state at a time [s]; arrays of shape (nv,) are kept, not copied."""
        self._past.append((time, position, velocity))
        while len(self._past) > 2 and self._past[1][0] <= time - self._record.delay:
            self._past.popleft()

    def read(self):
        """Return position and velocity read at the latest time recorded, shape (nv,) each."""
        record, past = self._record, self._past
        wanted = past[-1][0] - record.delay
        position, velocity = past[0][1:]
        for (before, *old), (after, *new) in zip(past, list(past)[1:]):
            if after >= wanted and after > before:
                share = min(1.0, max(0.0, (wanted - before) / (after - before)))
                position, velocity = ((1.0 - share) * a + share * b for a, b in zip(old, new))
                break
        position = self._spoil(position, record.position_bias, record.position_noise,
                               record.position_resolution)
        velocity = self._spoil(velocity, record.velocity_bias, record.velocity_noise,
                               record.velocity_resolution)
        return position, velocity

    def _spoil(self, value, bias, noise, resolution):
        value = value + bias + noise * self._random.standard_normal(len(value))
        return resolution * np.round(value / resolution) if resolution > 0.0 else value
