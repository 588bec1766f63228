# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Steps of a simulation in time with a clock, made so that no page waits long for one."""

from contextlib import contextmanager
import math

import numpy as np

from ..simulation.pacer import Pacer, ROUNDING

# Share of the time between frames that may go into computing.
COMPUTING_SHARE = 0.6
# Share of the clock that may go into looking at states between frames, for paths and plots; how
# fast the measured duration of a look follows.
SAMPLING_SHARE, FOLLOWED = 0.2, 0.05
# A step that takes longer than the first, on the clock, is made in parts of about the second [s];
# no part is shorter than this share of the step.
LONGEST_STEP, PART_TIME, LEAST_PART = 0.02, 0.01, 0.01
# What takes longer on the clock is stopped [s], and made in parts so much smaller; the smallest
# ones take their time, unless a page wants something.
LONGEST_WAIT, SMALLER = 0.15, 0.1
# Steps that are requested one by one are made so many at once.
TOGETHER = 10


class Stepper:
    """
    Advances a simulation by a clock, or by steps that a page requests.

    ``every``: steps from one state that is looked at to the next: peaks between are not seen.
    ``clock`` returns seconds, steady; ``frame``: time between frames [s]; ``sample`` is called
    with time, row and thinning values of states between frames. ``playing``: whether the
    simulation follows the clock; ``speed``: simulated seconds per second of the clock that are
    asked for; ``watchdog``: stops what takes longer than LONGEST_WAIT, or None.
    """

    def __init__(self, clock, frame, sample):
        self._clock, self._frame, self._sample = clock, frame, sample
        self.playing, self.speed, self.watchdog, self.every = False, 1.0, None, 1

    def begin(self, simulation, driving, rows):
        """Go on with another simulation, under the torques of ``driving``, seen by ``rows``."""
        self._simulation, self._driving, self._rows = simulation, driving, rows
        # By which a budget compares computing time with the clock.
        simulation.stepping.pace = self.speed
        # Share of a step that is made at once, and steps that were requested one by one.
        self._part, self._single = 1.0, 0.0
        self._paced = 0.0, 0.0
        # Steps since the last sample between frames, and the time of a sample [s].
        self._unseen, self._sample_time = 0, 0.0
        self._keep_before()

    def restart(self):
        """Count the clock from zero."""
        self._pacer = Pacer(self._simulation.step_size, self.speed, self._clock)
        self._paced = 0.0, 0.0

    def play(self):
        """Follow the clock from now on."""
        self.playing = True
        self._keep_before()
        self._pacer.start()

    def stop(self):
        """Make no more steps."""
        if self.playing:
            self._pacer.stop()
        self.playing, self._single = False, 0.0

    @contextmanager
    def pause(self):
        """Suspend the clock within the context."""
        if self.playing:
            self._pacer.stop()
        try:
            yield
        finally:
            if self.playing:
                self._pacer.start()

    def ask_for(self, steps):
        """Make so many steps, as time allows."""
        self._single = float(steps)

    def set_speed(self, factor):
        """Follow the clock at another speed."""
        self.speed = self._pacer.real_time_factor = self._simulation.stepping.pace = factor
        self._keep_before()

    @property
    def wanted(self):
        """Return whether steps are to be made."""
        return self.playing or self._single > 0.0

    # Steps.

    def make(self):
        """Make the steps that are due now, for a part of the time between frames."""
        budget = COMPUTING_SHARE * self._frame
        if self.playing:
            self._pacer.step_size = self._simulation.step_size
            self._pacer.tick(self._advance, budget)
            return
        end = self._clock() + budget
        while self._single > ROUNDING and self._clock() < end:
            count = max(1, min(TOGETHER, round(self._single)))
            done = self._advance(count)
            self._single -= count if done is None else done
        if not self._single > ROUNDING:
            self._single = 0.0

    def _advance(self, steps):
        """Advance by steps, with the drives' torques renewed so often."""
        simulation, torques = self._simulation, self._driving.torques
        self.every = most = max(1, math.ceil(self.speed * self._sample_time / (
            SAMPLING_SHARE * simulation.step_size)))
        if math.isfinite(self._driving.period):
            most = min(most, max(1, round(self._driving.period / simulation.step_size)))
        wanted = steps
        while steps > 0:
            if self._part < 1.0:
                return wanted - steps + self._advance_a_part()
            portion = min(steps, most)
            # Slow motion shows states between the last two.
            if self._slow and portion == steps:
                if portion > 1:
                    simulation.advance(torques(), portion - 1)
                    portion = 1
                    steps = 1
                self._keep_before()
            at = simulation.time
            if self._measured(lambda: simulation.advance(torques(), portion),
                              portion) is not None:
                # Those before the one that was stopped are made.
                return wanted - steps + (simulation.time - at) / simulation.step_size
            steps -= portion
            self._unseen += portion
            if self._unseen >= self.every and not self._slow:
                self._sample_between()
        return None

    def _advance_a_part(self):
        """Advance by a part of a step, where one takes long; return which part."""
        part, simulation = self._part, self._simulation
        if self._measured(lambda: simulation.step(
                self._driving.torques()[simulation.data.actuated],
                part * simulation.step_size), part) == 0.0:
            return 0.0
        self._sample_between()
        return part

    def _measured(self, advance, steps):
        """
        Advance by steps, or a part of one; find which part can be made in a short time.

        Returns the steps that were made, None for all.
        """
        begin = self._clock()
        if self.watchdog is None:
            advance()
        elif not self.watchdog.does(advance, patient=self._part <= LEAST_PART):
            self._part = max(LEAST_PART, SMALLER * self._part)
            return 0.0
        took = self._clock() - begin
        if took / steps > LONGEST_STEP:
            self._part = min(0.5, max(LEAST_PART, PART_TIME * steps / took))
        elif self._part < 1.0:
            self._part = min(1.0, 2.0 * self._part)
        return None

    # What is seen of them.

    @property
    def _slow(self):
        """Whether frames come faster than steps."""
        return self.speed * self._frame < 2.0 * self._simulation.step_size

    def _keep_before(self):
        """Keep the present state as the first of the two between which slow motion shows some."""
        self._before = self._simulation.time, self._rows.row()

    def _sample_between(self):
        """Sample the present state and measure the time this takes; return its row."""
        begin, row = self._clock(), self._rows.row()
        self._sample(self._simulation.time, row, self._rows.thinning_values(row))
        self._unseen = 0
        self._sample_time += FOLLOWED * (self._clock() - begin - self._sample_time)
        return row

    def row(self):
        """Return the row of the present state, which is looked at, too, after new steps."""
        return self._sample_between() if self._unseen and not self._slow else self._rows.row()

    def frame(self, row):
        """Return time and row to show, in slow motion between the last state and the present."""
        now = self._simulation.time
        if not (self.playing and self._slow):
            return now, row
        begin, before = self._before
        share = self._pacer.portion_of_step
        return begin + share * (now - begin), before + np.float32(share) * (row - before)

    def achieved(self):
        """Return simulated seconds per second of the clock since the last call; None: unknown."""
        pacer, (simulated, elapsed) = self._pacer, self._paced
        self._paced = pacer.simulated, pacer.elapsed
        if not (self.playing and pacer.elapsed > elapsed):
            return None
        return float(f'{(pacer.simulated - simulated) / (pacer.elapsed - elapsed):.2g}')

    def achieved_by_part(self, elapsed):
        """Return the same while a part of a step takes so long [s]."""
        return float(f'{self._part * self._simulation.step_size / elapsed:.1g}')
