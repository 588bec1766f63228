# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

from dataclasses import replace
import math
import warnings

from closedloop_dynamics import (
    ClosureError, load_scene, Method, NumericalError, Point, Simulation, SingularityError)
from closedloop_dynamics.effects.registry import ExternalForce, JointFriction
from hard_cases import light_cart
import hard_machines as machines
import numpy as np
import pytest

from ..reference.machines import parallelogram

# Some compile for minutes on a busy machine.
pytestmark = pytest.mark.timeout(1200)


def simulate(machine, effects=None, **method):
    """Return a simulation of a mechanism at a state, under gravity."""
    return Simulation(machines.scene(*machine, Method(**method), effects))


def test_reference_of_the_pantograph_keeps_its_energy():
    start, times = (-1.9, -1.3, 1.0, -3.0), np.array([0.4, 0.7, 1.0])
    # Rates by differences, place by place.
    step = 1e-5
    energies = [simulate(machines.pantograph(*start)).energy]
    for time in times:
        before, here, after = machines.pantograph_motion(
            *start, np.array([time - step, time, time + step]))
        rate = (after - before) / (2.0 * step)
        energies.append(simulate(machines.pantograph(
            here[0], here[0] + here[1], rate[0], rate[0] + rate[1])).energy)
    assert energies == pytest.approx([energies[0]] * 4, abs=1e-6)


@pytest.mark.parametrize('fold', [0.0, 1e-12, 1e-7, -1e-4, 3e-3])
def test_pantograph_goes_on_through_its_folded_position(fold):
    start = (-1.9, -1.9 + fold, 1.0, -3.0)
    simulation = simulate(machines.pantograph(*start), step_size=1e-3)
    times = np.array([0.05, 0.2, 0.4])
    for time, exact in zip(times, machines.pantograph_motion(*start, times)):
        simulation.step(duration=time - simulation.time)
        np.testing.assert_allclose(simulation.position, exact, rtol=0, atol=1e-7)


@pytest.mark.parametrize('size', [1e-3, 5e-3, 1.2e-2])
def test_crossing_a_change_point_costs_no_energy(size):
    mechanism, q, qd = machines.change_point_linkage()
    qd[0] = 3.0
    gravity = machines.gravity(strength=0.1 * machines.G)
    for phase in (0.0, 0.21, 0.37, 0.5, 0.77):
        simulation = simulate((mechanism, q, qd), gravity, step_size=size)
        start = simulation.energy
        simulation.step(duration=phase * size)
        simulation.step(duration=1.2)
        # The crank has passed its outer position, where all links lie on one line.
        assert simulation.position[0] > math.pi
        assert abs(simulation.energy - start) < 1e-6 * machines.G


def test_a_change_point_that_cannot_be_left_is_named_with_a_cure():
    flat, still = parallelogram(), np.zeros(3)
    simulation = simulate((flat, still, still), {})
    with pytest.raises(ClosureError, match='at a change point .* with crank_joint further by'):
        simulation.step({'crank_joint': 5.0}, 0.1)
    simulation.set_state([0.01, -0.01, 0.01])
    simulation.step({'crank_joint': 5.0}, 0.1)
    # The coupler goes round in a circle and does not turn.
    assert simulation.position[0] > 0.1
    assert np.allclose(simulation.position, simulation.position[0] * np.array([1, -1, 1]))


def test_forces_in_joints_are_those_of_the_change_point_itself():
    flat, turning = parallelogram(), np.array([1.0, -1.0, 1.0])
    flat = replace(flat, points=(Point('middle', 'coupler', (0.25, 0.0)),))
    simulation = simulate((flat, 0.0 * turning, 3.0 * turning), {
        'load': ExternalForce('middle', (0.0, -200.0)),
        'bearing': JointFriction('crank_joint', friction_coefficient=0.1, radius=0.01)})
    carried = np.linalg.norm(simulation.force('crank_joint')[1:])
    assert simulation.health.near_singular and carried > 10.0
    assert simulation.effect_readings('bearing')['reaction'] == pytest.approx(carried, rel=1e-12)


def test_acceleration_exactly_on_a_change_point_is_the_limit_along_the_branch():
    mechanism, q, qd = machines.change_point_linkage()
    qd[0] = 3.0
    gravity = machines.gravity(strength=machines.G)
    simulation = simulate((mechanism, q, qd), gravity, step_size=1e-4)
    simulation.step(duration=0.1)
    before = []
    while simulation.position[0] < math.pi - 1e-9:
        before.append((simulation.time, simulation.position[0], simulation.acceleration))
        simulation.step()
        size = (math.pi - simulation.position[0]) / simulation.velocity[0]
        if 0.0 < size < 1e-4:
            simulation.step(duration=size)
            break
    assert abs(simulation.position[0] - math.pi) < 1e-6
    assert simulation.health.near_singular
    # Extrapolated by a line through states some hundredths of a radian before.
    (t1, _, a1), (t2, _, a2) = before[-400], before[-200]
    line = a2 + (a2 - a1) * (simulation.time - t2) / (t2 - t1)
    np.testing.assert_allclose(
        simulation.acceleration, line, rtol=0, atol=0.01 * np.abs(line).max())


def test_singular_configuration_is_refused_without_stabilisation():
    simulation = simulate(machines.ladder(1, 1.5, 3.0), step_size=1e-3, stabilisation='none')
    with pytest.raises(SingularityError, match='Take stabilisation: projection'):
        simulation.step(duration=0.1)


def test_redundant_loops_are_not_refused_without_stabilisation():
    simulation = simulate(machines.three_rockers(), step_size=1e-3, stabilisation='none')
    simulation.step(duration=0.1)
    assert simulation.health.singular_count == 0


def test_loops_that_drift_apart_are_refused():
    start = load_scene('three_rrr')
    simulation = Simulation(replace(start, method=Method(
        integrator='semi_implicit_euler', step_size=2e-3, stabilisation='none')))
    with pytest.raises((ClosureError, NumericalError), match='Take .*stabilisation: projection'):
        simulation.step(duration=20.0)


def test_fixed_steps_that_cannot_follow_are_refused():
    # The pendulum turns at the bottom within 1e-4 s: a step of 1 ms skips it.
    simulation = simulate(
        light_cart(1e-3), machines.gravity(0.0), integrator='rk4', step_size=1e-3)
    with pytest.raises(NumericalError, match='does not follow this motion'):
        simulation_steps(simulation, 20000)


@pytest.mark.parametrize('name', ['three_rrr', 'carpet_scraper', 'four_bar'])
def test_no_warning_where_the_method_follows(name):
    simulation = Simulation.from_scene(name)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        simulation_steps(simulation, 40000)


def simulation_steps(simulation, count):
    """Make steps a thousand at a time."""
    for _ in range(count // 1000):
        simulation.step(duration=1000 * simulation.step_size)


def test_energy_from_nowhere_is_refused():
    start = load_scene('three_rrr')
    simulation = Simulation(replace(start, method=Method(
        integrator='semi_implicit_euler', step_size=1e-3)))
    with pytest.raises(NumericalError, match='energy balance is off'):
        for _ in range(100):
            simulation.step((5.0, -3.0, 2.0), 0.1)
