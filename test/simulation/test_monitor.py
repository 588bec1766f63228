# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A running simulation knows its cost and its error, and moves no differently for it."""

from copy import deepcopy
from dataclasses import replace
import math
from types import SimpleNamespace

from closedloop_dynamics import Method, Simulation
from closedloop_dynamics.engine.types import RANK_REVEALING_COUNT
import numpy as np
import pytest

from ..reference import peaucellier

# Steps before the first whose error is estimated (``engine/run.cpp``).
FIRST_SAMPLE = 30


@pytest.mark.parametrize('method', [
    {'integrator': 'rk4'}, {'integrator': 'dop853'},
    {'integrator': 'rk4', 'stabilisation': 'independent'}])
def test_motion_is_the_same_without_samples_of_the_error(method):
    watched, alone = (Simulation.from_scene('three_rrr', **method) for _ in range(2))
    alone.stepping.monitor.sampling = False
    tau = watched.joint_torques({'theta_1': 5.0})
    for steps in (1, 7, 300, 25):
        watched.advance(tau, steps)
        alone.advance(tau, steps)
        assert np.array_equal(watched.position, alone.position)
        assert np.array_equal(watched.velocity, alone.velocity)


def test_cost_is_counted_from_the_reset():
    simulation = Simulation.from_scene('four_bar', integrator='rk4')
    assert simulation.report().steps == 0 and math.isnan(simulation.report().share)
    simulation.step(duration=0.5)
    report = simulation.report()
    assert report.steps == 500 and report.time == pytest.approx(0.5)
    assert report.time_per_step == report.compute_time / 500 > 0.0
    assert report.share == pytest.approx(report.compute_time / 0.5)
    assert report.evaluations >= 2000
    simulation.reset()
    assert simulation.report().steps == 0


def test_local_error_of_fixed_steps_is_that_of_a_step():
    coarse, fine = (
        Simulation.from_scene('four_bar', integrator='rk4', step_size=size)
        for size in (1e-2, 1e-5))
    coarse.step(duration=FIRST_SAMPLE * 1e-2)
    start = coarse.position, coarse.velocity
    fine.set_state(*start)
    coarse.reset()
    coarse.set_state(*start)
    coarse.step()
    fine.step(duration=1e-2)
    actual = np.abs(coarse.position - fine.position).max()
    assert coarse.report().local_error == pytest.approx(actual, rel=0.3)


def test_effects_act_on_the_copy_that_samples_are_computed_with():
    one = Simulation.from_scene('carpet_scraper_on_carpet')
    other = deepcopy(one.data.system)
    one.step(duration=0.1)
    other.effects.states[:] = one.data.system.effects.states
    for system in (one.data.system, other):
        system.native.evaluate(one.position, one.velocity)
    assert np.array_equal(other.qdd, one.data.system.qdd)


def test_local_error_of_error_control_is_below_the_tolerance():
    simulation = Simulation.from_scene('four_bar', integrator='dop853', tolerance=1e-7)
    simulation.step(duration=0.5)
    report = simulation.report()
    assert 1e-10 < report.local_error <= 1e-7
    assert 3 < report.steps < 100


def test_energy_error_includes_the_work_of_torques():
    simulation = Simulation.from_scene('four_bar')
    before = simulation.energy
    simulation.step({'crank_joint': 3.0}, 0.2)
    simulation.step({'crank_joint': -1.0}, 0.2)
    assert abs(simulation.energy - before) > 0.1
    assert abs(simulation.report().energy_error) < 1e-4


def test_report_reads_well():
    simulation = Simulation.from_scene('four_bar', integrator='rk4')
    simulation.step(duration=0.1)
    text = str(simulation.report())
    for word in ('us per step', '% of real time', 'rk4', 'local error', 'closure', 'energy'):
        assert word in text
    assert 'unknown' in str(replace(simulation.report(), local_error=math.nan))


@pytest.mark.parametrize('error, said', [(1.27, '1.3 J too much'), (-1.27, '1.3 J too little'),
                                         (math.nan, 'unknown J')])
def test_report_says_which_way_the_energy_is_off(error, said):
    report = replace(Simulation.from_scene('four_bar').report(), energy_error=error)
    assert said in str(report)


def singular_passage(start, rate, accuracy):
    """Return the largest error of Peaucellier's crank on its way, and the reported bound."""
    simulation = Simulation(replace(
        peaucellier.scene(start, rate), method=Method(accuracy=accuracy)))
    time, angle, error = 0.0, start, 0.0
    for _ in range(20):
        simulation.step(duration=0.09 / abs(rate))
        time += peaucellier.travel_time(start, rate, angle, simulation.position[0])
        angle = simulation.position[0]
        error = max(error, abs(simulation.velocity[0] * (time - simulation.time)))
    return error, simulation.report().error_bound


@pytest.mark.parametrize('start, rate', [(1.41, -23.97), (1.324, -23.5), (1.523, -22.04)])
def test_an_error_next_to_a_singular_configuration_is_below_its_bound(start, rate):
    error, bound = singular_passage(start, rate, 1e-9)
    # Rounding errors: three to five times a tenth of the distance to the companion run.
    assert 1e-12 < error < bound < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize('accuracy', [1e-6, 1e-9])
def test_errors_of_singular_passages_are_below_their_bounds(accuracy):
    rng = np.random.default_rng(5)
    for _ in range(100):
        start, rate = rng.uniform(0.85, 1.6), -rng.uniform(6.0, 25.0)
        error, bound = singular_passage(start, rate, accuracy)
        assert error < max(bound, 1e-12), (start, rate)


def test_the_bound_next_to_a_singular_position_is_what_is_judged(monkeypatch):
    simulation = Simulation.from_scene('four_bar', integrator='auto', accuracy=1e-6)
    simulation.step(duration=0.01)
    made = SimpleNamespace(**{
        **vars(simulation.stepping.run.steps), 'largest_bound': 1e-6, 'bound': 1e-6})
    monkeypatch.setattr(type(simulation.stepping.run), 'steps', made)
    assert simulation.report().findings == () and simulation.report().error_bound == 1e-6
    # There it may be all of the distance to the reference run, ten times as much.
    simulation.data.system.work.health[RANK_REVEALING_COUNT] = 1.0
    report = simulation.report()
    assert report.error_bound == pytest.approx(1e-5)
    assert any('accuracy of 1e-06' in finding and 'about 1e-05, as the motion came next to a' in
               finding for finding in report.findings)
