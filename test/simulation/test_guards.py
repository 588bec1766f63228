# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the guards of a run: no wrong motion is reported as right."""

from contextlib import suppress
import math

from closedloop_dynamics import ClosureError, load_scene, NumericalError, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.effects.joint_spring import JointSpring
from closedloop_dynamics.effects.registry import EndStop
from closedloop_dynamics.mechanism.errors import InaccuracyWarning, StiffnessError
import numpy as np
import pytest

from ..effects.machines import block, simulated

# A torque that lets the 3-RRR whirl faster than steps of a millisecond can follow.
WHIRL = {'theta_1': 5000.0}


def run(**method):
    """Return a run of one second under a large torque, before it is judged."""
    simulation = Simulation.from_scene('three_rrr', **method)
    simulation.step(WHIRL, 1.0)
    return simulation


def test_energy_from_nowhere_ends_a_short_run():
    with pytest.raises(NumericalError, match='energy balance is off') as caught:
        run(integrator='rk4').judge()
    assert 'integrator: auto' in str(caught.value)


def test_the_state_before_the_loss_is_kept():
    simulation = Simulation.from_scene('three_rrr', integrator='rk4')
    with pytest.raises(NumericalError):
        simulation.step(WHIRL, 1.0)
        simulation.judge()
    assert 0.0 < simulation.time < 1.0
    assert abs(simulation.energy_balance.residual) < 0.1 * simulation.report().energy_moved


def test_the_default_method_keeps_the_energy_of_the_same_run():
    simulation = run()
    simulation.judge()
    report = simulation.report()
    assert abs(report.energy_error) < 1e-8 * report.energy_moved


def test_a_small_loss_is_a_warning_with_figure_and_remedy():
    simulation = Simulation.from_scene('carpet_scraper', integrator='heun', step_size=4e-3)
    with pytest.warns(InaccuracyWarning, match='Take integrator: auto'):
        simulation.step(duration=6.0)
    finding, = simulation.report().findings
    guard = simulation.stepping.run.report
    assert f'{guard.worst_lost:.3g} J of the {guard.worst_moved:.3g} J' in finding
    assert f't = {guard.worst_time:.6g} s' in finding
    simulation.reset()
    assert simulation.report().findings == ()


def test_a_run_that_is_well_has_no_findings():
    for integrator in ('rk4', 'auto', 'dopri5'):
        simulation = Simulation.from_scene('four_bar', integrator=integrator)
        simulation.step({'crank_joint': 1.0}, 1.0)
        simulation.judge()
        assert simulation.report().findings == ()


def test_nothing_that_rests_is_suspected():
    simulation = Simulation.from_scene('three_rrr_horizontal', integrator='rk4')
    simulation.step(duration=0.2)
    simulation.judge()
    assert simulation.report().findings == ()


@pytest.mark.parametrize('samples', [1, 4], ids=['alone', 'in_lanes'])
def test_rollouts_tell_of_energy_from_nowhere(samples):
    simulation = Simulation.from_scene('three_rrr', integrator='rk4')
    torques = np.zeros((samples, 1, 3))
    torques[0, 0, 0] = WHIRL['theta_1']
    result = simulation.rollout(torques, steps=1000, every=100)
    assert list(result.failures) == [0] and 'does not follow this motion' in result.failures[0]


def test_rollouts_tell_of_a_small_loss_and_keep_the_numbers():
    simulation = Simulation.from_scene('three_rrr', integrator='heun', step_size=1e-2)
    result = simulation.rollout(np.zeros((3, 1, 3)), steps=100, every=20)
    assert set(result.failures) == {0, 1, 2} and np.isfinite(result.position).all()
    assert 'the energy balance misses' in result.failures[1]


def test_work_of_changing_torques_is_no_loss():
    simulation = Simulation.from_scene('three_rrr', integrator='rk4')
    torques = np.random.default_rng(5).normal(scale=5.0, size=(4, 100, 3))
    assert simulation.rollout(torques, steps=200, every=10).failures == {}


def test_a_change_of_method_keeps_what_the_guard_knows_of_effects():
    simulation = Simulation.from_scene('carpet_scraper_dry', integrator='rk4')
    before = simulation.stepping.fastest_rate
    simulation.stepping.prepare_method(step_size=5e-4)()
    assert simulation.stepping.fastest_rate == pytest.approx(before, rel=1e-6)
    assert before > 100.0


def test_simulate_ends_with_a_verdict(tmp_path, capsys):
    output = tmp_path / 'q.csv'
    assert main(['simulate', 'three_rrr', '--duration', '1', '--torque', 'theta_1=5000',
                 '--integrator', 'rk4', '--output', str(output)]) == 1
    reported = capsys.readouterr()
    assert 'energy balance is off' in reported.err
    # How far it came before.
    assert 0.0 < float(reported.out.split('simulated ')[1].split()[0]) < 1.0
    kept = (tmp_path / 'q.csv.report.txt').read_text()
    assert 'FAILED' in kept and 'not to be trusted' in kept
    assert len(output.read_text().splitlines()) > 2


def test_simulate_tells_the_error_of_the_run(capsys):
    assert main(['simulate', 'four_bar', '--duration', '1', '--integrator', 'heun',
                 '--step-size', '1e-3']) == 0
    reported = float(capsys.readouterr().out.split('at most about ')[1].split()[0])
    coarse, fine = (Simulation.from_scene('four_bar', **method) for method in (
        {'integrator': 'heun', 'step_size': 1e-3}, {'accuracy': 1e-10}))
    worst = 0.0
    for _ in range(100):
        coarse.step(duration=0.01)
        fine.step(duration=0.01)
        worst = max(worst, np.abs(coarse.position - fine.position).max())
    assert reported == pytest.approx(worst, rel=0.1)


def test_keys_of_a_method_that_mean_nothing_are_named():
    method = load_scene('four_bar').method
    assert set(method.unused) == {'tolerance', 'baumgarte_time_constant'}


@pytest.mark.parametrize('torque', [1e308, -1e150, 1e20])
@pytest.mark.parametrize('method', ['auto', 'rk4'])
def test_torques_that_no_step_can_follow_are_refused_and_nothing_changes(method, torque):
    simulation = Simulation.from_scene('slider_crank', integrator=method)
    simulation.step([2.0], duration=0.01)
    before, energy = simulation.state, simulation.energy_balance
    for _ in range(2):
        with pytest.raises(NumericalError, match='torque: expected torques that a step of 0.001'):
            simulation.step([torque], duration=0.01)
    for one, other in zip(simulation.state, before):
        np.testing.assert_array_equal(one, other)
    assert simulation.energy_balance == energy
    # The torque before stays in force.
    simulation.step([2.0], duration=0.01)
    undisturbed = Simulation.from_scene('slider_crank', integrator=method)
    undisturbed.step([2.0], duration=0.02)
    np.testing.assert_allclose(simulation.position, undisturbed.position, rtol=1e-6)


@pytest.mark.parametrize('steps, size', [
    *((steps, 1e-3) for steps in (50, 250, 400, 700)), *((steps, 0.02) for steps in (5, 15))])
def test_a_call_ends_with_its_verdict(steps, size):
    simulation = Simulation.from_scene('three_rrr', integrator='rk4', step_size=size)
    with suppress(NumericalError, ClosureError):
        for _ in range(700 // steps):
            simulation.step(WHIRL, steps * simulation.step_size)
            # What was returned as a success is one.
            state, failed = simulation.state, None
            try:
                simulation.judge()
            except NumericalError as error:
                failed = error
            assert failed is None and np.array_equal(simulation.state, state)


@pytest.mark.parametrize('steps', [1, 10])
def test_a_short_call_that_a_stop_throws_back_ends_with_its_verdict(steps):
    # The block goes 0.1 m in a step, into a stop of which its speed is the hundredth part a step.
    simulation = simulated(
        block(), {'stop': EndStop('slide', 1e12, upper=0.0)}, [-0.05], [100.0], step_size=1e-3)
    before = simulation.state
    with pytest.raises((NumericalError, StiffnessError)):
        simulation.step(duration=steps * 1e-3)
    assert np.array_equal(simulation.state, before)


def test_a_change_of_method_begins_a_new_balance():
    simulation = Simulation.from_scene('carpet_scraper', integrator='heun', step_size=4e-3)
    with pytest.warns(InaccuracyWarning):
        simulation.step(duration=6.0)
    simulation.stepping.prepare_method(integrator='auto', step_size=1e-3)()
    simulation.step(duration=1.0)
    simulation.judge()
    report = simulation.report()
    assert report.findings == ()
    assert abs(report.energy_error) < 1e-6 * report.energy_moved


def test_the_error_bound_is_withdrawn_where_the_energy_balance_fails():
    simulation = Simulation.from_scene('four_bar')
    simulation.step({'crank_joint': 1.0}, 0.1)
    assert simulation.report().error_bound < 1e-5
    # Energy that came from nowhere.
    simulation.stepping.run.jump_balance(1.0)
    report = simulation.report()
    assert math.isnan(report.error_bound) and len(report.findings) == 1


def test_rounding_of_weights_that_hardly_move_is_no_loss():
    """The stored energy of a high, heavy block is rounded by much of what it exchanges."""
    simulation = simulated(block(1e3, 0.5 * math.pi), {
        'weight': Gravity((0.0, -9.81)), 'spring': JointSpring('slide', 1e4, 1e9 + 0.981)},
        [1e9], [1e-2], accuracy=1e-9)
    simulation.step(duration=0.03)
    simulation.judge()
    report = simulation.report()
    assert abs(report.energy_error) > 0.02 * report.energy_moved
    assert report.findings == () and simulation.stepping.run.report.worst == 0.0
