# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Rollouts side by side in vectors: the numbers of rollouts of one sample, bit for bit."""

from dataclasses import replace
from functools import partial
import math
import tracemalloc

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.codegen import lanes
from closedloop_dynamics.codegen.function_table import ENERGIES
from closedloop_dynamics.codegen.lanes import LANES
from closedloop_dynamics.effects.registry import EFFECTS
from closedloop_dynamics.engine import native
from closedloop_dynamics.engine.status import DONE, SINGULAR
from closedloop_dynamics.simulation.batch import build_batch, find_energies, Lane
from closedloop_dynamics.simulation.rollout_run import QUANTITIES, SimdRuns, STATE
import numpy as np
import pytest


@pytest.fixture
def packs(monkeypatch):
    """Note how many runs went together, None where they came back."""
    seen = []

    record = SimdRuns.record

    def watched(self, starts, room=None):
        records = record(self, starts, room)
        seen.append(None if records is None else len(records))
        return records

    alike = SimdRuns.record_alike

    def watched_alike(self, simulation, states, torques, room, some):
        ended, found = alike(self, simulation, states, torques, room, some)
        # As runs that came back are tried once more, with those that were left out.
        seen.extend(len(row) for row in ended[some] if (row == DONE).any())
        return ended, found

    monkeypatch.setattr(SimdRuns, 'record', watched)
    monkeypatch.setattr(SimdRuns, 'record_alike', watched_alike)
    return seen


def torques_for(simulation, samples, rows, seed=3):
    return np.random.default_rng(seed).normal(
        0.0, 2.0, (samples, rows, len(simulation.actuated_joints)))


def assert_each_as_alone(simulation, result, torques, **arguments):
    """Compare with rollouts of one sample, which nothing can go together with."""
    for sample, rows in enumerate(torques):
        own = {key: values[sample] for key, values in arguments.items()
               if key.startswith('initial')}
        parameters = {key: values[sample]
                      for key, values in arguments.get('parameters', {}).items()}
        alone = simulation.rollout(rows, **own, parameters=parameters, quantities=QUANTITIES)
        for name in QUANTITIES:
            np.testing.assert_array_equal(
                getattr(result, name)[sample], getattr(alone, name)[0], f'{sample}: {name}')


@pytest.mark.parametrize('scene, method', [
    ('three_rrr', {}), ('three_rrr', {'integrator': 'heun', 'stabilisation': 'none'}),
    ('three_rrr', {'integrator': 'semi_implicit_euler', 'stabilisation': 'velocity_projection'}),
    ('carpet_scraper', {}), ('slider_crank', {'stabilisation': 'baumgarte'})])
def test_runs_together_are_those_alone(packs, scene, method):
    simulation = Simulation.from_scene(scene, **{'integrator': 'rk4', **method})
    torques = torques_for(simulation, LANES + 3, 40)
    result = simulation.rollout(torques, quantities=QUANTITIES, threads=1)
    assert packs == [LANES, 3]
    assert_each_as_alone(simulation, result, torques)


def test_a_lane_next_to_a_singular_arm_leaves_the_others_as_they_are(packs):
    simulation = Simulation.from_scene('three_rrr', integrator='rk4')
    # Arms that fall are stretched after 0.17 s, in some lanes before the others.
    torques = torques_for(simulation, LANES + 3, 200)
    result = simulation.rollout(torques, quantities=QUANTITIES, threads=1)
    assert packs == [LANES, 3]
    assert_each_as_alone(simulation, result, torques)


def test_lanes_differ_in_masses_lengths_and_starts(packs):
    simulation = Simulation.from_scene('four_bar', integrator='rk4')
    torques = torques_for(simulation, 5, 60)
    arguments = {
        'parameters': {'mechanism.bodies.crank.mass': np.linspace(0.5, 2.0, 5),
                       'mechanism.joints.coupler_joint.position.0': np.linspace(0.095, 0.105, 5),
                       'effects.gravity.acceleration.1': np.linspace(-9.81, 0.0, 5)}}
    result = simulation.rollout(torques, quantities=QUANTITIES, **arguments)
    assert packs == [5] and result.failures == {}
    assert np.ptp(result.position[:, -1, 0]) > 1e-3
    assert_each_as_alone(simulation, result, torques, **arguments)


def test_what_fails_in_one_lane_is_run_alone(packs):
    simulation = Simulation.from_scene('four_bar', integrator='rk4')
    torques = torques_for(simulation, 4, 30)
    torques[2, 10:] = 1e300
    result = simulation.rollout(torques, quantities=QUANTITIES)
    assert packs == [None]
    assert list(result.failures) == [2] and np.isnan(result.position[2, -1]).all()
    assert_each_as_alone(simulation, result, torques)


def test_what_a_guard_may_end_is_run_alone(packs):
    simulation = Simulation.from_scene('four_bar', integrator='heun', step_size=2e-3)
    torques = torques_for(simulation, 4, 40)
    torques[1] *= 0.2
    torques[2] *= 120.0
    result = simulation.rollout(torques, quantities=QUANTITIES)
    assert packs == [4] and 2 in result.failures
    assert np.isnan(result.position[2, -1]).all() and np.isfinite(result.position[1]).all()
    assert_each_as_alone(simulation, result, torques)


def test_what_fails_to_start_leaves_the_others_together(packs):
    simulation = Simulation.from_scene('four_bar', integrator='rk4')
    result = simulation.rollout(duration=0.01, parameters={
        'mechanism.bodies.crank.mass': [1.0, -1.0, 2.0, 3.0]})
    assert packs == [3]
    assert list(result.failures) == [1] and 'positive' in result.failures[1]
    assert np.isfinite(result.position[[0, 2, 3]]).all()


def test_other_steps_are_not_made_together(packs):
    simulation = Simulation.from_scene('four_bar', integrator='rk4')
    result = simulation.rollout(duration=0.01, parameters={
        'method.step_size': [1e-3, 5e-4, 2.5e-4]})
    assert packs == [None] and result.failures == {}


def test_angles_beyond_the_polynomials_are_not_for_lanes():
    simulation = Simulation.from_scene('four_bar', integrator='rk4', stabilisation='none')
    system = simulation.data.system
    pack = tuple(build_batch([system]))
    for turns, status in ((2e5, DONE), (3e5, SINGULAR)):
        start = np.concatenate((simulation.position, simulation.velocity))
        state = lanes.spread([start] * LANES)
        # Of one lane alone.
        state[LANES - 1] += 2.0 * math.pi * turns
        motion = np.zeros((2, LANES, 2, 3))
        assert native.run_batch(
            pack[:-1], (Lane(system.native, simulation.stepping.run.native),), state,
            np.zeros((1, 3 * LANES)), 1, 1, 1, *motion, np.zeros(1, dtype=np.int64),
            np.zeros((1, 4))) == status


@pytest.fixture
def good():
    """Yield good arguments of ``run_batch`` by name, for 6 steps in two lanes."""
    simulation = Simulation.from_scene('four_bar', integrator='rk4')
    system = simulation.data.system
    start = np.concatenate((simulation.position, simulation.velocity))
    batch = build_batch([system])
    yield {
        'batch': tuple(batch)[:-1],
        'lanes': (Lane(system.native, simulation.stepping.run.native),) * 2,
        'state': lanes.spread([start] * LANES), 'torque': np.zeros((3, 3 * LANES)),
        'zero_order_hold': 2, 'decimation': 3, 'steps': 6,
        'position': np.zeros((LANES, 3, 3)), 'velocity': np.zeros((LANES, 3, 3)),
        'status': np.zeros(2, dtype=np.int64), 'found': np.zeros((2, 4))}


@pytest.mark.parametrize('name', ['state', 'torque', 'position', 'velocity', 'status',
                                  'found'])
def test_every_array_of_a_batch_is_checked(good, name):
    assert native.run_batch(*good.values()) == DONE
    for axis in range(good[name].ndim):
        longer = np.concatenate([good[name]] * 2, axis)
        # More rows of it do no harm.
        for wrong in [np.delete(good[name], 0, axis)] + [longer] * (
                axis > 0 or name != 'torque'):
            with pytest.raises(ValueError, match='do not fit together'):
                native.run_batch(*{**good, name: np.ascontiguousarray(wrong)}.values())


@pytest.mark.parametrize('change', [
    {'zero_order_hold': 0}, {'decimation': 0}, {'steps': -1}, {'steps': 7}, {'decimation': -3},
    {'zero_order_hold': 1}, {'lanes': ()}])
def test_schedules_and_lanes_of_a_batch_are_checked(good, change):
    with pytest.raises(ValueError, match='do not fit together'):
        native.run_batch(*{**good, **change}.values())


@pytest.mark.parametrize('number', range(1, 8))
def test_every_array_within_a_batch_is_checked(good, number):
    for axis in range(good['batch'][number].ndim):
        batch = list(good['batch'])
        batch[number] = np.ascontiguousarray(np.delete(batch[number], 0, axis))
        with pytest.raises(ValueError, match='do not fit together'):
            native.run_batch(*{**good, 'batch': tuple(batch)}.values())


def test_lanes_of_another_mechanism_are_refused(good):
    other = Simulation.from_scene('three_rrr', integrator='rk4')
    lane, _ = good['lanes']
    for wrong in (Lane(other.data.system.native, other.stepping.run.native),
                  Lane(lane.system, other.stepping.run.native)):
        with pytest.raises((RuntimeError, ValueError), match='fit'):
            native.run_batch(*{**good, 'lanes': (lane, wrong)}.values())


def test_memory_of_a_run_does_not_grow_with_its_steps(packs):
    simulation, peaks = Simulation.from_scene('four_bar', integrator='rk4'), []
    for steps in (2000, 2000, 60000):
        tracemalloc.start()
        try:
            simulation.rollout(np.zeros((LANES, 1, 1)), steps=steps, every=steps, threads=1)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert packs == [LANES] * 3
    assert peaks[2] <= peaks[1] + 10000


@pytest.mark.parametrize('scene, method', [
    ('three_rrr', {}), ('three_rrr', {'integrator': 'auto'}), ('stewart_platform', {}),
    ('carpet_scraper_dry', {}), ('slider_crank_end_stop', {'integrator': 'dopri5'})])
def test_starts_that_are_closed_or_not_are_those_of_states_set(scene, method):
    method = {'integrator': 'rk4', **method}
    simulation = Simulation.from_scene(scene, **method)
    positions, velocities = [], []
    for _ in range(4):
        simulation.step(duration=0.02)
        positions.append(simulation.position)
        velocities.append(simulation.velocity)
    # As they are, at rest, and to be assembled.
    velocities[1][:] = 0.0
    velocities[2] = 1.01 * velocities[2] + 1e-3
    simulation.reset()
    torques = torques_for(simulation, 4, 10)
    assert_each_as_alone(
        simulation, simulation.rollout(torques, positions, velocities, quantities=QUANTITIES),
        torques, initial_position=positions, initial_velocity=velocities)
    states = simulation.rollout(torques, positions, velocities, threads=1)
    for sample, rows in enumerate(torques):
        one = Simulation.from_scene(scene, **method)
        one.set_state(positions[sample], velocities[sample])
        for torque in rows:
            one.step(torque)
        np.testing.assert_array_equal(states.position[sample, -1], one.position)
        np.testing.assert_array_equal(states.velocity[sample, -1], one.velocity)


CRANK = {'joint': 'crank_joint'}
WITH_EFFECTS = {
    'springs': {
        'spring': EFFECTS['joint_spring'](**CRANK, stiffness=1.3),
        'damping': EFFECTS['joint_damping'](**CRANK, coefficient=0.02),
        'between': EFFECTS['point_spring'](point_a='coupler_point', anchor=(0.1, 0.3),
                                           stiffness=20.0, damping=1.0, free_length=0.1)},
    'friction': {'friction': EFFECTS['joint_friction'](
        **CRANK, coulomb=0.3, static_ratio=1.4, stribeck_velocity=0.5)},
    'two frictions': {
        'friction': EFFECTS['joint_friction'](**CRANK, coulomb=0.2),
        'other': EFFECTS['joint_friction'](joint='rocker_joint', coulomb=0.1)},
    'contact': {
        'floor': EFFECTS['contact'](point='coupler_point', origin=(0.0, 0.1), stiffness=300.0,
                                    exponent=1.5, damping=0.1, friction=0.2),
        'stop': EFFECTS['end_stop'](**CRANK, stiffness=50.0, lower=-1.0, upper=2.0,
                                    damping=0.1)},
    'law': {
        'law': EFFECTS['law'](
            joints={'x': 'crank_joint'}, rates={'v': 'x'},
            components={'y': ('coupler_point', 'y')}, parameters={'k': 3.0},
            states={'z': '(v - z)/0.1'}, event={'below': 'y - 0.1'},
            forces={'x': '-0.05*z*abs(v) + 0.2*exp(-v*v)*sin(cos(x) + t)',
                    'y': 'k*(0.1 - y)*below'})},
    'all': {'friction': EFFECTS['joint_friction'](**CRANK, coulomb=0.3),
            'spring': EFFECTS['joint_spring'](**CRANK, stiffness=1.3),
            'floor': EFFECTS['contact'](point='coupler_point', origin=(0.0, 0.1),
                                        stiffness=300.0)}}


def with_effects(name, **method):
    scene = load_scene('four_bar')
    return Simulation(replace(scene, effects=WITH_EFFECTS[name], method=replace(
        scene.method, **{'integrator': 'rk4', 'step_size': 1e-3, **method})))


@pytest.mark.parametrize('name', WITH_EFFECTS)
def test_lanes_carry_effects(packs, name):
    simulation = with_effects(name)
    # Joints come to rest and break away, bodies touch and part, in each lane at another time.
    torques = 0.3 * torques_for(simulation, LANES + 3, 12)
    result = simulation.rollout(torques, steps=1200, every=10, threads=1)
    assert packs == [LANES, 3] and result.failures == {}
    for sample, rows in enumerate(torques):
        alone = simulation.rollout(rows, steps=1200, every=10)
        for quantity in STATE:
            np.testing.assert_array_equal(
                getattr(result, quantity)[sample], getattr(alone, quantity)[0])
    resting = (np.abs(result.velocity[:, 1:, 0]) < 1e-9).mean()
    assert resting > 0.01 if 'friction' in WITH_EFFECTS[name] else resting == 0.0


# So coarse that the energy balance misses more than a thousandth of what moves.
@pytest.mark.parametrize('name, step_size', [('springs', 0.02), ('contact', 0.01), ('all', 0.02)])
def test_lanes_find_the_same_errors_of_energy_after_every_step(packs, name, step_size):
    simulation = with_effects(name, step_size=step_size)
    torques = 0.3 * torques_for(simulation, LANES, 40)
    result = simulation.rollout(torques, threads=1)
    assert packs == [LANES] and result.failures
    for sample, rows in enumerate(torques):
        alone = simulation.rollout(rows).failures
        assert alone.get(0) == result.failures.get(sample)


def spatial_with_effects():
    """Return a linkage in space with effects."""
    scene = load_scene('rssr_four_bar')
    return Simulation(replace(scene, effects={
        'gravity': EFFECTS['gravity'](acceleration=(0.3, -1.0, -9.81)),
        'rotor': EFFECTS['rotor'](joint='crank', inertia=0.01, gear_ratio=3.0),
        'ground': EFFECTS['contact'](point='rocker_end', origin=(0.0, 0.0, 0.35),
                                     normal=(0.0, 0.0, 1.0), stiffness=400.0),
        'spring': EFFECTS['point_spring'](point_a='rocker_end', anchor=(0.3, 0.4, 0.1),
                                          stiffness=21.0, damping=1.3, free_length=0.1)},
        method=replace(scene.method, integrator='rk4')))


@pytest.mark.parametrize('build', [
    *(partial(with_effects, name) for name in ('springs', 'all')), spatial_with_effects])
def test_energies_of_lanes_are_those_of_each_state(build):
    simulation, states, expected = build(), [], []
    for _ in range(LANES):
        simulation.step([1.0], 0.1)
        states.append(simulation.data.integrated.copy())
        balance = simulation.energy_balance
        expected.append((balance.kinetic, balance.stored))
    batch = build_batch([simulation.data.system])
    find_energies(batch, simulation.data.system)
    # Behind the rates are the states of effects.
    q, rest = np.split(lanes.spread(states), [LANES * simulation.coordinates.nq])
    assert native.call(batch.table, ENERGIES, q, rest)
    kinetic, stored, _ = batch.energies.reshape(3, LANES)
    np.testing.assert_allclose(np.transpose((kinetic, stored)), expected, rtol=1e-12, atol=1e-14)
    assert np.ptp(stored) > 0.01 * np.abs(stored).max()


def test_lanes_differ_in_numbers_of_effects(packs):
    simulation = with_effects('contact')
    parameters = {'effects.floor.stiffness': np.linspace(100.0, 900.0, 4),
                  'effects.stop.upper': np.linspace(1.0, 2.5, 4)}
    torques = torques_for(simulation, 4, 100)
    result = simulation.rollout(torques, parameters=parameters, quantities=QUANTITIES)
    assert packs == [4] and result.failures == {}
    assert np.ptp(result.position[:, -1, 0]) > 1e-3
    assert_each_as_alone(simulation, result, torques, parameters=parameters)


def test_what_states_of_effects_decide_is_not_asked_of_lanes(packs):
    simulation = with_effects('friction')
    torques = torques_for(simulation, 4, 20)
    result = simulation.rollout(torques, quantities=QUANTITIES)
    assert packs == [None]
    assert_each_as_alone(simulation, result, torques)


def test_lanes_in_space_carry_effects(packs):
    scene = load_scene('rssr_four_bar')
    simulation = Simulation(replace(scene, effects={
        'friction': EFFECTS['joint_friction'](joint='crank', coulomb=0.05),
        'spring': EFFECTS['point_spring'](point_a='rocker_end', anchor=(0.3, 0.4, 0.1),
                                          stiffness=21.0, damping=1.3, free_length=0.1)},
        method=replace(scene.method, integrator='rk4')))
    torques = torques_for(simulation, 4, 60)
    result = simulation.rollout(torques)
    assert packs == [4] and result.failures == {}
    for sample, rows in enumerate(torques):
        alone = simulation.rollout(rows)
        for quantity in STATE:
            np.testing.assert_array_equal(
                getattr(result, quantity)[sample], getattr(alone, quantity)[0])
