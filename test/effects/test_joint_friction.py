# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Dry friction in a joint."""

from dataclasses import replace

from closedloop_dynamics import Body, codegen, Joint, load_scene, Mechanism, Method, Simulation
from closedloop_dynamics.codegen import TORQUE_RESPONSE
from closedloop_dynamics.effects.registry import (
    Gravity, JointFriction, JointSpring, PrescribedForce)
from closedloop_dynamics.mechanism.mechanism import REVOLUTE
from closedloop_dynamics.scene.integrators import INTEGRATORS
import numpy as np
import pytest
from scipy.optimize import brentq, lsq_linear

from .machines import assert_balanced, block, pendulum, simulated, slider_crank
from ..reference import cases, dense, maximal


# Euler's method is of first order, and has a test of its own.
# Kernels of their own for steps that others take, too: RODAS4's are those of 'auto'.
RARE = ('heun', 'rodas4', 'rodas4_fixed')
EVERY = [pytest.param(name, marks=[pytest.mark.slow] * (name in RARE))
         for name in INTEGRATORS if name != 'semi_implicit_euler']


def oscillator(**method):
    """Return a mass of 1 kg on 100 N/m under 1 N of Coulomb friction, released at 0.105 m."""
    return simulated(block(), {
        'spring': JointSpring('slide', 100.0), 'friction': JointFriction('slide', 1.0)},
        [0.105], **method)


@pytest.mark.parametrize('integrator', EVERY)
def test_the_oscillator_sticks_where_it_should_when_it_should_and_stays(integrator):
    simulation = oscillator(integrator=integrator)
    # The fourth half swing ends at 0.4 pi s, the fifth and last at 0.5 pi s.
    simulation.step(duration=1.5)
    assert simulation.position[0] == pytest.approx(
        0.01 + 0.015 * np.cos(10.0 * (1.5 - 0.4 * np.pi)), abs=5e-6)
    simulation.step(duration=0.0705)
    assert simulation.velocity[0] < -4e-4
    simulation.step(duration=0.0005)
    stuck = simulation.position[0]
    assert stuck == pytest.approx(-0.005, rel=1e-3)
    assert simulation.velocity[0] == 0.0
    simulation.step(duration=100.0)
    assert simulation.position[0] == stuck
    assert simulation.effect_readings('friction')['torque'] == pytest.approx(
        100.0 * stuck, rel=1e-12)
    assert_balanced(simulation, 1e-4)


def test_the_instant_of_rest_does_not_depend_on_the_steps():
    ends = []
    for step_size in (1e-3, 7e-4, 3.1e-4):
        simulation = oscillator(step_size=step_size)
        simulation.step(duration=1.6)
        ends.append(simulation.position[0])
        assert_balanced(simulation, 1e-9)
    assert ends == pytest.approx([-0.005] * 3, abs=1e-10)


def test_a_rest_is_found_by_dense_output():
    # Five times; by repeating the step each time 1,219 evaluations are needed.
    simulation = oscillator(integrator='auto', step_size=0.01)
    before = simulation.health.evaluations
    simulation.step(duration=1.6)
    assert simulation.position[0] == pytest.approx(-0.005, abs=1e-9)
    assert simulation.health.evaluations - before < 1000


@pytest.mark.parametrize('integrator, stages', [('dop853', 12), ('dopri5', 7)])
def test_a_step_that_a_rest_cuts_is_not_repeated(integrator, stages):
    simulation = oscillator(integrator=integrator, step_size=2e-3)
    before, worst = simulation.health.evaluations, 0.0
    for number in range(1, 801):
        # Another torque for every step, which is short, then, and accurate.
        simulation.step([1e-13 * number], 2e-3)
        half = min(4, int(2e-3 * number / (0.1 * np.pi)))
        swing = min(0.02 * number - np.pi * half, np.pi)
        worst = max(worst, abs(simulation.position[0] - (-1.0) ** half * (
            0.01 + (0.095 - 0.02 * half) * np.cos(swing))))
    assert worst < 2e-9
    # Five rests, each of which takes the evaluations of its dense output.
    accepted = simulation.stepping.run.steps.accepted
    assert simulation.health.evaluations - before < stages * (accepted + 5)


def test_first_order_steps_come_to_rest_too():
    simulation = oscillator(integrator='semi_implicit_euler', step_size=1e-4)
    simulation.step(duration=2.0)
    assert simulation.position[0] == pytest.approx(-0.005, rel=1e-3)
    assert simulation.velocity[0] == 0.0


@pytest.mark.parametrize('integrator', EVERY)
def test_a_block_slides_down_an_incline_hardly_steep_enough(integrator):
    angle = np.radians(20.0)
    simulation = simulated(
        block(1.0, -angle), {'gravity': Gravity((0.0, -9.81)),
                             'friction': JointFriction('slide', friction_coefficient=0.36)},
        [0.0], integrator=integrator)
    simulation.step(duration=1.0)
    pull = 9.81 * (np.sin(angle) - 0.36 * np.cos(angle))
    assert simulation.position[0] == pytest.approx(0.5 * pull, rel=1e-9)
    # 0.364 is what the slope asks for.
    simulation.set_effect('friction', friction_coefficient=0.37)
    simulation.step(duration=2.0)
    rest = simulation.position[0]
    simulation.step(duration=1.0)
    assert (simulation.velocity[0], simulation.position[0]) == (0.0, rest)


@pytest.mark.parametrize('integrator', EVERY)
def test_a_wheel_spins_down_and_stays(integrator):
    simulation = simulated(
        pendulum(), {'friction': JointFriction('hinge', 0.7)}, [0.0], [3.0],
        integrator=integrator)
    # The moment of inertia is 0.5 kg m^2.
    stop = 3.0 * 0.5 / 0.7
    simulation.step(duration=stop - 1e-3)
    assert simulation.velocity[0] == pytest.approx(1.4e-3, rel=1e-3)
    simulation.step(duration=2e-3)
    assert simulation.position[0] == pytest.approx(1.5 * stop, rel=1e-9)
    assert simulation.velocity[0] == 0.0
    assert simulation.energy_balance.dissipated == pytest.approx(0.25 * 9.0, rel=1e-9)


@pytest.mark.parametrize('integrator', EVERY)
@pytest.mark.parametrize('load', [2.999, -2.999, 3.003, -4.0])
def test_a_sudden_load_moves_the_block_only_beyond_the_static_limit(load, integrator):
    simulation = simulated(block(), {'friction': JointFriction(
        'slide', 2.0, static_ratio=1.5, stribeck_velocity=1e9)}, [0.0], integrator=integrator)
    simulation.step([load], 1.0)
    beyond = np.sign(load) * max(0.0, abs(load) - 3.0)
    assert simulation.position[0] == pytest.approx(0.5 * beyond, rel=1e-9)
    assert simulation.effect_readings('friction')['torque'] == pytest.approx(
        -np.sign(load) * min(3.0, abs(load)), rel=1e-12)


@pytest.mark.parametrize('share, moved', [(0.999, False), (-0.999, False), (1.001, True)])
def test_a_sudden_load_is_held_up_to_the_static_limit_with_defaults(share, moved):
    simulation = simulated(
        block(), {'friction': JointFriction('slide', 2.0, static_ratio=1.5)}, [0.0])
    simulation.step([3.0 * share], 1.0)
    # Once it slides, friction falls to 2 N.
    assert simulation.position[0] > 0.1 if moved else simulation.position[0] == 0.0


def test_a_ramped_load_breaks_away_at_the_static_limit():
    simulation = simulated(block(), {'friction': JointFriction('slide', 1.0)}, [0.0])
    for k in range(1500):
        # 2 N/s, as its mean in each step.
        simulation.step([2.0 * (k + 0.5) * 1e-3])
        if k == 498:
            assert simulation.position[0] == 0.0
    assert simulation.velocity[0] == pytest.approx(1.0, rel=1e-6)
    assert simulation.position[0] == pytest.approx(1.0 / 3.0, rel=1e-5)


@pytest.mark.parametrize('count', [4, 8])
def test_joints_break_away_where_their_loads_reach_the_limit(count):
    blocks = Mechanism(
        'blocks', tuple(Body(f'block_{k}', 1.0, (0.0, 0.0), 0.1) for k in range(count)),
        tuple(Joint(f'slide_{k}', 'prismatic', 'ground', f'block_{k}', (0.0, 0.0), 0.0, True)
              for k in range(count)), (), ())
    # The first load is too much for 0.02 s alone.
    pushes, omega = 1.002 + 0.3 * np.arange(count), 2.0 * np.pi
    simulation = simulated(blocks, {
        **{f'friction_{k}': JointFriction(f'slide_{k}', 1.0) for k in range(count)},
        **{f'push_{k}': PrescribedForce('sine', f'slide_{k}', amplitude=push, frequency=1.0)
           for k, push in enumerate(pushes)}}, np.zeros(count), integrator='auto', step_size=2e-3)
    simulation.step(duration=0.5)
    for push, place in zip(pushes, simulation.position):
        start = np.arcsin(1.0 / push) / omega

        def rate(time):
            return push / omega * (np.cos(omega * start) - np.cos(omega * time)) - time + start
        end = brentq(rate, 0.5 - start, 1.0) if rate(0.5) < 0.0 else 0.5
        moved = end - start
        exact = push / omega * np.cos(omega * start) * moved - 0.5 * moved ** 2
        exact -= push / omega ** 2 * (np.sin(omega * end) - np.sin(omega * start))
        assert place == pytest.approx(exact, abs=1e-10)
    # Error control alone would reject a step or more for each.
    assert simulation.stepping.run.steps.rejected < 10


def test_several_frictions_in_one_joint_hold_together():
    simulation = simulated(block(), {
        'seal': JointFriction('slide', 1.0), 'guide': JointFriction('slide', 2.0)}, [0.0])
    simulation.step([2.99], 1.0)
    assert simulation.position[0] == 0.0
    held = [simulation.effect_readings(name)['torque'] for name in ('seal', 'guide')]
    assert sum(held) == pytest.approx(-2.99, rel=1e-12)
    assert np.all(np.abs(held) <= [1.0, 2.0])
    simulation.step([3.1], 1.0)
    assert simulation.position[0] == pytest.approx(0.05, rel=1e-9)


@pytest.mark.parametrize('case', ['three_rrr', 'carpet_scraper'])
def test_friction_in_all_joints_brings_a_mechanism_to_rest_and_holds_it(case):
    _, mechanism, q, qd = cases.drawn(case)
    effects = {'gravity': Gravity((0.0, -9.81)), **{
        joint.name: JointFriction(joint.name, 20.0) for joint in mechanism.joints}}
    simulation = simulated(mechanism, effects, q, qd)
    kinetic = simulation.energy_balance.kinetic
    simulation.step(duration=1.0)
    assert_balanced(simulation, 1e-5 * kinetic)
    rest = simulation.position
    simulation.step(duration=1.0)
    assert np.array_equal(simulation.position, rest)
    assert np.abs(simulation.forward_dynamics(rest, np.zeros(len(q)))[0]).max() < 1e-9
    torques = [simulation.effect_readings(joint.name)['torque'] for joint in mechanism.joints]
    assert np.abs(torques).max() <= 20.0


@pytest.mark.parametrize('scene', ['four_bar', 'rssr_four_bar'])
def test_a_coefficient_given_later_is_the_same_as_from_the_start(scene):
    scene, ends = load_scene(scene), []
    joint = scene.mechanism.joints[0].name
    for coefficient in (0.3, 0.0):
        friction = JointFriction(
            joint, coulomb=1e-3, friction_coefficient=coefficient, radius=0.02)
        simulation = Simulation(replace(scene, effects={**scene.effects, 'dry': friction}))
        simulation.set_effect('dry', friction_coefficient=0.3)
        simulation.reset()
        simulation.step(duration=0.1)
        assert simulation.effect_readings('dry')['reaction'] > 0.1
        ends.append(simulation.state)
    np.testing.assert_array_equal(*ends)


def chain(rng, count):
    """Return bodies that hang on one another by pins, of very different masses."""
    names = [f'link_{k}' for k in range(count)]
    return Mechanism('chain', tuple(
        Body(name, 10.0 ** rng.uniform(-1, 1), tuple(rng.uniform(-0.2, 0.2, 2)), 0.1)
        for name in names), tuple(
        Joint(f'pin_{name}', REVOLUTE, parent, name, tuple(rng.uniform(-0.3, 0.3, 2)), 0.0, True)
        for parent, name in zip(('ground', *names), names)), ())


@pytest.mark.parametrize('seed', range(20))
def test_friction_at_rest_makes_the_accelerations_least(seed):
    """By the principle of least constraint; in some pins there are several frictions."""
    rng = np.random.default_rng(seed)
    mechanism = chain(rng, int(rng.integers(1, 5)))
    pins = [joint.name for joint in mechanism.joints]
    places = rng.integers(0, len(pins), int(rng.integers(1, 7)))
    bounds = 10.0 ** rng.uniform(-1, 1, len(places))
    position = rng.uniform(-3.0, 3.0, len(pins))
    simulation = simulated(mechanism, {
        f'friction_{k}': JointFriction(pins[place], bound)
        for k, (place, bound) in enumerate(zip(places, bounds))}, position)
    torque = 5.0 * rng.normal(size=len(pins))
    simulation.step(torque, 0.0)
    inertia = dense.generalized_inertia_matrix(mechanism, position)
    root = np.linalg.cholesky(np.linalg.inv(inertia)).T
    best = lsq_linear(root[:, places], -root @ torque, (-bounds, bounds), method='bvls',
                      tol=1e-15, max_iter=500)
    found = simulation.acceleration
    assert found @ inertia @ found <= 2.0 * best.cost * (1.0 + 1e-9) + 1e-9
    held = inertia @ found - torque
    np.testing.assert_allclose(held, sum(
        simulation.effect_readings(f'friction_{k}')['torque'] * (np.arange(len(pins)) == place)
        for k, place in enumerate(places)), rtol=0, atol=1e-9)
    for k, bound in enumerate(bounds):
        assert abs(simulation.effect_readings(f'friction_{k}')['torque']) <= bound


def test_a_change_of_friction_takes_effect_at_once():
    simulation = simulated(block(), {'friction': JointFriction('slide', 1.0)}, [0.0], [1.0])
    simulation.set_effect('friction', enabled=False)
    simulation.step(duration=0.5)
    simulation.set_effect('friction', enabled=True, coulomb=2.0)
    simulation.step(duration=1.0)
    assert simulation.position[0] == pytest.approx(0.75, rel=1e-9)
    simulation.set_state([0.0], [-1.0])
    simulation.step(duration=1.0)
    assert simulation.position[0] == pytest.approx(-0.25, rel=1e-9)


def test_any_state_asked_for_feels_the_friction_of_its_own_rates():
    simulation = simulated(block(2.0), {'friction': JointFriction('slide', 3.0)}, [0.0], [2.0])
    for rate, load, expected in ((1.0, 0.0, -1.5), (-1.0, 0.0, 1.5), (0.0, 2.0, 0.0),
                                 (0.0, 4.0, 0.5)):
        assert simulation.forward_dynamics([0.0], [rate], [load])[0] == pytest.approx(expected)


def test_sliding_friction_is_exact():
    simulation = simulated(block(2.0), {'friction': JointFriction('slide', 3.0)}, [0.0], [2.0])
    simulation.step(duration=1.0)
    assert simulation.velocity[0] == pytest.approx(0.5, rel=1e-12)
    assert simulation.energy_balance.dissipated == pytest.approx(3.75, rel=1e-12)


def test_stribeck_friction_falls_with_the_rate():
    friction = JointFriction('slide', 2.0, static_ratio=1.5, stribeck_velocity=0.1)
    simulation = simulated(block(), {'friction': friction}, [0.0], [0.1])
    simulation.step(duration=1e-2)
    rate = simulation.velocity[0]
    assert simulation.effect_readings('friction')['torque'] == pytest.approx(
        -2.0 * (1.0 + 0.5 * np.exp(-(rate / 0.1) ** 2)), rel=1e-9)


@pytest.mark.parametrize('angle', [0.0, 0.3])
def test_a_block_slides_on_its_own_weight(angle):
    friction = JointFriction('slide', friction_coefficient=0.25)
    simulation = simulated(
        block(2.0, angle), {'gravity': Gravity((0.0, -9.81)), 'friction': friction}, [0.0], [4.0])
    simulation.step(duration=0.5)
    pull = 9.81 * (np.sin(angle) + 0.25 * np.cos(angle))
    assert simulation.velocity[0] == pytest.approx(4.0 - 0.5 * pull, rel=1e-9)
    assert simulation.effect_readings('friction')['reaction'] == pytest.approx(
        2.0 * 9.81 * np.cos(angle), rel=1e-9)
    assert_balanced(simulation, 1e-6)


def test_a_hinge_feels_weight_and_centrifugal_force():
    friction = JointFriction('hinge', friction_coefficient=0.1, radius=0.02)
    simulation = simulated(
        pendulum(), {'gravity': Gravity((0.0, -9.81)), 'friction': friction},
        [-np.pi / 2.0], [3.0])
    force = 2.0 * (9.81 + 9.0 * 0.5)
    # The friction's own deceleration adds a little across.
    assert simulation.effect_readings('friction')['reaction'] == pytest.approx(force, rel=1e-4)
    assert simulation.effect_readings('friction')['limit'] == pytest.approx(
        0.002 * force, rel=1e-3)


@pytest.mark.parametrize('case', cases.SHIPPED)
def test_reactions_equal_those_of_maximal_coordinates(case):
    _, mechanism, q, qd = cases.drawn(case)
    # Friction too small to matter: what is looked at are the forces.
    effects = {'gravity': Gravity((0.0, -9.81)), **{
        f'at_{joint.name}': JointFriction(joint.name, friction_coefficient=1e-12)
        for joint in mechanism.joints}}
    simulation = simulated(mechanism, effects, q, qd)
    expected = maximal.forward_dynamics(mechanism, q, qd, np.zeros(len(q))).reactions
    for joint in mechanism.joints:
        reaction = np.ravel(expected[joint.name])
        size = np.hypot(*reaction[:2]) if joint.type == REVOLUTE else abs(reaction[0])
        assert simulation.effect_readings(f'at_{joint.name}')['reaction'] == pytest.approx(
            size, rel=1e-8)


def excavator_arm(friction, motion):
    """Return the shipped arm, moved by some cylinders, with friction in a joint."""
    scene = load_scene('excavator_arm')
    return Simulation.from_scene(
        replace(scene, effects={**scene.effects, 'friction': friction}), motion)


@pytest.mark.slow
def test_reactions_are_right_where_the_elimination_alone_will_not_do():
    simulation = excavator_arm(
        JointFriction('slew', friction_coefficient=1e-9), {'boom_cylinder': '1.015'})
    simulation.step()
    assert simulation.effect_readings('friction')['reaction'] == pytest.approx(
        np.linalg.norm(simulation.force('slew')[3:]), rel=1e-9)


@pytest.mark.slow
def test_a_joint_that_motions_hold_at_rest_needs_no_friction():
    motion = {'slew': '0.1 * t', 'boom_cylinder': '1.015 + 0.1 * sin(t)',
              'stick_cylinder': '1.225', 'bucket_cylinder': '1.027'}
    simulation = excavator_arm(
        JointFriction('stick_pin', friction_coefficient=0.05, radius=0.05), motion)
    frictionless = excavator_arm(JointFriction('stick_pin'), motion)
    for each in (simulation, frictionless):
        each.step()
    # Rounding over rounding decided its friction, of which the load made steps of nanoseconds.
    assert simulation.report().evaluations < 500
    readings = simulation.effect_readings('friction')
    assert (readings['torque'], readings['dissipated_energy']) == (0.0, 0.0)
    assert readings['reaction'] == pytest.approx(
        np.linalg.norm(frictionless.force('stick_pin')[3:]), rel=1e-9)
    for name, force in frictionless.motion_forces.items():
        assert simulation.motion_forces[name] == pytest.approx(force, rel=1e-9)


@pytest.mark.slow
def test_a_joint_that_motions_move_rubs():
    motion = {'slew': '0.1 * t', 'boom_cylinder': '1.015 + 0.1 * sin(t)',
              'stick_cylinder': '1.225', 'bucket_cylinder': '1.027'}
    moved = excavator_arm(JointFriction('boom_pin', coulomb=3.0), motion)
    moved.step()
    assert moved.effect_readings('friction')['torque'] == -3.0


def test_friction_holds_a_slider_that_started_at_its_dead_centre():
    # There its rate is zero, whatever the crank's; elsewhere nothing but friction holds it.
    simulation = simulated(slider_crank(), {
        'spring': JointSpring('crank', 1.0), 'friction': JointFriction('slider', 100.0)},
        [0.0, 1.5, 0.0])
    simulation.set_state({'crank': 1.0})
    start = simulation.position
    simulation.step(duration=0.1)
    assert simulation.position == pytest.approx(start, abs=1e-12)
    assert simulation.effect_readings('friction')['torque'] != 0.0


@pytest.mark.parametrize('share', [1.0, 1e-7], ids=['heavy', 'light'])
@pytest.mark.parametrize('name', ['three_rrr', 'stewart_platform'])
def test_friction_of_many_joints_at_rest_by_loops_over_bodies_is_that_of_generated_code(
        name, share, monkeypatch):
    scene = load_scene(name)
    bodies = scene.mechanism.bodies
    # One light body: its equations are refined.
    light = replace(bodies[0], mass=share * bodies[0].mass, inertia=(
        share * np.array(bodies[0].inertia)).tolist())
    mechanism = replace(scene.mechanism, bodies=(light, *bodies[1:]))
    rubbing = [joint.name for joint in mechanism.joints if joint.type in ('revolute', 'prismatic')]
    scene = replace(scene, mechanism=mechanism, initial=replace(
        scene.initial, velocity=tuple(0.0 * np.array(scene.initial.velocity))),
        method=Method(integrator='rk4'), effects={
            **scene.effects, **{f'dry_{joint}': JointFriction(joint, 0.5 + 0.1 * number)
                                for number, joint in enumerate(rubbing)}})
    found, evaluations = [], []
    for most in (None, 0):
        if most is not None:
            monkeypatch.setattr(codegen, 'MOST_UNROLLED_IN_PLANE', most)
            monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', most)
        simulation = Simulation(scene)
        torques = np.linspace(-3.0, 40.0, len(mechanism.actuated_joints))
        simulation.step(dict(zip(mechanism.actuated_joints, torques)))
        evaluations.append(simulation.health.evaluations)
        found.append((simulation.acceleration, *(
            simulation.effect_readings(f'dry_{joint}')['torque'] for joint in rubbing)))
        assert simulation.data.system.is_unrolled == (most is None)
    by_code, by_loops = (np.hstack(one) for one in found)
    assert len(rubbing) > 2 and np.abs(by_code).max() > 1e-3
    np.testing.assert_allclose(by_loops, by_code, rtol=0, atol=1e-9 * np.abs(by_code).max())
    # There an evaluation serves for the response to each friction, too.
    assert evaluations[1] < 4 * len(rubbing)


def chain_of_hinges(count):
    """Return a simulation of rods in a row, with a drive and dry friction in every hinge."""
    ends = ['ground', *(f'rod{number}' for number in range(count))]
    bodies = tuple(Body(name, 0.5, (0.1, 0.02), 2e-3) for name in ends[1:])
    joints = tuple(
        Joint(f'hinge{number}', 'revolute', before, name, (0.2 * (number > 0), 0.0), 0.0, True)
        for number, (before, name) in enumerate(zip(ends, ends[1:])))
    return simulated(
        Mechanism('chain', bodies, joints, (), ()), {'gravity': Gravity((0.0, -9.81)), **{
            f'dry{number}': JointFriction(f'hinge{number}', 1.5 * (count - number))
            for number in range(count)}}, [0.3] * count, step_size=0.02)


@pytest.mark.parametrize('operations', [None, 0], ids=['generated', 'loops'])
def test_a_step_among_joints_at_rest_is_that_of_evaluations_one_by_one(operations, monkeypatch):
    # More joints than one routine has the responses of; some hold, some break away.
    count = 10
    if operations is not None:
        monkeypatch.setattr(codegen, 'MOST_UNROLLED_IN_PLANE', operations)
    simulation, twin = (chain_of_hinges(count) for _ in range(2))
    assert simulation.data.system.is_unrolled == (operations is None)
    torque = np.where(np.arange(count) < 5, 0.0, 30.0)

    def slope(state):
        return np.append(state[count:], twin.forward_dynamics(
            state[:count], state[count:], torque)[0])

    start, size = np.append(simulation.position, simulation.velocity), 0.02
    first = slope(start)
    second = slope(start + 0.5 * size * first)
    third = slope(start + 0.5 * size * second)
    last = slope(start + size * third)
    expected = start + size / 6.0 * (first + 2.0 * second + 2.0 * third + last)
    before = simulation.health.evaluations
    simulation.step(torque)
    found = np.append(simulation.position, simulation.velocity)
    still = np.abs(expected[count:]) == 0.0
    assert 2 < still.sum() < count and np.abs(expected[:count] - 0.3).max() > 1e-3
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    # The responses of one evaluation of the step serve the three others.
    assert simulation.health.evaluations - before < 4 * (count + 1)


def scissor_lift_with_dry_hinges():
    """Return a simulation of a ladder of loops at rest, with dry friction in every hinge."""
    scene = load_scene('scissor_lift')
    hinges = [joint.name for joint in scene.mechanism.joints if joint.type == 'revolute']
    return Simulation(replace(scene, initial=replace(
        scene.initial, velocity=tuple(0.0 * np.array(scene.initial.velocity))), effects={
            **scene.effects, **{f'dry_{joint}': JointFriction(joint, 0.5 + 0.1 * number)
                                for number, joint in enumerate(hinges)}}))


@pytest.mark.parametrize('simulation_of', [
    scissor_lift_with_dry_hinges, lambda: chain_of_hinges(10)], ids=['scissor_lift', 'chain'])
def test_friction_at_rest_is_balanced_by_the_factors_of_the_evaluation(simulation_of):
    found, evaluations = [], []
    for by_factors in (True, False):
        simulation = simulation_of()
        routines = simulation.data.system.table
        assert routines[TORQUE_RESPONSE] != 0
        if not by_factors:
            routines[TORQUE_RESPONSE] = 0
        before = simulation.health.evaluations
        found.append(np.hstack(simulation.forward_dynamics(
            simulation.position, simulation.velocity,
            np.linspace(-3.0, 40.0, len(simulation.actuated_joints)))))
        evaluations.append(simulation.health.evaluations - before)
    assert np.abs(found[1]).max() > 1e-3
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-11 * np.abs(found[1]).max())
    assert evaluations[0] <= 2 and evaluations[1] > 5
