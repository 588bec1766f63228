# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The accuracy follows a budget of computing time: by numbers alone, so that no test is timed."""

from dataclasses import replace
import math

from closedloop_dynamics import load_scene, Method, Model, rollout, Simulation, State
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.simulation.budget import (
    allowed, Budget, COARSEST, FINEST, INTERVAL, MOST_DECADES, PERIOD)
from closedloop_dynamics.sweep import sweep
import numpy as np
import pytest

TORQUE = [5.0, -3.0, 2.0]
# As in the tests of the default method.
KEPT = 3.0


def follow(budget, cost, intervals, accuracy=1e-6, waiting=lambda time: 1.0):
    """
    Return the accuracies of a machine whose computing takes ``cost(accuracy, time)`` of a core.

    By the clock it takes ``waiting(time)`` times that.
    """
    found = []
    for number in range(intervals):
        time = number * INTERVAL
        spent = INTERVAL * cost(accuracy, time)
        accuracy = budget.choose(accuracy, INTERVAL, spent, waiting(time) * spent)
        found.append(accuracy)
    return found


def order_eight(accuracy, share=0.1):
    """Return what an accuracy takes, where 1e-6 takes a share."""
    return share * (1e-6 / accuracy) ** 0.125


@pytest.mark.parametrize('share', [0.033, 0.06, 0.1, 0.15, 0.3])
def test_the_best_accuracy_is_found_that_the_budget_allows(share):
    found = follow(Budget(share, 1e-6), lambda accuracy, _: order_eight(accuracy), 400)
    assert order_eight(found[-1]) <= share
    assert found[-1] == FINEST or order_eight(0.1 * found[-1]) > 0.8 * share
    # It stays there.
    assert len(set(found[200:])) == 1


def test_it_goes_in_bounded_steps():
    found = [1e-6, *follow(Budget(1e-3, 1e-6), lambda accuracy, _: 1.0, 100)]
    decades = np.diff(np.log10(found))
    assert decades.max() == pytest.approx(MOST_DECADES) and found[-1] == COARSEST
    found = [1e-6, *follow(Budget(1.0, 1e-6), lambda accuracy, _: 1e-3, 400)]
    assert np.diff(np.log10(found)).min() == pytest.approx(-1.0) and found[-1] == FINEST


def test_one_disturbance_changes_nothing():
    found = follow(Budget(0.2, 1e-6), lambda accuracy, time: (
        5.0 if abs(time - 1.0) < 1e-9 else 0.17), 60)
    assert set(found) == {1e-6}


def test_it_follows_the_load_and_comes_back():
    def cost(accuracy, time):
        return order_eight(accuracy, 0.4 if 10.0 <= time < 20.0 else 0.1)

    found = follow(Budget(0.2, 1e-6), cost, 800)
    before, loaded, after = found[199], found[399], found[799]
    assert before == after < loaded
    # Two measurements of the new load are enough to act on, three to be there.
    assert found[202] > before and order_eight(found[210], 0.4) <= 0.2
    assert order_eight(loaded, 0.4) <= 0.2


def test_programs_that_take_the_core_leave_the_accuracy_as_long_as_the_period_is_kept():
    # Twice as long by the clock: 0.4 of the period at most.
    alone, beside = (follow(Budget(0.2, 1e-6), lambda accuracy, _: order_eight(accuracy), 200,
                            waiting=lambda time: factor) for factor in (1.0, 2.0))
    assert alone == beside


def test_the_period_is_kept_before_the_accuracy_where_programs_take_the_core():
    budget = Budget(0.2, 1e-6)
    found = follow(budget, lambda accuracy, _: order_eight(accuracy), 1200,
                   waiting=lambda time: 9.0 if 20.0 <= time < 40.0 else 1.0)
    before, crowded, after = found[399], found[799], found[1199]
    assert before == after < crowded and 9.0 * order_eight(before) > PERIOD
    # Two measurements are enough to act on.
    assert found[402] > before and 9.0 * order_eight(found[410]) <= PERIOD
    assert 9.0 * order_eight(crowded) <= PERIOD


def test_what_makes_the_accuracy_coarser_is_named():
    budget = Budget(0.2, 1e-6)
    found = follow(budget, lambda accuracy, _: order_eight(accuracy, 0.1), 10,
                   waiting=lambda time: 9.0)
    assert found[-1] > 1e-6 and 'other programs take the core' in budget.finding(found[-1])
    found = follow(budget, lambda accuracy, _: order_eight(accuracy, 0.1), 40,
                   waiting=lambda time: 100.0)
    assert found[-1] == COARSEST and 'other programs take the rest' in budget.finding(COARSEST)
    follow(budget, lambda accuracy, _: 0.3, 10, COARSEST)
    assert 'the budget of 0.2 of real time is exceeded' in budget.finding(COARSEST)


def test_a_budget_beyond_real_time_is_not_bounded_by_the_period():
    assert follow(Budget(3.0, 1e-6), lambda accuracy, _: 1.5, 400)[-1] == FINEST


def test_what_proved_too_fine_is_tried_ever_more_rarely():
    # The finer one takes twice what is expected of it.
    found = follow(Budget(0.1, 1e-6), lambda accuracy, _: 0.05 if accuracy > 5e-7 else 0.12, 3000)
    tried = np.flatnonzero(np.diff(found) < 0.0)
    assert (np.diff(tried)[:4] >= [10, 20, 40, 80]).all() and len(tried) < 30


def test_findings_say_what_excludes_what():
    budget = Budget(0.1, 1e-6)
    assert budget.finding(1e-6) == ''
    follow(budget, lambda accuracy, _: order_eight(accuracy, 0.15), 10)
    assert 'accuracy of 1e-06 rad or m within a second exclude each other: 1e-05' in (
        budget.finding(1e-5))
    assert budget.finding(1e-7) == ''
    follow(budget, lambda accuracy, _: 1.0, 10)
    assert 'exceeded even with an accuracy of 0.01' in budget.finding(COARSEST)


def test_what_a_budget_allows_follows_from_two_costs():
    known = [(1e-6, 0.1), (1e-9, 0.1 * 1e3 ** 0.125)]
    for share in (0.04, 0.1, 0.13, 0.2):
        best = allowed(share, known)
        assert order_eight(best) <= share * (1.0 + 1e-9)
        assert best == FINEST or order_eight(0.1 * best) > share
    assert allowed(0.01, known) is None
    # A cost that does not depend on the accuracy, as of held torques, or noise around it.
    assert allowed(0.2, [(1e-6, 0.1), (1e-9, 0.099)]) == FINEST
    assert allowed(0.05, [(1e-6, 0.1), (1e-9, 0.099)]) is None


def runs_of(budget, accuracy=1e-6, scene='three_rrr'):
    """Return a simulation by budget, and one that knows the motion."""
    scene = load_scene(scene)
    return [Simulation(replace(scene, method=method)) for method in (
        Method(accuracy=accuracy, budget=budget), Method(integrator='dop853', tolerance=1e-13))]


@pytest.mark.parametrize('budget, expected', [(1e-3, 1e-2), (2.5e-3, 1e-3), (2e-2, FINEST)])
def test_a_run_ends_where_its_evaluations_fit(counted, budget, expected):
    simulation, _ = runs_of(budget)
    for _ in range(60):
        simulation.step(TORQUE, 0.1)
    report = simulation.report()
    assert report.budget == budget and report.accuracy == simulation.accuracy
    assert (report.accuracy < 1e-6) == (expected < 1e-6)
    assert report.budget_used <= budget or report.accuracy == COARSEST
    assert ('exclude each other' in str(report) or 'exceeded even' in str(report)) == (
        report.accuracy > 1e-6)
    assert f'the best that {budget:g} of real time allows' in str(report)


@pytest.mark.parametrize('budget', [1.2e-3, 2e-3, 1e-2])
def test_the_error_is_that_of_the_coarsest_accuracy_on_the_way(counted, budget):
    simulation, reference = runs_of(budget)
    worst, coarsest = 0.0, 0.0
    for _ in range(50):
        for one in (simulation, reference):
            one.step(TORQUE, 0.02)
        coarsest = max(coarsest, simulation.accuracy)
        worst = max(worst, np.abs(simulation.position - reference.position).max())
    assert worst <= KEPT * coarsest
    assert worst <= KEPT * max(simulation.report().error_bound, 1e-12) * 10.0
    balance = simulation.energy_balance
    assert abs(balance.residual) <= 1e3 * coarsest


def test_the_accuracy_in_force_is_that_of_the_steps():
    # Aimed at in the middle of a motion, as from the start.
    errors = {}
    for accuracy in (1e-4, 1e-8):
        simulation, reference = runs_of(None)
        for one in (simulation, reference):
            one.step(TORQUE, 0.2)
        simulation.stepping.run.aim(accuracy)
        start = simulation.position - reference.position
        for one in (simulation, reference):
            one.step(TORQUE, 0.6)
        errors[accuracy] = np.abs(simulation.position - reference.position).max()
        assert simulation.accuracy == accuracy and np.abs(start).max() < 1e-8
        assert simulation.report().present_bound <= KEPT * accuracy
    assert 1e-8 < errors[1e-4] <= KEPT * 1e-4


def test_a_budget_that_changes_nothing_leaves_every_bit(counted):
    one = Simulation(replace(load_scene('four_bar'), method=Method(accuracy=FINEST)))
    other = Simulation(replace(load_scene('four_bar'), method=Method(
        accuracy=FINEST, budget=1.0)))
    for simulation in (one, other):
        simulation.step([1.0], 0.5)
    assert np.array_equal(one.state, other.state) and other.accuracy == FINEST


def test_the_same_measurements_give_the_same_run(counted):
    one, two = (runs_of(2e-3)[0] for _ in range(2))
    tau = one.joint_torques(TORQUE)
    for _ in range(100):
        one.advance(tau, 20)
        two.advance(tau, 20)
    assert np.array_equal(one.state, two.state) and one.accuracy != 1e-6


def test_a_long_call_follows_its_budget_on_the_way(counted):
    simulation, _ = runs_of(1.2e-3)
    simulation.step(TORQUE, 1.0)
    assert simulation.accuracy > 1e-6 and simulation.time == pytest.approx(1.0, abs=1e-12)


def test_a_slower_pace_has_more_time(counted):
    simulation, _ = runs_of(1.2e-3)
    simulation.stepping.pace = 0.1
    for _ in range(20):
        simulation.step(TORQUE, 0.1)
    assert simulation.accuracy < 1e-6


def test_a_reset_begins_with_the_accuracy_asked_for(counted):
    simulation, _ = runs_of(1.2e-3)
    simulation.step(TORQUE, 1.0)
    first, found = simulation.state, simulation.accuracy
    simulation.reset()
    assert simulation.accuracy == 1e-6
    simulation.step(TORQUE, 1.0)
    assert simulation.accuracy == found > 1e-6 and np.array_equal(simulation.state, first)


def test_a_budget_is_taken_and_left_while_it_runs(counted):
    simulation, _ = runs_of(None)
    assert math.isnan(simulation.report().budget)
    simulation.step(TORQUE, 0.1)
    simulation.stepping.prepare_method(budget=1.2e-3)()
    for _ in range(10):
        simulation.step(TORQUE, 0.1)
    assert simulation.accuracy > 1e-6
    simulation.stepping.prepare_method(budget=None)()
    assert simulation.accuracy == 1e-6 and math.isnan(simulation.report().budget)
    assert math.isnan(Simulation.from_scene('four_bar', integrator='rk4').accuracy)


def test_cpu_time_is_measured_under_a_budget_alone():
    for budget in (None, 0.5):
        simulation, _ = runs_of(budget)
        simulation.step(TORQUE, 0.5)
        _, spent, elapsed, *_ = simulation.stepping.monitor.measured
        assert elapsed > 0.0 and (spent > 0.0) == (budget is not None)


@pytest.mark.parametrize('budget', [0.0, -1.0, math.nan, math.inf, 'half'])
def test_impossible_budgets_are_refused(budget):
    with pytest.raises(FieldError, match='budget'):
        Method(budget=budget)


def test_a_budget_needs_a_method_that_can_follow_it(tmp_path):
    with pytest.raises(FieldError, match='auto with a budget'):
        load_scene('four_bar').with_method({'integrator': 'rk4', 'budget': 0.1})
    scene = tmp_path / 'scene.yaml'
    scene.write_text('mechanism: four_bar\ninitial: {position: {crank_joint: 1.0}}\n'
                     'method: {integrator: dop853, budget: 0.1}\n')
    with pytest.raises(ValueError, match='budget'):
        load_scene(scene)


def test_what_does_not_depend_on_time_refuses_a_budget(tmp_path):
    simulation, _ = runs_of(0.1)
    with pytest.raises(ValueError, match=r'method\.budget: expected no budget for a rollout'):
        simulation.rollout(duration=0.1)
    model = Model.from_scene('four_bar')
    with pytest.raises(ValueError, match='no budget for a rollout'):
        rollout(model, State.stack([model.assemble()]), duration=0.1, method={'budget': 0.1})
    scene = load_scene('four_bar').with_method({'budget': 0.1})
    with pytest.raises(ValueError, match='no budget for a sweep'):
        sweep(scene, {'mechanism.bodies.crank.mass': (1.0, 2.0)}, tmp_path / 'out.nc',
              duration=0.1, rate=10.0)
