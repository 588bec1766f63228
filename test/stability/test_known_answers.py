# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Published benchmarks and closed forms, and what a benchmark's figure alone does not say."""

from dataclasses import replace
import math

from closedloop_dynamics import (
    AssemblyError, Body, load_scene, Mechanism, Method, scene_names, Simulation)
from closedloop_dynamics.effects.registry import JointSpring
import hard_cases
import hard_machines as machines
import numpy as np
import pytest

from ..reference import cases
from ..reference.scenes import simulated

# Some compile for minutes on a busy machine.
pytestmark = pytest.mark.timeout(1200)
TIGHT = Method(integrator='dop853', tolerance=1e-11, step_size=1e-2)


def test_looped_pendulum_swings_like_a_pendulum():
    mechanism, q, qd = hard_cases.looped_pendulum()
    simulation = Simulation(machines.scene(mechanism, q, qd, TIGHT, machines.gravity(0.0)))
    angle = 0.3 - 0.5 * math.pi
    simulation.set_state([angle, math.cos(angle), math.sin(angle)])
    assert simulation.acceleration[0] == pytest.approx(-machines.G * math.cos(angle), rel=1e-12)
    simulation.reset()
    # Half a period on, it stands still on the other side.
    simulation.step(duration=0.5 * hard_cases.PENDULUM_PERIOD)
    assert simulation.position[1:] == pytest.approx([-1.0, 0.0], abs=1e-9)
    assert simulation.closure < 1e-12


def test_kinetic_energy_of_the_slider_crank_adds_up():
    simulation = Simulation(machines.scene(
        *hard_cases.slider_crank(), TIGHT, hard_cases.SLIDER_CRANK_EFFECTS))
    kinetic = [simulation.energy_balance.kinetic]
    for _ in range(1000):
        simulation.step()
        kinetic.append(simulation.energy_balance.kinetic)
    weights = np.full(1001, 2.0)
    weights[1::2], weights[0], weights[-1] = 4.0, 1.0, 1.0
    assert weights @ kinetic * 0.01 / 3.0 == pytest.approx(3.336606799483, abs=1e-9)


@pytest.mark.parametrize('wait', [0.0, 0.0004999, 0.0123])
@pytest.mark.parametrize('integrator', ['rk4', 'dop853', 'rodas4'])
def test_impulse_is_not_missed(integrator, wait):
    mechanism, q, qd = machines.ladder(1, 0.0, 0.0)
    simulation = Simulation(machines.scene(
        mechanism, q, qd, Method(integrator=integrator, tolerance=1e-9), {}))
    simulation.step(duration=wait)
    simulation.step((1e4,), 1e-4)
    assert simulation.velocity[0] == pytest.approx(0.6, abs=1e-6)
    assert simulation.energy_balance.work == pytest.approx(0.5 * 5.0 / 3.0 * 0.36, rel=1e-6)


def test_mass_that_sticks_does_not_creep():
    simulation = hard_cases.stuck_mass(Method())
    simulation.step(duration=1.56)
    assert abs(simulation.velocity[0]) > 1e-3
    simulation.step(duration=0.44)
    rest = simulation.position[0]
    assert rest == pytest.approx(-0.005, abs=1e-9)
    simulation.step(duration=1.0)
    assert simulation.position[0] == rest


@pytest.mark.parametrize('name', cases.only(
    ('planetary_gear', 'slider_crank', 'three_rrr'),
    sorted({scene.mechanism.name for scene in map(load_scene, scene_names())
            if scene.mechanism.planar})))
def test_any_mechanism_with_every_loop_twice_moves_the_same(name):
    start = load_scene(next(
        scene for scene in scene_names() if load_scene(scene).mechanism.name == name))
    start = replace(start, effects={}, method=Method())
    once = Simulation(start)
    if not once.mechanism.cut_joints:
        pytest.skip('has no loop')
    twice = Simulation(replace(start, mechanism=machines.doubled(start.mechanism)))
    rng = np.random.default_rng(3)
    once.set_state(once.position, rng.normal(size=len(once.joint_names)))
    torque = rng.normal(size=len(once.actuated_joints))
    qdd, lam = once.forward_dynamics(once.position, once.velocity, torque)
    again, shared = twice.forward_dynamics(once.position, once.velocity, torque)
    np.testing.assert_allclose(again, qdd, rtol=0, atol=1e-9 * np.abs(qdd).max())
    # Couplings come behind all cut joints, once.
    cuts = len(lam) - len(start.mechanism.couplings)
    total = np.append(shared[:2 * cuts].reshape(2, -1).sum(axis=0), shared[2 * cuts:])
    np.testing.assert_allclose(total, lam, rtol=0, atol=1e-9 * np.abs(lam).max())
    twice.set_state(once.position, once.velocity)
    assert twice.health.rank == len(lam) == twice.health.equations - cuts


@pytest.mark.parametrize('name', ['three_rrr', 'carpet_scraper'])
def test_inconsistent_start_is_closed_to_rounding_nearest_and_on_its_branch(name):
    start = load_scene(name)
    simulation = Simulation(start)
    home = simulation.position
    rng = np.random.default_rng(4)
    for _ in range(20):
        shaken = home + rng.uniform(-1e-2, 1e-2, len(home))
        simulation.set_state(shaken)
        change = simulation.position - shaken
        assert simulation.closure < 1e-12
        assert np.abs(change).max() < 0.05
        # Nearest in the mass metric: what is left of the change along the loops' freedoms is of
        # second order.
        inertia = simulation.inertia
        _, singular, right = np.linalg.svd(simulation.constraint_jacobian)
        free = right[len(singular):]
        root = np.linalg.cholesky(inertia).T
        along = np.linalg.qr(root @ free.T)[0].T @ (root @ change)
        assert np.linalg.norm(along) < 0.1 * np.linalg.norm(root @ change)


def test_independent_coordinates_refuse_to_start_on_a_singular_configuration():
    method = Method(integrator='rk4', stabilisation='independent')
    with pytest.raises(AssemblyError, match='singular configuration.*stabilisation: projection'):
        Simulation(machines.scene(*machines.ladder(1, 0.5 * math.pi), method))
    simulation = Simulation(machines.scene(*machines.ladder(1, 1.0), method))
    before = simulation.position
    _, flat, rates = machines.ladder(1, 0.5 * math.pi)
    with pytest.raises(AssemblyError, match='no set of independent coordinates'):
        simulation.set_state(flat, rates)
    np.testing.assert_array_equal(simulation.position, before)
    # Passing one is another matter.
    simulation.step(duration=0.5)
    assert simulation.position[0] < -0.5 * math.pi


@pytest.mark.slow
@pytest.mark.parametrize('name', ['three_rrr', 'carpet_scraper'])
def test_gap_has_no_trend_over_an_hour(name):
    simulation = Simulation(replace(load_scene(name), method=Method()))
    tau, gaps = np.zeros(len(simulation.joint_names)), []
    for _ in range(3600):
        simulation.advance(tau, 1000)
        gaps.append(simulation.closure)
    assert max(gaps) < 1e-10
    assert max(gaps[-900:]) < 2.0 * max(gaps[:900])
    # Nothing grows but the rounding of angles that count on, some hundred radians.
    rounding = 1e-15 * np.abs(simulation.position).max()
    assert np.median(gaps[-900:]) < max(3.0 * np.median(gaps[:900]), rounding)


def pendulum(bodies, joints, method, effects=()):
    """Return where a chain of bars under gravity has swung in half a second [rad]."""
    simulation = simulated(Mechanism('pendulum', bodies, joints), effects={
        **machines.gravity(0.0), **dict(effects)}, method=method)
    simulation.step(duration=0.5)
    return simulation.position[0]


def test_stiff_method_keeps_its_order_beside_a_stiff_spring():
    # The knee would swing at a million radians a second: steps of 5 to 40 thousand of them.
    upper, lower = machines.bar('upper', 1.0, 1.0), machines.bar('lower', 2.0, 0.5)
    pivot, knee = (machines.hinge('pivot', 'ground', 'upper'),
                   machines.hinge('knee', 'upper', 'lower', 1.0))
    center = (0.5 + 2.0 * 1.25) / 3.0
    inertia = (upper.inertia + (0.5 - center) ** 2
               + lower.inertia + 2.0 * (1.25 - center) ** 2)
    exact = pendulum((Body('both', 3.0, (center, 0.0), inertia),),
                     (machines.hinge('pivot', 'ground', 'both'),),
                     Method(integrator='dop853', tolerance=1e-13, step_size=0.5))
    errors = [abs(exact - pendulum(
        (upper, lower), (pivot, knee), Method(integrator='rodas4_fixed', step_size=size),
        {'spring': JointSpring('knee', 1e11, 0.0)})) for size in (0.05, 0.025, 0.0125, 0.00625)]
    assert errors[0] > 12.0 * errors[1] > 144.0 * errors[2] > 1728.0 * errors[3]
