# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Modes of simulated time: with the clock, as fast as possible, or command by command."""

import math
import time

REALTIME, AS_FAST_AS_POSSIBLE, LOCKSTEP = 'realtime', 'as_fast_as_possible', 'lockstep'
# Between two messages of one kind [s].
MESSAGE_PERIOD = 5.0
# Share of a tick that may go into computing; the rest is for messages.
COMPUTING_SHARE = 0.8
# However rarely states are published: signals and services are attended to so often [s].
LONGEST_TICK = 0.1
# States of ticks that were missed that are published late; those before them are left out. As long
# as that, nobody waits for a machine that is too slow for its rate.
MOST_MADE_UP = 10
# A tick may be so early, as a share of its period, and be the one that is due all the same.
EARLY = 0.05
# As long as nothing else is to be done [s].
IDLE_TICK = 0.05
# A state that is not answered is published again after so many of these ticks. Commands are taken
# between them: one that has come while this process was held up counts first.
TICKS_BEFORE_REPEAT = 20
# A mode that runs as fast as possible attends to messages so often [s].
SLICE = 0.005
# States published between two checks whether reliable subscribers have received them.
CHECK_EVERY = 200
# Steps made at once, between which a signal may end the process. Always the same: splitting the
# way differently would give error-controlled methods other last digits.
PORTION = 200


class Throttle:
    """Pass one message per period [s] and count those held back."""

    def __init__(self, period=MESSAGE_PERIOD, clock=time.monotonic):
        self.period = period
        self.clock = clock
        self.held_back = 0
        self._next = -math.inf

    def ready(self):
        """Return whether a message may pass now; count it as held back if not."""
        now = self.clock()
        if now < self._next:
            self.held_back += 1
            return False
        self._next = now + self.period
        return True

    def take_held_back(self):
        """Return how many were held back since the last message, and forget them."""
        held_back, self.held_back = self.held_back, 0
        return held_back


class RealTime:
    """
    Simulated time, which a Pacer counts, follows the steady clock times a factor.

    A tick that was missed is made up for in the next one: every state is that of the time at which
    it was due, however late the process was woken for it. ``missed_ticks`` came so late that the
    next one was due; ``left_out`` of them were not made up for; ``tick_period`` is in s of the
    steady clock.
    """

    name = REALTIME
    # Whether it waits for the answer to a first state; later ones published again.
    unanswered, repeated = False, 0

    def __init__(self, machine, pacer):
        self._machine, self.pacer = machine, pacer
        self.missed_ticks = self.left_out = 0
        # When the latest tick was due.
        self._due = None

    def set_rate(self, rate):
        """Publish ``rate`` times a second from now on."""
        self._ticks = math.ceil(1.0 / (rate * LONGEST_TICK))
        self._left = self._ticks
        self.tick_period = 1.0 / (rate * self._ticks)
        self._due = None

    def start(self):
        """Start the clock."""
        self._due = None
        self.pacer.start()

    def stop(self):
        """Stop the clock."""
        self.pacer.stop()

    def restart(self):
        """Begin at another state; whether time runs stays."""

    def on_command(self):
        """Do nothing: a command acts from the next tick on."""

    def tick(self):
        """Advance to the present, period by period, and publish."""
        missed = self._ticks_due() - 1
        if not self.pacer.running:
            # At rest the state is the same at every tick.
            missed = 0
        made_up = min(missed, MOST_MADE_UP)
        self.missed_ticks += missed
        self.left_out += missed - made_up
        budget = COMPUTING_SHARE * self.tick_period
        for behind in range(made_up, -1, -1):
            if behind and budget == 0.0:
                self.left_out += 1
                continue
            self._advance_to(self._due - behind * self.tick_period, budget)
            if self.pacer.behind:
                # It is computing that takes too long: more of the same would not help.
                budget = 0.0

    def _ticks_due(self):
        """Return the number of ticks that are due, and store when this one was."""
        now = self.pacer.clock()
        if self._due is None:
            self._due = now
            return 1
        ticks = max(1, math.floor((now - self._due) / self.tick_period + EARLY))
        # Ticks are late, never early: if this one seems to be, those before were late.
        self._due = min(self._due + ticks * self.tick_period, now)
        return ticks

    def _advance_to(self, due, budget):
        """Advance to the time at which a tick was due, and publish if it is time to."""
        pacer = self.pacer
        if pacer.running:
            pacer.tick(self._machine.advance, budget, due)
        self._left -= 1
        if self._left <= 0:
            self._left = self._ticks
            self._machine.refresh(pacer.clock() - due)


class _Periodic:
    """Shared part of the modes whose period is a number of steps, independent of the clock."""

    missed_ticks = left_out = repeated = 0
    unanswered = False

    def __init__(self, machine, pacer):
        self._machine, self.pacer = machine, pacer
        self.running = False

    def start(self):
        """Start the clock."""
        self.running = True

    def stop(self):
        """Stop the clock."""
        self.running = False

    def set_rate(self, rate):
        """Publish ``rate`` times per simulated second from now on."""
        self._period = self._left = period_steps(rate, self.pacer.step_size)

    def _advance(self, steps):
        begin = self.pacer.clock()
        while steps > 0:
            portion = min(steps, PORTION)
            self._machine.advance(portion)
            steps -= portion
            self.pacer.simulated += portion * self.pacer.step_size
        self.pacer.elapsed += self.pacer.clock() - begin


class AsFastAsPossible(_Periodic):
    """
    One period after the other, with messages attended to in between.

    It waits for reliable subscribers, so that none misses a state.
    """

    name = AS_FAST_AS_POSSIBLE

    def __init__(self, machine, pacer):
        super().__init__(machine, pacer)
        self._on_the_way = 0

    @property
    def tick_period(self):
        """Return the time between ticks [s of the steady clock]."""
        return 1e-4 if self.running else IDLE_TICK

    def restart(self):
        """Begin at another state; whether time runs stays."""
        self._left = self._period

    def on_command(self):
        """Do nothing: a command acts from the next tick on."""

    def tick(self):
        """Advance for a while."""
        if not self.running:
            self._machine.refresh()
            return
        if self._on_the_way >= CHECK_EVERY:
            if not self._machine.is_received():
                return
            self._on_the_way = 0
        end = time.monotonic() + SLICE
        while self.running and self._on_the_way < CHECK_EVERY and time.monotonic() < end:
            steps = min(self._left, PORTION)
            self._advance(steps)
            self._left -= steps
            if self._left == 0:
                self._left = self._period
                self._machine.publish()
                self._on_the_way += 1


class Lockstep(_Periodic):
    """
    One period for each command, nothing in between: the same run, bit for bit, every time.

    A state that no command answers is published again, and ``repeated`` counts how often: it, or
    the command, may be lost, or whoever answered may have been started again.
    """

    name = LOCKSTEP
    tick_period = IDLE_TICK

    def __init__(self, machine, pacer):
        super().__init__(machine, pacer)
        self._owed = False
        self._answered = False
        self._idle_ticks = 0

    @property
    def unanswered(self):
        """Return whether it waits for the answer to a first state."""
        return self.running and not self._answered

    def start(self):
        """Accept commands; one that came meanwhile acts now."""
        super().start()
        if self._owed:
            self.on_command()

    def restart(self):
        """Begin at another state, not yet answered."""
        self._owed = self._answered = False

    def on_command(self):
        """Advance by a period and publish the new state."""
        self._owed, self._idle_ticks = not self.running, 0
        if self.running:
            self._answered = True
            self._advance(self._period)
            self._machine.publish()

    def tick(self):
        """Publish the state again until it is answered."""
        if not (self._answered and self.running):
            self._machine.refresh()
            return
        self._idle_ticks += 1
        if self._idle_ticks % TICKS_BEFORE_REPEAT == 0:
            self._machine.publish()
            self.repeated += 1


def period_steps(rate, step_size):
    """
    Return the steps in a publishing period; raise ValueError where it is not a whole number.

    ``rate`` is in periods per simulated second [Hz], ``step_size`` in s.
    """
    steps = round(1.0 / (rate * step_size))
    if steps < 1 or abs(steps * rate * step_size - 1.0) > 1e-9:
        raise ValueError(
            f'publish_rate {rate:g} Hz: a period of {1.0 / rate:g} s is not a whole number of '
            'steps '
            f'of {step_size:g} s, which this mode needs; {1.0 / (max(steps, 1) * step_size):.10g} '
            'Hz would do')
    return steps


MODES = {mode.name: mode for mode in (RealTime, AsFastAsPossible, Lockstep)}
