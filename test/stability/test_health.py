# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Health of an evaluation, massless links, stiffness, and the step size while running."""

from dataclasses import replace
import math

from closedloop_dynamics import (
    AssemblyError, Body, load_scene, MechanismError, Method, read_mechanism, Simulation)
from closedloop_dynamics.effects.registry import Actuator, JointDamping, JointSpring
from closedloop_dynamics.engine.types import CUT_ROW, ROW
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.mechanism.errors import StiffnessError
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.simulation.guards import fastest_rate
from closedloop_dynamics.simulation.system import build_system
import hard_machines as machines
import numpy as np
import pytest

from ..reference import dense, special
from ..reference.scenes import simulated

# Some compile for minutes on a busy machine.
pytestmark = pytest.mark.timeout(1200)
STEP = Method(integrator='rk4', step_size=1e-3)


def simulate(mechanism, q, qd, effects=None, method=STEP):
    """Return a simulation of a mechanism under gravity."""
    return Simulation(machines.scene(mechanism, q, qd, method, effects))


def test_health_of_an_ordinary_state():
    simulation = Simulation(load_scene('three_rrr'))
    simulation.advance(np.zeros(7), 3)
    health = simulation.health
    assert 0.01 < health.smallest_pivot_ever <= health.smallest_pivot <= 1.0
    assert (health.rank, health.equations) == (4, 4)
    assert health.unique_forces and not health.near_singular
    assert health.rank_revealing_count == 0 and health.evaluations >= 12
    assert health.closure < 1e-12
    assert 'rank-revealing' in str(health) and 'unique' not in str(health)


def test_health_flags_forces_that_are_not_unique():
    health = simulate(*machines.three_rockers()).health
    assert (health.rank, health.equations) == (3, 4)
    assert not health.unique_forces
    assert 'not unique: 1 of 4' in str(health)


def test_condition_is_that_of_the_block_pivots():
    simulation = Simulation(load_scene('three_rrr'))
    model, mechanism, q = simulation.data.system.model, simulation.mechanism, simulation.position
    jac = dense.closure_jacobian(mechanism, q)
    inertia = dense.generalized_inertia_matrix(mechanism, q)
    matrix = jac @ np.linalg.solve(inertia, jac.T)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    matrix *= np.outer(scale, scale)
    # Two cut joints: the first block, and what is left of the second one.
    first, last = (slice(row, row + 2)
                   for row in model.cut[np.argsort(model.cut[:, ROW]), CUT_ROW])
    left = matrix[last, last] - matrix[last, first] @ np.linalg.solve(
        matrix[first, first], matrix[first, last])
    expected = max(np.linalg.cond(matrix[first, first]), np.linalg.cond(left))
    assert simulation.health.condition == pytest.approx(expected, rel=1e-8)


def test_condition_is_infinite_where_dependent_equations_are_eliminated():
    # What repeats others is left out, but where the loops may drift apart.
    drifting = Method(integrator='rk4', step_size=1e-3, stabilisation='none')
    assert simulate(*machines.three_rockers(), method=drifting).health.condition == math.inf
    assert simulate(*machines.three_rockers()).health.condition < 10.0


def test_health_counts_what_is_next_to_a_singular_configuration():
    assert simulate(*machines.three_rockers()).health.singular_count == 0
    assert simulate(*machines.ladder(1, 0.5 * math.pi)).health.singular_count > 0
    assert simulate(*machines.ladder(1, 1.2)).health.singular_count == 0


@pytest.mark.parametrize('distance', [3e-3, 5e-3])
def test_health_warns_before_a_singular_configuration(distance):
    simulation = simulate(*machines.ladder(1, 0.5 * math.pi - distance))
    assert simulation.health.near_singular
    assert simulation.health.unique_forces
    assert 'singular configuration is near' in str(simulation.health)
    assert not simulate(*machines.ladder(1, 1.2)).health.near_singular


@pytest.mark.parametrize('direction', [0.0, 0.3, 0.7, 2.0])
def test_closeness_does_not_depend_on_the_direction_of_the_axes(direction):
    pivots = [simulate(*machines.ladder(2, 1.54, direction=angle)).health.smallest_pivot
              for angle in (direction, 0.5)]
    assert pivots[0] < 1e-2
    assert 0.1 < pivots[0] / pivots[1] < 10.0


def test_health_tells_how_far_locked_drives_are_from_leaving_the_mechanism_loose():
    def value(tilt):
        return simulate(*machines.ladder(1, tilt)).health.drive_sine

    # Where a parallelogram is flat, a locked crank holds nothing.
    before, after = value(0.5 * math.pi - 5e-3), value(0.5 * math.pi + 5e-3)
    assert before * after < 0.0
    assert abs(value(0.0)) > 0.3 > 0.02 > abs(before) == pytest.approx(abs(after), rel=0.1)
    assert 'parallel (type-2) singularity' in str(
        simulate(*machines.ladder(1, 0.5 * math.pi - 5e-3)).health)
    # Whatever the direction of the world's axes.
    aligned = simulate(*machines.ladder(1, 0.5 * math.pi - 5e-3, direction=0.0)).health.drive_sine
    assert 0.5 < aligned / before < 2.0
    # A third rocker adds nothing to hold, nor does it loosen anything.
    assert abs(simulate(*machines.three_rockers()).health.drive_sine) > 0.3


@pytest.mark.parametrize('scene, passive', [('humanoid_knee', 0), ('rack_press', 1)])
def test_one_equation_holds_by_the_sine_of_its_passive_joint(scene, passive):
    # A rod, which has a lever in metres, and a rack, whose factors have none.
    simulation = Simulation.from_scene(scene)
    row, = simulation.constraint_jacobian
    assert abs(simulation.health.drive_sine) == pytest.approx(
        abs(row[passive]) / math.hypot(*row), rel=1e-12)


@pytest.mark.parametrize('size', [1e-3, 0.05, 1.0, 100.0])
@pytest.mark.parametrize('stages', [1, 4, 12])
def test_a_scissor_lift_is_held_by_its_slide(stages, size):
    mechanism, q, qd = special.scissor_lift(stages, size=size)
    health = simulate(mechanism, q, qd).health
    assert abs(health.drive_sine) > 0.1
    assert 'singularity' not in str(health) and 'singular configuration' not in str(health)
    # Flat, its slide cannot.
    mechanism, q, qd = special.scissor_lift(stages, tilt=0.01, size=size)
    assert abs(simulate(mechanism, q, qd).health.drive_sine) < 0.02


@pytest.mark.parametrize('factor', [1e-2, 1e-4, 1e-8])
def test_light_couplers_are_no_singular_configuration(factor):
    mechanism, q, qd = machines.ladder(3, 0.4)
    mechanism = machines.with_masses(mechanism, {
        f'coupler_{k}': factor for k in range(3)})
    health = simulate(mechanism, q, qd).health
    assert not health.near_singular and 'singular' not in str(health)
    assert health.rank_revealing_count == 0


MASSLESS = [(special.ladder(1, 0.4, length=0.6), ('coupler_0',)),
            (special.ladder(3, 0.4), ('leg_1', 'coupler_2')),
            (special.chain(np.random.default_rng(0), 4), ('link_1', 'link_2'))]


@pytest.mark.parametrize('factor', [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 0.0])
@pytest.mark.parametrize(('case', 'light'), MASSLESS, ids=['four-bar', 'ladder', 'chain'])
def test_light_and_massless_links_agree_with_the_augmented_system(case, light, factor):
    mechanism, q, qd = case
    mechanism = validate_mechanism(
        machines.with_masses(mechanism, dict.fromkeys(light, factor)))
    tau = np.random.default_rng(1).normal(size=len(q))
    qdd, lam = dense.forward_dynamics(mechanism, q, qd, tau)
    simulation = simulate(mechanism, q, qd, machines.gravity(0.0))
    simulation.data.system.tau[:] = tau
    np.testing.assert_allclose(simulation.acceleration, qdd, rtol=0, atol=1e-8 * abs(qdd).max())
    np.testing.assert_allclose(simulation.multipliers, lam, rtol=0, atol=1e-8 * abs(lam).max())


def test_light_links_converge_to_massless_ones():
    mechanism, q, qd = special.ladder(3, 0.4)
    tau = np.random.default_rng(2).normal(size=len(q))
    errors = []
    limit, _ = dense.forward_dynamics(
        machines.with_masses(mechanism, {'leg_1': 0.0}), q, qd, tau)
    for factor in (1e-3, 1e-5, 1e-7, 1e-9):
        engine = simulate(machines.with_masses(mechanism, {'leg_1': factor}), q, qd,
                          machines.gravity(0.0))
        engine.data.system.tau[:] = tau
        errors.append(np.abs(engine.acceleration - limit).max())
    assert errors[0] > 50.0 * errors[1] > 2500.0 * errors[2]
    assert errors[3] < 1e-6


def test_motion_without_inertia_is_refused():
    mechanism, q, qd = special.chain(np.random.default_rng(0), 3)
    loose = replace(mechanism, cut_joints=())
    with pytest.raises(AssemblyError, match='without inertia: joint_2'):
        simulate(machines.with_masses(loose, {'link_2': 0.0}), q, qd)


def test_massless_body_is_read_and_checked(tmp_path):
    text = """
name: pair
bodies:
  crank: {mass: 1.0, center_of_mass: [0.5, 0.0], inertia: 0.1}
  rod: {massless: true%s}
joints:
  one: {type: revolute, parent: ground, child: crank, position: [0, 0]}
  two: {type: revolute, parent: crank, child: rod, position: [1, 0]}
"""
    path = tmp_path / 'pair.yaml'
    path.write_text(text % '')
    assert read_mechanism(path).bodies[1] == Body('rod', 0.0, (0.0, 0.0), 0.0, True)
    path.write_text(text % ', mass: 0.1')
    with pytest.raises(MechanismError, match='rod.mass: expected zero, or nothing, of a massless'):
        read_mechanism(path)
    path.write_text((text % '').replace('massless: true', 'massless: false'))
    with pytest.raises(MechanismError, match='rod.mass: expected this required key'):
        read_mechanism(path)


def pendulum(effect, method=STEP):
    """Return a simulation of one bar with an effect at its joint."""
    mechanism = replace(
        special.chain(np.random.default_rng(0), 1)[0], cut_joints=())
    return simulated(mechanism, effects={'effect': effect}, method=method)


def test_fastest_rate_of_a_spring_and_of_a_damper():
    inertia = 1.0 / 3.0
    stiff = pendulum(JointSpring('joint_0', 1e4, 0.0))
    assert fastest_rate(stiff.data.system, stiff.data.integrated) == pytest.approx(
        math.sqrt(1e4 / inertia), rel=0.05)
    viscous = pendulum(JointDamping('joint_0', 100.0))
    assert fastest_rate(viscous.data.system, viscous.data.integrated) == pytest.approx(
        100.0 / inertia, rel=0.05)


def test_fastest_rate_sees_the_states_of_effects():
    lagging = pendulum(Actuator('joint_0', lag=0.001))
    assert lagging.stepping.fastest_rate == pytest.approx(1000.0, rel=0.05)
    assert fastest_rate(lagging.data.system, lagging.data.integrated) < 100.0


def test_states_of_effects_that_are_too_fast_are_refused():
    with pytest.raises(StiffnessError, match='stable with steps up to'):
        pendulum(Actuator('joint_0', lag=1e-4))


def test_a_change_that_makes_the_scene_too_stiff_is_refused_and_changes_nothing():
    simulation, other = (pendulum(JointSpring('joint_0', 100.0, 0.1)) for _ in range(2))
    for call in (simulation.stepping.check_effect, simulation.set_effect):
        with pytest.raises(StiffnessError, match='rodas4'):
            call('effect', stiffness=1e9)
    assert simulation.effects == other.effects
    simulation.stepping.check_effect('effect', enabled=False)
    assert simulation.data.enabled_effects == ('effect',)
    for each in (simulation, other):
        each.step(duration=0.1)
    assert simulation.position == other.position
    assert simulation.energy_balance == other.energy_balance


@pytest.mark.parametrize('effect', [JointSpring('joint_0', 1e8, 0.0),
                                    JointDamping('joint_0', 1e5)], ids=['spring', 'damper'])
@pytest.mark.parametrize('integrator', ['rk4', 'heun', 'semi_implicit_euler'])
def test_stiff_scene_is_refused_with_the_stable_step(effect, integrator):
    with pytest.raises(StiffnessError, match=r'stable with steps up to .* s only') as caught:
        pendulum(effect, Method(integrator=integrator, step_size=1e-3))
    assert 'rodas4' in str(caught.value)


def test_stiff_scene_is_taken_in_steps_that_are_stable():
    simulation = pendulum(JointSpring('joint_0', 1e8, 1e-4), Method(step_size=1e-5))
    for _ in range(300):
        simulation.step()
    assert abs(simulation.energy_balance.residual) < 1e-4


def test_step_size_changes_while_running():
    simulation = simulate(*machines.ladder(2, 0.4))
    energy = simulation.energy
    simulation.step(duration=0.1)
    simulation.stepping.prepare_method(step_size=4e-3)()
    assert (simulation.time, simulation.step_size) == (pytest.approx(0.1), 4e-3)
    simulation.step()
    assert simulation.time == pytest.approx(0.104)
    assert simulation.energy == pytest.approx(energy, rel=1e-7)
    simulation.reset()
    assert (simulation.time, simulation.step_size) == (0.0, 4e-3)


@pytest.mark.parametrize('size', [0.0, -1e-3, math.nan, math.inf, 'fast'])
def test_impossible_step_size_is_refused_and_the_old_one_stays(size):
    simulation = simulate(*machines.ladder(1, 0.4))
    with pytest.raises(ValueError):
        simulation.stepping.prepare_method(step_size=size)()
    assert simulation.step_size == 1e-3


def test_step_size_too_large_for_a_spring_is_refused():
    simulation = pendulum(
        JointSpring('joint_0', 1e6, 0.0), Method(integrator='rk4', step_size=1e-4))
    with pytest.raises(StiffnessError):
        simulation.stepping.prepare_method(step_size=1e-2)()
    assert simulation.step_size == 1e-4


@pytest.mark.parametrize(('loops', 'tilt'), [
    (1, 0.0), (1, 1e-12), (1, 1e-9), (1, 1e-6), (1, 1e-4), (2, 1e-6), (2, 1e-4)])
def test_accelerations_next_to_the_flat_position_are_those_of_the_branch(loops, tilt):
    exact = -dense.EARTH[1] * ((loops + 1) / 2 + loops) / ((loops + 1) / 3 + loops)
    mechanism, q, qd = special.ladder(loops, tilt=0.5 * np.pi - tilt, rate=2.0)
    simulation = simulate(mechanism, q, qd, machines.gravity(0.0))
    assert simulation.acceleration[::2] == pytest.approx(-exact, rel=1e-3)


@pytest.mark.parametrize('error', [1e-12, 1e-9])
@pytest.mark.parametrize('tilt', [0.0, 1e-7, 1e-4, 1e-3, -0.02, 0.03])
def test_accelerations_of_many_loops_in_one_line_are_those_of_the_branch(tilt, error):
    loops, random = 40, np.random.default_rng(0)
    mechanism, q, qd = special.ladder(loops, tilt=0.5 * np.pi - tilt, rate=5.0)
    system = build_system(build_model(mechanism, dense.EARTH))
    # Beside the branch, as a step leaves a state. Where the accelerations are asked, an error of
    # the rates is divided by 0.002.
    q, qd = (values + error * random.normal(size=len(q)) for values in (q, qd))
    system.native.evaluate(q, qd)
    exact = dense.EARTH[1] * math.cos(tilt) * (
        (loops + 1) / 2 + loops) / ((loops + 1) / 3 + loops)
    assert np.abs(system.qdd[::2] - exact).max() < 1e-6
    assert np.abs(system.qdd[1::2] + exact).max() < 1e-6


@pytest.mark.parametrize('beyond', [np.nan, 1e200, 1e308])
def test_numbers_that_cannot_be_decomposed_leave_no_accelerations(beyond, capfd):
    mechanism, q, _ = machines.three_rockers()
    system = build_system(build_model(mechanism, (0.0, -9.81)))
    system.native.evaluate(q, np.full(len(q), beyond))
    assert np.isnan(system.qdd).all()
    assert 'Exception' not in capfd.readouterr().err
