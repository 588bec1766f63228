# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the modes of closedloop_dynamics.ros.pacing with a machine that only counts."""

from closedloop_dynamics.ros.pacing import (
    AsFastAsPossible, CHECK_EVERY, Lockstep, MOST_MADE_UP, period_steps, RealTime,
    TICKS_BEFORE_REPEAT)
from closedloop_dynamics.simulation.pacer import Pacer
import pytest


class Machine:
    """Counts steps; notes at how many of them it was asked to publish or to refresh."""

    def __init__(self):
        self.steps = 0
        self.published, self.refreshed, self.late = [], [], []

    def advance(self, steps):
        self.steps += steps

    def publish(self):
        self.published.append(self.steps)

    def is_received(self):
        return True

    def refresh(self, late=0.0):
        self.refreshed.append(self.steps)
        self.late.append(late)


@pytest.fixture
def machine():
    return Machine()


def build(kind, machine, rate, clock=lambda: 0.0, step_size=0.001):
    mode = kind(machine, Pacer(step_size, clock=clock))
    mode.set_rate(rate)
    mode.start()
    return mode


def test_rare_publishing_does_not_make_ticks_rare(machine):
    now = [0.0]
    mode = build(RealTime, machine, 0.5, lambda: now[0])
    assert mode.tick_period == pytest.approx(0.1)
    for _ in range(40):
        now[0] += mode.tick_period
        mode.tick()
    assert machine.steps == pytest.approx(4000, abs=1)
    assert machine.refreshed == pytest.approx([2000, 4000], abs=1)


def test_missed_ticks_are_counted_but_not_those_of_a_standstill(machine):
    now = [0.0]
    mode = build(RealTime, machine, 100.0, lambda: now[0])
    for late in (0.01, 0.011, 0.033, 0.009):
        now[0] += late
        mode.tick()
    # 0.033 s: three were due, of which one came.
    assert mode.missed_ticks == 2
    mode.stop()
    now[0] += 5.0
    mode.start()
    mode.tick()
    assert mode.missed_ticks == 2


def test_late_ticks_lose_no_state_and_every_state_is_that_of_its_time(machine):
    now = [0.0]
    mode = build(RealTime, machine, 1000.0, lambda: now[0], step_size=1e-4)
    # The first one, on time; then late ones, of which the third comes when two more are due.
    for moment in (0.001, 0.0025, 0.0031, 0.0067, 0.0070, 0.0080):
        now[0] = moment
        mode.tick()
    assert machine.refreshed == [10, 20, 30, 40, 50, 60, 70, 80]
    assert machine.late == pytest.approx(
        [0.0, 0.0005, 0.0001, 0.0027, 0.0017, 0.0007, 0.0, 0.0], abs=1e-9)
    assert (mode.missed_ticks, mode.left_out) == (2, 0)


def test_first_tick_that_was_late_does_not_make_the_others_late(machine):
    now = [0.0]
    mode = build(RealTime, machine, 1000.0, lambda: now[0], step_size=1e-4)
    for moment in (0.0014, 0.0020, 0.0030, 0.0040):
        now[0] = moment
        mode.tick()
    assert machine.refreshed == [14, 20, 30, 40]
    assert mode.missed_ticks == 0


def test_states_made_up_for_are_limited_and_those_left_out_are_counted(machine):
    now = [0.0]
    mode = build(RealTime, machine, 1000.0, lambda: now[0])
    for moment in (0.001, 0.0514, 0.052):
        now[0] = moment
        mode.tick()
    assert machine.refreshed == [1, *range(51 - MOST_MADE_UP, 52), 52]
    assert (mode.missed_ticks, mode.left_out) == (49, 49 - MOST_MADE_UP)


def test_machine_that_computes_too_slowly_makes_up_for_no_states(machine):
    now = [0.0]
    mode = build(RealTime, machine, 100.0, lambda: now[0])
    advance = machine.advance

    def slowly(steps):
        now[0] += 0.003 * steps
        advance(steps)

    machine.advance = slowly
    for _ in range(100):
        now[0] += 0.02
        begin = now[0]
        mode.tick()
        assert now[0] - begin < 0.02
    assert len(machine.refreshed) <= now[0] / mode.tick_period
    assert mode.left_out > 0


def test_nothing_that_was_due_is_made_up_for_while_time_stands_still(machine):
    now = [0.0]
    mode = build(RealTime, machine, 100.0, lambda: now[0])
    now[0] += 0.0105
    mode.stop()
    mode.tick()
    assert machine.steps == 0
    mode.start()
    mode.tick()
    assert machine.steps == 10


def test_as_fast_as_possible_publishes_every_period_of_simulated_time(machine):
    mode = build(AsFastAsPossible, machine, 1.0)
    while len(machine.published) < 3:
        mode.tick()
    assert machine.published[:3] == [1000, 2000, 3000]
    mode.stop()
    before = machine.steps
    mode.tick()
    assert machine.steps == before
    assert machine.refreshed == [before]
    assert mode.pacer.simulated == pytest.approx(1e-3 * before)


def test_as_fast_as_possible_waits_for_its_subscribers(machine):
    mode = build(AsFastAsPossible, machine, 1000.0)
    machine.is_received = lambda: False
    for _ in range(20):
        mode.tick()
    assert len(machine.published) == CHECK_EVERY
    machine.is_received = lambda: True
    mode.tick()
    assert len(machine.published) > CHECK_EVERY


def test_lockstep_advances_by_one_period_for_each_command_and_never_else(machine):
    mode = build(Lockstep, machine, 100.0)
    mode.tick()
    assert (machine.steps, machine.refreshed) == (0, [0])
    for _ in range(3):
        mode.on_command()
        mode.tick()
    assert machine.published == [10, 20, 30]
    # Whoever has begun to answer states gets each of them once.
    assert machine.refreshed == [0]


def test_lockstep_publishes_again_what_is_not_answered(machine):
    mode = build(Lockstep, machine, 100.0)
    for _ in range(3):
        mode.on_command()
        for _ in range(TICKS_BEFORE_REPEAT - 1):
            mode.tick()
    assert (machine.published, mode.repeated) == ([10, 20, 30], 0)
    for _ in range(TICKS_BEFORE_REPEAT + 1):
        mode.tick()
    assert (machine.published, mode.repeated) == ([10, 20, 30, 30, 30], 2)
    mode.on_command()
    mode.tick()
    assert (machine.published[-1], machine.steps, mode.repeated) == (40, 40, 2)


def test_lockstep_owes_the_period_of_a_command_that_came_during_a_pause(machine):
    mode = build(Lockstep, machine, 100.0)
    mode.stop()
    mode.on_command()
    mode.on_command()
    assert machine.steps == 0
    mode.start()
    assert machine.published == [10]
    mode.stop()
    mode.on_command()
    mode.restart()
    mode.start()
    assert machine.published == [10]


@pytest.mark.parametrize('rate, step_size, steps', [
    (100.0, 0.001, 10), (1000.0, 0.001, 1), (0.1, 0.001, 10000), (30.0, 1.0 / 3000.0, 100)])
def test_period_is_a_whole_number_of_steps(rate, step_size, steps):
    assert period_steps(rate, step_size) == steps


@pytest.mark.parametrize('rate, advice', [(300.0, '333.33'), (2000.0, '1000 Hz')])
def test_other_periods_are_refused_with_one_that_would_do(rate, advice):
    with pytest.raises(ValueError, match=advice):
        period_steps(rate, 0.001)
