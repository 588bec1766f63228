# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Integrators and stabilisations: order, agreement, dense output, closure, failure."""

from dataclasses import replace

from closedloop_dynamics import load_scene, NumericalError, Simulation
from closedloop_dynamics.effects.registry import JointDamping, JointSpring
from closedloop_dynamics.engine.types import WRITTEN
from closedloop_dynamics.scene.integrators import ADAPTIVE, INTEGRATORS, STABILISATIONS
from closedloop_dynamics.scene.tableau import DOP853, DOPRI5, HEUN, RK4
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ..reference.formulations import Dense

MECHANISMS = ('four_bar', 'slider_crank', 'carpet_scraper', 'three_rrr')
# Two terms of the error cancel near 100 steps.
STEPS = {('four_bar', 'rodas4_fixed'): (25, 50)}
ORDERS = {'semi_implicit_euler': 1, 'heun': 2, 'rk4': 4, 'rodas4_fixed': 4}


def run(scene, duration=0.3, torque=None, **method):
    """Return a simulation that has run."""
    simulation = Simulation.from_scene(scene, **method)
    simulation.step(torque, duration)
    return simulation


@pytest.fixture(scope='module')
def references():
    """Return the state of each mechanism after 0.3 s, at the tightest tolerance."""
    return {name: run(name, integrator='dop853', tolerance=1e-13, step_size=0.1).position
            for name in MECHANISMS}


@pytest.mark.parametrize('tableau', [HEUN, RK4, DOPRI5, DOP853], ids=['heun', 'rk4', '5', '853'])
def test_tableau_integrates_powers_of_time_up_to_its_order(tableau):
    nodes = tableau.a.sum(axis=1)[:len(tableau.b)]
    for power in range(tableau.order):
        assert tableau.b @ nodes ** power == pytest.approx(1.0 / (power + 1), abs=1e-13)


@pytest.mark.parametrize('tableau', [DOPRI5, DOP853], ids=['5', '853'])
def test_dense_output_ends_in_the_step(tableau):
    ends = tableau.dense.sum(axis=1)
    assert np.allclose(ends[:len(tableau.b)], tableau.b, rtol=0.0, atol=1e-12)
    assert np.allclose(ends[len(tableau.b):], 0.0, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(('integrator', 'stabilisation'), [
    *((name, 'projection') for name in ORDERS),
    *((name, 'independent') for name in ORDERS if name != 'rodas4_fixed'),
    # A kernel of its own, for these two tests alone.
    pytest.param('rodas4_fixed', 'independent', marks=pytest.mark.slow)])
@pytest.mark.parametrize('scene', ['four_bar', 'three_rrr'])
def test_fixed_step_error_falls_with_the_order(scene, integrator, stabilisation, references):
    errors = [
        np.abs(run(scene, integrator=integrator, stabilisation=stabilisation,
                   step_size=0.3 / steps).position - references[scene]).max()
        for steps in STEPS.get((scene, integrator), (100, 200))]
    # Half an order of slack for the terms beyond the leading one.
    assert np.log2(errors[0] / errors[1]) > ORDERS[integrator] - 0.5


def test_generated_jacobian_is_that_of_difference_quotients():
    # Where another method is chosen in a run nothing is generated.
    scene = load_scene('three_rrr')
    scene = replace(scene, effects={
        **scene.effects, 'damper': JointDamping('theta_1', coefficient=30.0),
        'spring': JointSpring('theta_6', stiffness=200.0, rest=1.0)})
    generated = Simulation.from_scene(scene, integrator='rodas4_fixed', step_size=5e-3)
    quotients = Simulation.from_scene(scene, integrator='rk4', step_size=5e-3)
    quotients.stepping.prepare_method(integrator='rodas4_fixed')()
    torque = dict.fromkeys(quotients.actuated_joints, 0.5)
    for enabled in (True, False, True):
        for simulation in (generated, quotients):
            simulation.set_effect('damper', enabled=enabled)
            simulation.step(torque, 0.02)
        difference = np.abs(generated.state - quotients.state).max()
        # While other effects act than at the start, both take quotients, whose rounding is 1e-8 to
        # 2e-8 here with either elimination, as the damper is.
        assert difference < 5e-8
        assert difference > 0.0


def test_generated_jacobian_is_of_the_side_on_which_a_step_begins():
    # Steps end where the buffer is reached or left; the gap is zero there but for rounding.
    method = {'integrator': 'rodas4', 'tolerance': 1e-7}
    generated = Simulation.from_scene('slider_crank_end_stop', step_size=1e-2, **method)
    quotients = Simulation.from_scene('slider_crank_end_stop', step_size=1e-2, integrator='rk4')
    quotients.stepping.prepare_method(**method)()
    made = []
    for simulation in (generated, quotients):
        simulation.step(duration=0.5)
        steps = simulation.stepping.run.steps
        made.append((steps.accepted, steps.rejected, steps.work))
    assert made[0][:2] == made[1][:2]
    # Where derivatives are generated a Jacobian takes one evaluation.
    assert made[0][2] < made[1][2]
    assert np.abs(generated.state - quotients.state).max() < 1e-9


@pytest.mark.parametrize('integrator', [
    name for name, method in INTEGRATORS.items() if method.kind == ADAPTIVE])
@pytest.mark.parametrize('scene', MECHANISMS)
def test_error_control_reaches_what_it_promises(scene, integrator, references):
    simulation = run(scene, integrator=integrator, tolerance=1e-8, step_size=0.1)
    # Local errors add up and grow with the motion: two orders of magnitude are allowed.
    assert np.abs(simulation.position - references[scene]).max() < 1e-6
    assert simulation.closure < 1e-11


@pytest.mark.parametrize('integrator', ['dopri5', 'dop853'])
def test_asking_often_does_not_cut_steps(integrator, references):
    counts = []
    for interval in (0.1, 1e-3):
        simulation = run('three_rrr', integrator=integrator, tolerance=1e-9, step_size=interval)
        counts.append(simulation.stepping.run.steps.accepted)
        assert np.abs(simulation.position - references['three_rrr']).max() < 1e-6
    assert counts[0] == counts[1]


@pytest.mark.parametrize('integrator', ['dopri5', 'dop853'])
def test_dense_output_is_as_accurate_as_the_steps(integrator):
    fine = Simulation.from_scene('carpet_scraper', integrator='dop853', tolerance=1e-13,
                                 step_size=1e-3)
    coarse = Simulation.from_scene('carpet_scraper', integrator=integrator, tolerance=1e-8,
                                   step_size=1e-3)
    worst = 0.0
    for _ in range(100):
        fine.step(duration=3e-3)
        coarse.step(duration=3e-3)
        worst = max(worst, np.abs(fine.position - coarse.position).max())
    assert worst < 1e-6


def test_change_of_torque_takes_effect_at_once():
    states = []
    for integrator in ('dop853', 'rk4'):
        simulation = Simulation.from_scene('three_rrr', integrator=integrator, tolerance=1e-11,
                                           step_size=2.5e-4)
        for torque in ([5.0, -3.0, 2.0], [-20.0, 10.0, 0.0], None):
            simulation.step(torque, 0.05)
        states.append(np.concatenate([simulation.position, simulation.velocity]))
    assert np.abs(states[0] - states[1]).max() < 1e-8


@pytest.mark.parametrize('stabilisation, integrator', [
    *((name, 'auto') for name in STABILISATIONS if name != 'independent'), ('independent', 'rk4'),
    # A kernel of its own.
    pytest.param('independent', 'auto', marks=pytest.mark.slow)])
def test_stabilisations_agree_and_keep_their_closure(stabilisation, integrator, references):
    simulation = run('carpet_scraper', stabilisation=stabilisation, integrator=integrator)
    assert np.abs(simulation.position - references['carpet_scraper']).max() < 1e-5
    limit = {'none': 1e-5, 'baumgarte': 1e-7, 'velocity_projection': 1e-8}.get(
        stabilisation, 1e-12)
    assert simulation.closure < limit


def test_a_solver_of_others_with_a_dense_formulation_moves_the_same(references):
    simulation = Simulation.from_scene('carpet_scraper')
    dense, state = Dense(simulation.data.system, 'augmented'), simulation.data.integrated
    found = solve_ivp(
        lambda time, state: np.concatenate((state[7:], dense(state[:7].copy(), state[7:])[0])),
        (0.0, 0.3), state, method='DOP853', rtol=1e-9, atol=1e-9)
    assert np.abs(found.y[:7, -1] - references['carpet_scraper']).max() < 1e-6


def test_independent_coordinates_switch_their_set_and_stay_right():
    simulation = run('three_rrr', 1.0, integrator='rk4', stabilisation='independent')
    reference = run('three_rrr', 1.0, integrator='dop853', tolerance=1e-13, step_size=0.1)
    assert simulation.data.system.partition.record[2] > 1
    assert np.abs(simulation.position - reference.position).max() < 1e-5


@pytest.mark.parametrize('integrator', INTEGRATORS)
def test_impossible_torque_is_refused_and_the_state_kept(integrator):
    simulation = Simulation.from_scene('four_bar', integrator=integrator, step_size=0.01)
    simulation.step(duration=0.05)
    before = simulation.position, simulation.time
    with pytest.raises(Exception) as failure:
        simulation.step({'crank_joint': 1e200}, 0.05)
    assert isinstance(failure.value, NumericalError) or 'loops' in str(failure.value)
    assert np.isfinite(simulation.position).all()
    assert simulation.time >= before[1]


def test_time_is_counted_not_summed():
    simulation = Simulation.from_scene('four_bar')
    for _ in range(1000):
        simulation.step()
    assert simulation.time == 1000 * 1e-3
    simulation.step(duration=0.00125)
    assert simulation.time == pytest.approx(1.00125, abs=1e-15)


@pytest.mark.parametrize('scene', ['three_rrr', 'three_rrr_payload_friction'])
@pytest.mark.filterwarnings('ignore::closedloop_dynamics.mechanism.errors.InaccuracyWarning')
def test_errors_decay_alike_whether_baumgarte_is_named_in_the_scene_or_later(scene):
    later, named, never = (
        Simulation.from_scene(scene, integrator='rk4', step_size=4e-3, stabilisation=one)
        for one in ('projection', 'baumgarte', 'none'))
    later.stepping.prepare_method(stabilisation='baumgarte')()
    for one in (later, named, never):
        one.step(duration=0.4)
    np.testing.assert_allclose(later.position, named.position, rtol=0, atol=1e-12)
    assert np.abs(never.position - named.position).max() > 1e-7
    assert later.closure == pytest.approx(named.closure, rel=1e-4)
    assert named.closure < 0.1 * never.closure


@pytest.mark.parametrize('scene', ['bistable_toggle', 'three_rrr'])
def test_forces_act_on_where_another_method_follows_baumgarte(scene):
    left, never = (
        Simulation.from_scene(scene, integrator='rk4', stabilisation=one)
        for one in ('baumgarte', 'projection'))
    left.stepping.prepare_method(stabilisation='projection')()
    torque = dict.fromkeys(never.actuated_joints, 3.0)
    for one in (left, never):
        one.step(torque, 0.1)
    state = never.position, never.velocity
    expected = never.forward_dynamics(*state)
    np.testing.assert_allclose(
        np.hstack(left.forward_dynamics(*state)), np.hstack(expected), rtol=0, atol=1e-9)
    system = left.data.system
    system.native.derivative(left.data.integrated, np.zeros_like(left.data.integrated))
    # By one routine: parts would say that others can go on from their results.
    assert system.work.health[WRITTEN] == 0.0


def test_baumgarte_time_constant_is_tied_to_the_step():
    scene = Simulation.from_scene('four_bar', stabilisation='baumgarte', step_size=2e-4).scene
    assert scene.method.time_constant == pytest.approx(2e-3)
    given = replace(scene.method, baumgarte_time_constant=0.05)
    assert given.time_constant == 0.05


REPEATED = [
    {'integrator': 'rk4'}, {'integrator': 'rk4', 'stabilisation': 'independent'},
    *({'integrator': name, 'tolerance': 1e-7} for name in INTEGRATORS
      if INTEGRATORS[name].kind == ADAPTIVE)]


@pytest.mark.parametrize('method', REPEATED, ids=lambda it: '-'.join(map(str, it.values())))
def test_a_run_after_a_reset_is_the_same_to_the_last_digit(method):
    simulation = Simulation.from_scene('three_rrr', **method)
    runs = []
    for _ in range(2):
        simulation.reset()
        simulation.step({'theta_1': 20.0}, 0.1)
        # Another torque restarts a method that looks ahead, and a long way brings other
        # coordinates to the fore.
        simulation.step({'theta_1': -20.0, 'theta_7': 9.0}, 0.4)
        runs.append(np.concatenate([simulation.position, simulation.velocity]))
    assert np.array_equal(*runs)
