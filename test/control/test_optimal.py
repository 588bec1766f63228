# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Linear-quadratic and predictive controllers: their costs on the nonlinear mechanism."""

from importlib.util import find_spec
from pathlib import Path
import runpy

from closedloop_dynamics import feedforward, Model, Simulation
from closedloop_dynamics.control.optimal import LinearRegulator, PredictiveController
import numpy as np
import pytest

PERIOD = 2e-3
needs_solver = pytest.mark.skipif(
    find_spec('piqp') is None, reason='the extra predictive is not installed')


def costs_of(model):
    """Return the diagonals of both costs."""
    n = len(model.actuated_joints)
    return np.r_[np.full(n, 1e4), np.full(n, 10.0)], np.full(n, 1e-3)


def aside(model, pose, size, seed=1):
    """Return a state beside a pose, at rest."""
    stepper = model.stepper(PERIOD)
    n = len(stepper.independent)
    change = np.r_[size * np.random.default_rng(seed).uniform(-1.0, 1.0, n), np.zeros(n)]
    return model.state(*stepper.plus(pose.q, pose.qd, change))


def closed_loop(model, state, law, reference, costs, hold, count, limit=np.inf):
    """Return the cost of a run of the mechanism, and its last difference to the reference."""
    simulation, stepper = Simulation(model, state, 'rk4'), model.stepper(PERIOD)
    total = 0.0
    for step in range(count):
        torque = np.clip(law(simulation.position, simulation.velocity, step), -limit, limit)
        away = stepper.minus(simulation.position, simulation.velocity, *reference(step))
        total += away @ (costs[0] * away) + (torque - hold) @ (costs[1] * (torque - hold))
        simulation.step(torque, PERIOD)
    return total, stepper.minus(simulation.position, simulation.velocity, *reference(count))


@pytest.mark.parametrize('scene', ('three_rrr_vertical', pytest.param(
    'stewart_platform', marks=pytest.mark.slow)))
def test_the_cost_of_small_motions_is_what_the_riccati_equation_says(scene):
    model = Model.from_scene(scene)
    pose, costs = model.assemble(), costs_of(Model.from_scene(scene))
    regulator = LinearRegulator(model, pose, PERIOD, *costs)
    state = aside(model, pose, 1e-4)
    start = model.stepper(PERIOD).minus(state.q, state.qd, pose.q, pose.qd)
    found, left = closed_loop(
        model, state, regulator.torque, lambda _: (pose.q, pose.qd), costs,
        regulator.torques[0], 1000)
    # What is left out is of third order in the size of the motion.
    assert found == pytest.approx(start @ regulator.cost @ start, rel=5e-3)
    assert np.abs(left).max() < 1e-3 * np.abs(start).max()


def test_a_path_is_kept_to_against_a_disturbance():
    model = Model.from_scene('three_rrr_vertical')
    home, time = model.assemble(), np.arange(0.0, 0.6, PERIOD)
    share = np.clip(time / 0.4, 0.0, 1.0)
    course = 0.2 * (10.0 * share ** 3 - 15.0 * share ** 4 + 6.0 * share ** 5)
    states, torques = feedforward(
        model, {name: home.position[name] + course for name in model.actuated_joints}, time)
    regulator = LinearRegulator(
        model, states, PERIOD, *costs_of(model), torques=torques)
    assert len(regulator.gains) == len(time) + 1

    def reference(step):
        one = regulator.reference[min(step, len(time))]
        return one.q, one.qd

    begun = aside(model, states[0], 0.02)
    _, left = closed_loop(
        model, begun, regulator.torque, reference, costs_of(model), 0.0, len(time))
    _, without = closed_loop(
        model, begun, lambda q, qd, step: regulator.torques[min(step, len(time))], reference,
        costs_of(model), 0.0, len(time))
    assert np.abs(left).max() < 2e-5 and np.abs(without).max() > 0.02


def test_references_and_costs_that_make_no_sense_are_refused():
    model = Model.from_scene('three_rrr_vertical')
    pose, costs = model.assemble(), costs_of(model)
    moving = model.state(pose.q, model.reduce(pose).basis @ np.ones(3))
    with pytest.raises(ValueError, match='reference: expected a pose.* at rest, got rates'):
        LinearRegulator(model, moving, PERIOD, *costs)
    with pytest.raises(ValueError, match='torques: expected none with a pose'):
        LinearRegulator(model, pose, PERIOD, *costs, torques=np.zeros(3))
    with pytest.raises(ValueError, match=r'state_cost: expected finite numbers of shape \(6,\)'):
        LinearRegulator(model, pose, PERIOD, costs[0][1:], costs[1])
    with pytest.raises(ValueError, match='torque_cost: expected a symmetric matrix'):
        LinearRegulator(model, pose, PERIOD, costs[0], -costs[1])


@needs_solver
@pytest.mark.parametrize('scene', ('three_rrr_vertical', pytest.param(
    'stewart_platform', marks=pytest.mark.slow)))
def test_without_active_limits_small_motions_get_the_torques_of_the_regulator(scene):
    model = Model.from_scene(scene)
    pose, costs = model.assemble(), costs_of(model)
    regulator = LinearRegulator(model, pose, PERIOD, *costs)
    predictive = PredictiveController(model, pose, PERIOD, 5, *costs, 1e4)
    state = aside(model, pose, 1e-5)
    for _ in range(3):
        found = predictive.torque(state.q, state.qd)
    expected = regulator.torque(state.q, state.qd)
    # Both minimise the same cost; the rest is of second order.
    np.testing.assert_allclose(
        found - regulator.torques[0], expected - regulator.torques[0], rtol=0,
        atol=2e-3 * np.abs(expected - regulator.torques[0]).max())


@needs_solver
def test_the_end_of_a_path_weighs_as_all_of_it():
    model = Model.from_scene('three_rrr_vertical')
    pose, costs, stepper = model.assemble(), costs_of(model), model.stepper(PERIOD)
    predictive = PredictiveController(model, pose, PERIOD, 1, *costs, 1e4)
    state, hold = aside(model, pose, 1e-5), predictive.torques[0].copy()
    found = predictive.torque(state.q, state.qd, (pose.q[None], pose.qd[None]))
    stepper.q[:], stepper.qd[:], stepper.tau[:] = state.q, state.qd, hold
    stepper()
    away = stepper.minus(stepper.next_q, stepper.next_qd, pose.q, pose.qd)
    weighed = stepper.B.T * costs[0]
    expected = -np.linalg.solve(np.diag(costs[1]) + weighed @ stepper.B, weighed @ away)
    np.testing.assert_allclose(found - hold, expected, rtol=1e-6)


@needs_solver
def test_limits_are_kept_at_less_cost_than_by_clipping():
    model = Model.from_scene('stewart_platform')
    pose = model.assemble()
    costs = np.r_[np.full(6, 1e4), np.full(6, 10.0)], np.full(6, 1e-5)
    regulator = LinearRegulator(model, pose, PERIOD, *costs)
    limit = 1.5 * np.abs(regulator.torques).max()
    predictive = PredictiveController(model, pose, 5e-3, 5, *costs, limit)
    found, asked = {}, []

    def law(q, qd, step):
        asked.append(predictive.torque(q, qd))
        return asked[-1]

    for name, one in (('clipped', regulator.torque), ('predictive', law)):
        found[name], left = closed_loop(
            model, aside(model, pose, 0.03), one, lambda _: (pose.q, pose.qd), costs,
            regulator.torques[0], 250, limit)
        assert np.abs(left).max() < 1e-3
    assert limit == pytest.approx(np.abs(asked).max(), rel=1e-6) and (np.abs(asked) <= limit).all()
    assert predictive.status.endswith('SOLVED')
    assert found['predictive'] < 0.9 * found['clipped']
    with pytest.raises(ValueError, match='limit: expected more than holds the goal'):
        PredictiveController(model, pose, 5e-3, 5, *costs, 1.0)


@needs_solver
def test_the_example_brings_the_platform_home():
    example = Path(__file__).resolve().parents[2] / 'doc' / 'examples' / 'stewart_at_1_khz.py'
    compare = runpy.run_path(str(example))['compare']
    clipped, predictive = compare(450, (3,)).values()
    assert predictive[0] < 0.7 * clipped[0] and max(clipped[1], predictive[1]) < 1e-3
