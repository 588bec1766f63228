# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Planar loops that repeat one another: free of charge, exchanged, taken again where need be."""

from dataclasses import replace
import math

from closedloop_dynamics import (
    Body, Coupling, CutJoint, Joint, load_scene, Mechanism, Method, Point, Simulation)
from closedloop_dynamics.effects.registry import ExternalForce, JointFriction, PrescribedMotion
from closedloop_dynamics.engine.types import RANK_REVEALING_COUNT
from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.mechanism.mechanism import DISTANCE, POINT_ON_LINE, PRISMATIC, REVOLUTE
from closedloop_dynamics.studies.check import describe
import hard_machines as machines
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ..reference.compare import assert_agree
from ..reference.formulations import dense_dynamics, FORMULATIONS

# The rank-revealing path is compiled for a minute on a busy machine.
pytestmark = pytest.mark.timeout(1200)
# Wheels of a locomotive, from axle to axle and from axle to pin [m]; out of balance; its rods.
APART, PIN, WHEEL, ROD = 1.0, 0.3, Body('wheel', 100.0, (0.05, 0.0), 5.0), 30.0
START, RATE = 0.7, 10.0
STEPS = {'integrator': 'rk4', 'step_size': 1e-3}


def locomotive(wheels, rods=1):
    """Return wheels that rods couple, the second one on pins a quarter turn before the first."""
    bodies = [replace(WHEEL, name=f'wheel_{k}') for k in range(wheels)]
    joints = [machines.hinge(f'axle_{k}', 'ground', f'wheel_{k}', k * APART, 0.0, 0.0, k == 0)
              for k in range(wheels)]
    cuts, q = [], wheels * [START]
    for n, pin in enumerate(((PIN, 0.0), (0.0, PIN))[:rods]):
        bodies.append(Body(f'rod_{n}', ROD, (0.5 * (wheels - 1) * APART, 0.0), 10.0))
        joints.append(machines.hinge(f'pin_{n}', 'wheel_0', f'rod_{n}', *pin))
        cuts += [
            CutJoint(f'pin_{n}_{k}', REVOLUTE, f'rod_{n}', f'wheel_{k}', (k * APART, 0.0), pin)
            for k in range(1, wheels)]
        q.append(-START)
    q = np.array(q)
    return Mechanism('locomotive', tuple(bodies), tuple(joints), tuple(cuts)), q, (
        RATE * np.sign(q))


def inertia_of(wheels, rods):
    """Return the inertia about the axles of all that goes round, none of the rods turning."""
    return wheels * (WHEEL.inertia + WHEEL.mass * 0.05 ** 2) + rods * ROD * PIN ** 2


def moment_of(wheels, rods, angle):
    """Return the moment of gravity about the axles."""
    pins = math.cos(angle) - (math.sin(angle) if rods == 2 else 0.0)
    return -machines.G * (wheels * WHEEL.mass * 0.05 * math.cos(angle) + ROD * PIN * pins)


def simulate(machine, effects=None, **method):
    """Return a simulation of a mechanism at a state, under gravity along -y."""
    effects = {**machines.gravity(0.0), **(effects or {})}
    return Simulation(machines.scene(*machine, Method(**method), effects))


def by_all_equations(simulation):
    """Return another one in the same state that leaves nothing out: that of singular values."""
    scene = simulation.scene
    other = Simulation(replace(scene, method=replace(scene.method, stabilisation='none')))
    assert not other.data.has_redundant_constraints
    other.restore(np.concatenate([simulation.data.integrated]), 0.0)
    return other


def assert_same_evaluation(one, other):
    """Compare all that an evaluation tells."""
    scale = np.abs(other.acceleration).max()
    assert_agree(one.acceleration, other.acceleration, 1e-9, smallest=scale)
    for quantity in ('multipliers', 'constraint_forces', 'joint_forces'):
        expected = getattr(other, quantity)
        assert_agree(getattr(one, quantity), expected, 1e-8, smallest=np.abs(expected).max())
    assert one.health.rank == other.health.rank
    assert one.health.equations == other.health.equations
    assert one.health.unique_forces == other.health.unique_forces


def doubled_ladder(loops):
    """Return parallelograms in a row, every pin twice."""
    mechanism, q, qd = machines.ladder(loops, 0.4)
    return machines.doubled(mechanism), q, qd


REDUNDANT = {
    'rockers': (machines.three_rockers, 1), 'wheels': (lambda: locomotive(4), 2),
    'rods': (lambda: locomotive(2, 2), 1), 'welds': (machines.welded_twice, 5),
    'ladder': (lambda: doubled_ladder(2), 4), 'long ladder': (lambda: doubled_ladder(15), 30)}


@pytest.mark.parametrize('name', REDUNDANT)
def test_what_repeats_others_is_left_out_and_nothing_else_changes(name):
    machine, left_out = REDUNDANT[name]
    one = simulate(machine(), **STEPS)
    assert len(one.multipliers) - len(one.data.system.lam) == left_out
    assert_same_evaluation(one, by_all_equations(one))
    one.step(duration=0.05)
    assert_same_evaluation(one, by_all_equations(one))
    assert one.data.system.work.health[RANK_REVEALING_COUNT] == 0
    assert one.closure < 1e-11


def test_a_force_on_a_body_is_felt_in_all_joints():
    mechanism, q, qd = locomotive(3)
    mechanism = replace(mechanism, points=(Point('end', 'rod_0', (0.3, 0.1)),))
    one = simulate((mechanism, q, qd), {'pull': ExternalForce('end', (400.0, -700.0), 30.0)},
                   **STEPS)
    assert one.data.has_redundant_constraints
    assert_same_evaluation(one, by_all_equations(one))


@pytest.mark.parametrize('formulation', FORMULATIONS)
def test_dense_formulations_of_the_equations_that_are_kept_give_the_same(formulation):
    one = simulate(locomotive(2, 2), **STEPS)
    assert one.data.has_redundant_constraints
    assert_agree(one.acceleration, dense_dynamics(one, formulation)[0], 1e-10)


@pytest.mark.parametrize('loops', [1, 5, 20])
def test_singular_positions_leave_nothing_out(loops):
    for tilt in (0.5 * math.pi, 0.5 * math.pi - 1e-9, 0.5 * math.pi - 1e-4):
        mechanism, q, _ = machines.ladder(loops, tilt)
        geometry = Geometry(mechanism)
        geometry.leave_out_repeated(q)
        assert not geometry.has_redundant_constraints


def test_independent_loops_leave_nothing_out():
    for name in ('three_rrr', 'carpet_scraper', 'scissor_lift', 'geared_five_bar'):
        assert not Simulation(load_scene(name)).data.has_redundant_constraints


def swing(wheels, rods, duration):
    """Return the angle of a locomotive's wheels as a function of time, from its one equation."""
    return solve_ivp(
        lambda _, y: (y[1], moment_of(wheels, rods, y[0]) / inertia_of(wheels, rods)),
        (0.0, duration), (START, RATE), 'DOP853', rtol=1e-13, atol=1e-13, dense_output=True).sol


def test_rods_a_quarter_turn_apart_go_round_on_equations_that_take_turns():
    # One rod after the other is in line with the axles; together they never are.
    one, exact = simulate(locomotive(2, 2), **STEPS), swing(2, 2, 1.0)
    start, states = one.energy, []
    for _ in range(20):
        one.step(duration=0.05)
        assert_agree(one.position[:2], exact(one.time)[0] * np.ones(2), 1e-9)
        assert one.closure < 1e-11
        states.append(one.state)
    assert one.position[0] > 2.0 * math.pi and one.data.exchanges > 4
    assert_agree(one.energy, start, 1e-9)
    assert one.report().steps == 1000
    # Seldom, if ever, a matrix is decomposed.
    assert one.data.system.work.health[RANK_REVEALING_COUNT] < 0.01 * one.health.evaluations
    # The same again, whatever the number of steps that are made at once.
    one.reset()
    assert one.data.exchanges == 0
    for state in states:
        for size in (7, 31, 12):
            one.advance(np.zeros(len(one.torque_names)), size)
        assert np.array_equal(one.state, state)


def test_independent_coordinates_go_round_with_them():
    one, exact = simulate(locomotive(2, 2), stabilisation='independent', **STEPS), swing(2, 2, 0.4)
    one.step(duration=0.4)
    assert one.data.exchanges > 0 and one.closure < 1e-11
    assert_agree(one.position[:2], exact(0.4)[0] * np.ones(2), 1e-9)


@pytest.mark.parametrize('integrator', ['auto', 'rk4'])
def test_three_wheels_go_through_positions_where_all_pins_are_in_line(integrator):
    one, exact = simulate(locomotive(3), integrator=integrator, step_size=1e-3), swing(3, 1, 0.8)
    for _ in range(8):
        one.step(duration=0.1)
        assert_agree(one.position[:3], exact(one.time)[0] * np.ones(3), 1e-6)
        assert one.closure < 1e-11
    assert one.position[0] > math.pi and one.data.has_redundant_constraints


def geared_parallelogram(angle):
    """Return a parallelogram whose cranks are geared to each other, at an angle, at rest."""
    mechanism, q, _ = locomotive(2)
    gear = Coupling('gear', {'axle_0': 1.0, 'axle_1': -1.0}, 0.0)
    return replace(mechanism, couplings=(gear,)), angle * np.sign(q), np.zeros(3)


@pytest.mark.parametrize('angle', [0.0, 0.3, 0.5 * math.pi])
def test_a_gear_leads_through_where_the_rod_is_in_line(angle):
    one, other = (simulate(geared_parallelogram(angle), **STEPS) for _ in range(2))
    for simulation in (one, other):
        simulation.step({'axle_0': 60.0}, 0.2)
    assert one.data.has_redundant_constraints and one.position[0] != angle
    assert_agree(one.position, one.position[0] * np.array([1.0, 1.0, -1.0]), 1e-11, smallest=1.0)
    expected = (60.0 + moment_of(2, 1, one.position[0])) / inertia_of(2, 1)
    assert_agree(one.acceleration[0], expected, 1e-9)
    assert one.coupling_forces.shape == (1,) and np.array_equal(one.state, other.state)


def test_runs_side_by_side_are_those_alone():
    one = simulate(locomotive(2, 2), **STEPS)
    torques = np.array([0.0, 200.0, -300.0, 50.0])[:, np.newaxis, np.newaxis]
    found = one.rollout(torques, steps=150, every=50, threads=2)
    assert not found.failures
    for torque, positions in zip(torques[:, 0, 0], found.position):
        one.reset()
        for place in positions[1:]:
            one.step([torque], 0.05)
            assert np.array_equal(one.position, place)


# Of loops that drift all equations are worked on: the motion's is another one of these.
@pytest.mark.parametrize('stabilisation', ['projection', 'none'])
def test_a_prescribed_motion_takes_what_all_wheels_take(stabilisation):
    turn = PrescribedMotion('expression', joint='axle_0', expression='0.7 + 10*t + 2*sin(3*t)')
    one = simulate(locomotive(2, 2), {'turn': turn}, **STEPS)
    assert one.data.has_redundant_constraints
    one.stepping.prepare_method(stabilisation=stabilisation)()
    for _ in range(6):
        one.step(duration=0.05)
        angle, rate = 0.7 + 10.0 * one.time + 2.0 * math.sin(3.0 * one.time), (
            -18.0 * math.sin(3.0 * one.time))
        assert_agree(one.position[1], angle, 1e-9)
        expected = inertia_of(2, 2) * rate - moment_of(2, 2, angle)
        assert_agree(one.motion_forces['turn'], expected, 1e-8)
    assert abs(one.energy_balance.residual) < 1e-7
    assert one.data.exchanges > 0


def guided_parallelogram():
    """
    Return a parallelogram with a slide on a body that does not turn.

    The slide's pin lies in a slot along the coupler: always, while the coupler does not turn. On
    the other branch the slide stays where the coupler's pin is.
    """
    bodies = (*(machines.bar(f'crank_{k}', 1.0, 0.4) for k in range(2)),
              machines.bar('coupler', 1.0, 1.0), Body('table', 1.0, (0.0, 0.1), 0.1),
              Body('slide', 1.0, (0.0, 0.0), 0.1))
    joints = (machines.hinge('one', 'ground', 'crank_0', actuated=True),
              machines.hinge('two', 'ground', 'crank_1', 1.0),
              machines.hinge('three', 'crank_0', 'coupler', 0.4),
              machines.hinge('four', 'crank_0', 'table', 0.4),
              Joint('rail', PRISMATIC, 'table', 'slide', (0.0, 0.0)))
    cuts = (CutJoint('pin', REVOLUTE, 'coupler', 'crank_1', (1.0, 0.0), (0.4, 0.0)),
            CutJoint('slot', POINT_ON_LINE, 'slide', 'coupler', (0.0, 0.0), (0.0, 0.0)))
    upright = Coupling('upright', {'one': 1.0, 'four': 1.0}, 0.0)
    q = np.array([1.0, 1.0, -1.0, -1.0, 0.3])
    return (Mechanism('guided', bodies, joints, cuts, couplings=(upright,)), q,
            np.array([1.0, 1.0, -1.0, -1.0, 0.2]))


def crossed():
    """Return a state of it on the other branch."""
    one = simulate(guided_parallelogram(), stabilisation='none', **STEPS)
    one.set_state((1.0, -1.6, -2.0, -1.0, 0.0))
    assert abs(one.position[1] - one.position[0]) > 1.0 and abs(one.position[-1]) < 1e-12
    one.set_state(one.position, (1.0, -1.0, 0.0, -1.0, 0.0))
    return one


def test_a_state_in_which_nothing_repeats_is_evaluated_with_all_equations():
    one, other = simulate(guided_parallelogram(), **STEPS), crossed()
    assert one.data.has_redundant_constraints
    expected, forces = other.acceleration, other.multipliers
    acceleration, multipliers = one.forward_dynamics(other.position, other.velocity)
    assert_agree(acceleration, expected, 1e-9, smallest=1.0)
    assert_agree(multipliers, forces, 1e-9, smallest=1.0)
    torque, _ = one.inverse_dynamics(other.position, other.velocity, acceleration)
    assert_agree(torque, np.zeros(1), 1e-8, smallest=1.0)
    one.set_state(other.position, other.velocity)
    assert not one.data.has_redundant_constraints
    assert_same_evaluation(one, other)
    one.reset()
    assert one.data.has_redundant_constraints and one.data.exchanges == 0


def test_a_run_goes_on_with_all_equations_where_those_left_out_no_longer_repeat_others():
    one, other = simulate(guided_parallelogram(), **STEPS), crossed()
    # Taken over, not assembled: the equations are those of the first branch.
    one.restore(other.state, 0.0)
    assert one.data.has_redundant_constraints
    one.step(duration=0.1)
    other.step(duration=0.1)
    assert not one.data.has_redundant_constraints and one.data.exchanges == 1
    assert one.closure < 1e-11
    assert_agree(one.time, 0.1, 1e-12)
    assert_agree(one.position, other.position, 1e-8, smallest=1.0)


def test_methods_that_let_loops_drift_leave_nothing_out():
    one = simulate(locomotive(2, 2), **STEPS)
    one.stepping.prepare_method(stabilisation='none')()
    assert not one.data.has_redundant_constraints
    one.step(duration=0.02)
    assert_same_evaluation(one, by_all_equations(one))
    one.stepping.prepare_method(stabilisation='projection')()
    one.reset()
    assert one.data.has_redundant_constraints
    # One that was prepared before equations were exchanged takes effect all the same.
    take_effect = one.stepping.prepare_method(integrator='heun')
    one.step(duration=0.3)
    assert one.data.exchanges > 0
    take_effect()
    one.step(duration=0.05)
    assert one.closure < 1e-11 and one.scene.method.integrator == 'heun'


def test_friction_that_follows_reactions_knows_those_of_all_joints():
    dry = {'dry': JointFriction('axle_1', friction_coefficient=0.2, radius=0.05)}
    one = simulate(locomotive(2, 2), dry, **STEPS)
    assert one.data.has_redundant_constraints
    one.step(duration=0.01)
    other = by_all_equations(one)
    force = np.linalg.norm(other.force('axle_1')[1:])
    assert one.effect_readings('dry')['reaction'] == pytest.approx(force, rel=1e-8)
    assert one.effect_readings('dry')['dissipated_energy'] > 0.0


def test_it_is_reported_which_equations_repeat_others_and_whose_forces_are_shared():
    scene = replace(load_scene('four_bar'), mechanism=machines.doubled(
        load_scene('four_bar').mechanism))
    one = Simulation(scene)
    reported = describe(scene, one)
    assert 'Equations that repeat others: 2\n' in reported
    assert set(one.data.shared_forces) >= {cut.name for cut in one.mechanism.cut_joints}
    assert 'Equations that repeat' not in describe(
        load_scene('four_bar'), Simulation(load_scene('four_bar')))


def with_rods(mechanism, names):
    """Return it with massless rods, of one equation each, in the place of some cut joints."""
    return replace(mechanism, cut_joints=tuple(
        replace(cut, type=DISTANCE, length=0.2) if cut.name in names else cut
        for cut in mechanism.cut_joints))


# As many equations as are left, none of which repeats others.
STANDING_IN = {
    'rockers': lambda one: with_rods(one, ['cut_middle']),
    'wheels': lambda one: with_rods(one, ['pin_0_2', 'pin_0_3']),
    'rods': lambda one: with_rods(one, ['pin_1_1']),
    'ladder': lambda one: replace(one, cut_joints=one.cut_joints[:2])}


@pytest.mark.parametrize('name', STANDING_IN)
def test_repeated_equations_cost_no_more_than_independent_ones(name):
    from closedloop_dynamics.codegen.routines import operations
    mechanism, q, _ = REDUNDANT[name][0]()
    geometry = Geometry(mechanism)
    geometry.leave_out_repeated(q)
    independent = Geometry(STANDING_IN[name](mechanism)).model
    assert len(independent.column) == len(geometry.model.column)
    assert operations(geometry.model) <= 1.5 * operations(independent)
