# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the pacer and the throttle with a clock that only moves when set."""

from closedloop_dynamics.ros.pacing import Throttle
from closedloop_dynamics.simulation.pacer import LARGEST_LAG, Pacer, PORTION_TIME
import numpy as np
import pytest

BUDGET = 0.008


class FakeMachine:
    """A clock and a simulation whose steps cost time of that clock."""

    def __init__(self, cost=0.0):
        self.now = 1000.0
        self.cost = cost
        self.steps = 0
        self.portions = []

    def clock(self):
        return self.now

    def take(self, steps):
        self.steps += steps
        self.portions.append(steps)
        self.now += steps * self.cost


def started(machine, step_size=0.001, factor=1.0):
    pacer = Pacer(step_size, factor, machine.clock)
    pacer.start()
    return pacer


@pytest.mark.parametrize('factor', [0.1, 1.0, 3.7])
@pytest.mark.parametrize('step_size', [1e-4, 0.001, 0.0037, 0.03])
def test_simulated_time_follows_the_clock_within_one_step(factor, step_size):
    machine = FakeMachine()
    pacer = started(machine, step_size, factor)
    rng = np.random.default_rng(1)
    for period in rng.uniform(0.001, 0.02, 2000):
        machine.now += period
        assert pacer.tick(machine.take, BUDGET) == 0.0
        due = (machine.now - 1000.0) * factor
        assert -1e-6 * step_size < due - machine.steps * step_size < step_size * (1 + 1e-6)
    assert pacer.achieved == pytest.approx(factor, rel=0.05)
    assert pacer.simulated == pytest.approx(machine.steps * step_size)


@pytest.mark.slow
def test_equal_ticks_take_equal_steps_for_an_hour():
    machine = FakeMachine()
    pacer = started(machine)
    for _ in range(360000):
        before = machine.steps
        machine.now += 0.01
        pacer.tick(machine.take, BUDGET)
        # A clock of floating-point numbers, so one step more or less may fall due.
        assert abs(machine.steps - before - 10) <= 1
    assert machine.steps == pytest.approx(3600000, abs=1)


def test_too_slow_machine_drops_time_and_never_spirals():
    machine = FakeMachine(cost=0.004)
    pacer = started(machine)
    dropped = 0.0
    for _ in range(1000):
        begin = machine.now
        dropped += pacer.tick(machine.take, BUDGET)
        assert machine.now - begin <= BUDGET + max(machine.cost, PORTION_TIME)
        machine.now = max(machine.now, begin + 0.01)
    elapsed = pacer.elapsed
    assert pacer.achieved == pytest.approx(0.001 / 0.004 * 0.8, rel=0.3)
    assert pacer.dropped == pytest.approx(dropped)
    assert pacer.simulated + pacer.dropped == pytest.approx(elapsed, abs=LARGEST_LAG + 0.01)


def test_hiccup_is_made_up_for_and_a_long_stop_is_not():
    machine = FakeMachine(cost=1e-5)
    pacer = started(machine)
    machine.now += 0.05
    assert pacer.tick(machine.take, BUDGET) == 0.0
    assert machine.steps == 50
    machine.now += 600.0
    dropped = pacer.tick(machine.take, BUDGET)
    assert dropped > 590.0
    assert machine.steps < 50 + 2 * BUDGET / machine.cost


def test_work_of_a_tick_is_bounded_however_much_is_due():
    machine = FakeMachine(cost=1e-6)
    pacer = started(machine, step_size=1e-6, factor=1000.0)
    for _ in range(5):
        machine.now += 1.0
        begin = machine.now
        pacer.tick(machine.take, BUDGET)
        assert machine.now - begin <= BUDGET + PORTION_TIME
    assert max(machine.portions) * machine.cost <= PORTION_TIME * 1.01


def test_change_of_factor_counts_from_now_on():
    machine = FakeMachine()
    pacer = started(machine)
    machine.now += 0.05
    pacer.real_time_factor = 0.5
    machine.now += 0.04
    pacer.tick(machine.take, BUDGET)
    assert machine.steps == 70


def test_stopped_pacer_takes_nothing_and_does_not_make_up():
    machine = FakeMachine()
    pacer = started(machine)
    machine.now += 0.02
    pacer.stop()
    machine.now += 100.0
    pacer.tick(machine.take, BUDGET)
    assert machine.steps == 20
    pacer.start()
    machine.now += 0.01
    pacer.tick(machine.take, BUDGET)
    assert machine.steps == 30
    assert pacer.dropped == 0.0
    assert pacer.elapsed == pytest.approx(0.03)


def test_throttle_lets_one_through_per_period_and_counts_the_rest():
    machine = FakeMachine()
    throttle = Throttle(5.0, machine.clock)
    assert throttle.ready()
    assert [throttle.ready() for _ in range(3)] == [False] * 3
    machine.now += 5.0
    assert throttle.ready()
    assert throttle.take_held_back() == 3
    assert throttle.take_held_back() == 0
