# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Number of steps that a simulation takes to follow a clock."""

import math
import time

# Unfinished simulated time older than this (in seconds of the steady clock) is
# dropped: long enough to make up for a hiccup of the machine, short enough
# that nobody waits for a simulation that plays back the past.
LARGEST_LAG = 0.1
# Steps are taken in portions of about this duration [s], between which the
# time left is looked at.
PORTION_TIME = 0.002
# Tolerates the rounding of the sum of many ticks: a step that is due up to a
# millionth of a step is due.
ROUNDING = 1e-6


class Pacer:
    """
    Decide how many steps to take so that simulated time follows the clock.

    Simulated time that could not be computed within a tick's budget stays due
    as long as it is no more than ``LARGEST_LAG`` behind; the rest is dropped
    and counted. So a tick's work is bounded, and a machine that is too slow
    runs slower than asked instead of ever further behind.

    Attributes
    ----------
    step_size : float
        [s] of simulated time.
    real_time_factor : float
        Simulated seconds per second of the clock.
    clock : callable
        Returns seconds; steady.
    simulated, elapsed, dropped : float
        Simulated time taken so far, time of the clock while running up to the last tick,
        simulated time given up so far [s].

    """

    def __init__(self, step_size, real_time_factor=1.0, clock=time.monotonic):
        self.step_size = step_size
        self.clock = clock
        self._factor = real_time_factor
        self._last = None
        self._due = 0.0
        self._cost = None
        self.simulated = 0.0
        self.elapsed = 0.0
        self.dropped = 0.0
        self._reported = 0.0, 0.0

    @property
    def real_time_factor(self):
        """Return the requested simulated seconds per second of the clock."""
        return self._factor

    @real_time_factor.setter
    def real_time_factor(self, value):
        # What has passed was due at the old factor.
        self._accrue(self.clock())
        self._factor = value

    @property
    def running(self):
        """Return whether time becomes due."""
        return self._last is not None

    @property
    def portion_of_step(self):
        """Return how much of the next step is due already, from 0 to 1."""
        return min(max(self._due / self.step_size, 0.0), 1.0)

    @property
    def behind(self):
        """Return whether steps are due that the last tick had no time for."""
        return self._due >= (1.0 - ROUNDING) * self.step_size

    @property
    def achieved(self):
        """Return the same as achieved so far; 0 before the first tick."""
        return self.simulated / self.elapsed if self.elapsed > 0 else 0.0

    def overload(self):
        """Return a message where steps are too slow, with the factor since the last time."""
        simulated, elapsed = self._reported
        achieved = (self.simulated - simulated) / (self.elapsed - elapsed)
        self._reported = self.simulated, self.elapsed
        return (
            f'this machine cannot keep up: {achieved:.3g} x real time instead of '
            f'{self.real_time_factor:g}; {self.dropped:.3f} s of simulated time dropped so far '
            '(a larger step_size or a smaller real_time_factor helps)')

    def start(self):
        """Start the clock."""
        self._last = self.clock()

    def stop(self):
        """Stop the clock until the next ``start()``."""
        self._accrue(self.clock())
        self._last = None

    def tick(self, take, budget, until=None):
        """
        Make the steps that are due, for a limited time; return the simulated time dropped [s].

        ``take(n)`` takes n steps, or where these take long a part of one: then it returns how
        many it took, and no more are begun, as after ``budget`` [s of the clock]. Steps are due up
        to ``until`` [s of the clock], or now.
        """
        begin = now = self.clock()
        self._accrue(now if until is None else until)
        steps = math.floor(self._due / self.step_size + ROUNDING)
        while steps > 0 and now - begin < budget:
            portion = min(steps, self._portion(begin + budget - now))
            taken = take(portion)
            steps = 0 if taken is not None else steps - portion
            done = portion if taken is None else taken
            self._due -= done * self.step_size
            self.simulated += done * self.step_size
            before, now = now, self.clock()
            if done > 0:
                self._cost = (now - before) / done
        return self._drop()

    def _accrue(self, now):
        if self._last is not None:
            self.elapsed += now - self._last
            self._due += (now - self._last) * self._factor
            self._last = now

    def _portion(self, left):
        """Return the number of steps that take about ``PORTION_TIME``, at least one."""
        if not self._cost:
            return 1
        return max(1, int(min(PORTION_TIME, left) / self._cost))

    def _drop(self):
        excess = self._due - max(LARGEST_LAG * self._factor, self.step_size)
        if excess <= 0.0:
            return 0.0
        self._due -= excess
        self.dropped += excess
        return excess
