# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``Simulation.rollout``: the same numbers as simulations run one by one."""

from dataclasses import replace
import inspect

from closedloop_dynamics import (
    Body, Joint, load_scene, Mechanism, Point, Simulation, SimulationError)
from closedloop_dynamics.simulation import rollout_run
from closedloop_dynamics.simulation.rollout import rollout
from closedloop_dynamics.simulation.rollout_run import fits_simd, is_plain, QUANTITIES, TimeGrid
import numpy as np
import pytest

from ..reference import spatial_machines
from ..reference.scenes import scene_in_space as scene_of


def linkage(**method):
    """Return the scene of an RSSR four-bar with a driven crank and a ball in its tree."""
    mechanism, _ = spatial_machines.rssr_four_bar()
    return scene_of(
        replace(mechanism, points=(Point('middle', 'rod', (0.1, 0.1, 0.1)),)), **method)


def flyer(**method):
    """Return the scene of a free body with a driven ball."""
    body = Body('hull', 1.0, (0.1, 0.0, 0.05), (0.02, 0.03, 0.04))
    mechanism = Mechanism('flyer', (body, replace(body, name='arm')), (
        Joint('hull', 'free', 'ground', 'hull', (0.0, 0.0, 0.0)),
        Joint('ball', 'spherical', 'hull', 'arm', (0.2, 0.0, 0.0), actuated=True)))
    return scene_of(mechanism, velocity={'hull': {'angular_velocity': (1.0, 2.0, 3.0)}}, **method)


def one_by_one(scene, torques, steps, every, start=None, step_size=None):
    """Return what single simulations do, advanced by ``step``, by quantity."""
    results = {name: [] for name in QUANTITIES}
    for sample, rows in enumerate(torques):
        simulation = Simulation(scene if not callable(scene) else scene(sample))
        if start is not None:
            simulation.set_state(*(values[sample] for values in start))
        hold = steps // len(rows)
        simulation.step(rows[0], 0.0)
        kept = {name: [getattr(simulation, name)] for name in QUANTITIES}
        for step in range(1, steps + 1):
            simulation.step(rows[(step - 1) // hold])
            if step % every == 0:
                for name in QUANTITIES:
                    kept[name].append(getattr(simulation, name))
        for name in QUANTITIES:
            results[name].append(kept[name])
    return {name: np.array(values) for name, values in results.items()}


def torques_for(scene, samples, rows, size=2.0, seed=1):
    count = len(scene.mechanism.actuated_joints)
    return np.random.default_rng(seed).normal(0.0, size, (samples, rows, count))


def assert_same(result, expected):
    for name in QUANTITIES:
        np.testing.assert_array_equal(getattr(result, name), expected[name], name)


@pytest.fixture
def stepped(monkeypatch):
    """Note the runs that are made step by step."""
    seen = []
    original = rollout_run.run_stepwise
    monkeypatch.setattr(
        rollout_run, 'run_stepwise', lambda *given: seen.append(given[0]) or original(*given))
    return seen


# Plain fixed steps, a prismatic cut joint; a watched scene; a drive with lag.
@pytest.mark.parametrize('name', [
    'three_rrr', 'carpet_scraper', 'slider_crank', 'four_bar', 'three_rrr_payload_friction',
    pytest.param('carpet_scraper_dry', marks=pytest.mark.slow)])
def test_results_are_those_of_single_simulations(name):
    scene = load_scene(name)
    torques = torques_for(scene, 3, 12)
    result = Simulation(scene).rollout(torques, steps=24, every=3, quantities=QUANTITIES)
    assert result.failures == {}
    assert_same(result, one_by_one(scene, torques, 24, 3))
    np.testing.assert_array_equal(result.time, scene.method.step_size * np.arange(0, 25, 3))


@pytest.mark.parametrize('build, method', [
    (linkage, {'integrator': 'rk4'}),
    (linkage, {'integrator': 'semi_implicit_euler', 'stabilisation': 'velocity_projection',
               'step_size': 1e-6}),
    (flyer, {'integrator': 'rk4'}), (linkage, {})],
    ids=['linkage', 'linkage-euler', 'flyer', 'linkage-auto'])
def test_results_in_space_are_those_of_single_simulations(build, method):
    made = build(**method)
    simulation = Simulation(made)
    # Side by side in a vector, and one that is left over.
    assert fits_simd(simulation, TimeGrid(simulation.step_size, 12, 6, 3)) == bool(method)
    torques = torques_for(made, 9, 2, 0.02)
    result = simulation.rollout(torques, steps=12, every=3, quantities=QUANTITIES, threads=1)
    assert result.failures == {} and result.position.shape[-1] == simulation.coordinates.nq
    assert_same(result, one_by_one(made, torques, 12, 3))


SLOW_TO_COMPILE = [{'stabilisation': 'independent'},
                   {'integrator': 'dopri5'}, {'integrator': 'rodas4'}]


@pytest.mark.parametrize('method', [
    {'integrator': 'semi_implicit_euler'}, {'integrator': 'heun', 'stabilisation': 'none'},
    {'stabilisation': 'baumgarte'},
    *(pytest.param(method, marks=pytest.mark.slow) for method in SLOW_TO_COMPILE),
], ids=lambda method: '-'.join(method.values()))
def test_every_method_gives_what_single_simulations_give(method):
    scene = load_scene('four_bar')
    scene = replace(scene, method=replace(scene.method, **method))
    torques = torques_for(scene, 4, 10)
    result = Simulation(scene).rollout(torques, quantities=QUANTITIES, threads=2)
    assert_same(result, one_by_one(scene, torques, 10, 1))


# Springs and stops; contacts; dry friction; a prescribed motion; redundant equations of which
# some are left out; quaternions.
@pytest.mark.parametrize('name, method', [
    ('bistable_toggle', {}), ('bistable_toggle', {'integrator': 'rodas4_fixed'}),
    ('bistable_toggle', {'stabilisation': 'baumgarte'}),
    ('slider_crank_end_stop', {'integrator': 'dopri5'}), ('cam_follower', {}),
    ('carpet_scraper_dry', {}), ('carpet_scraper_dry', {'integrator': 'rk4'}),
    ('carpet_scraper_on_carpet', {}), ('geneva_drive', {}), ('differential', {}), ('bricard', {}),
    ('bricard', {'integrator': 'heun'}), ('stewart_platform', {'stabilisation': 'independent'})],
    ids=lambda value: value if isinstance(value, str) else '-'.join(value.values()))
def test_runs_made_as_a_whole_are_those_made_step_by_step(stepped, name, method):
    scene = load_scene(name)
    scene = replace(scene, method=replace(scene.method, **method))
    torques = torques_for(scene, 2, 4)
    simulation = Simulation(scene)
    # Again, with what the first time has left behind.
    for _ in range(2):
        result = simulation.rollout(
            torques, steps=20, every=2, quantities=QUANTITIES, threads=1)
    assert not stepped and result.failures == {}
    assert_same(result, one_by_one(scene, torques, 20, 2))


def test_rodas4_gives_what_single_steps_give(stepped):
    scene = load_scene('slider_crank_end_stop')
    scene = replace(scene, method=replace(scene.method, integrator='rodas4'))
    torques = torques_for(scene, 2, 10)
    result = Simulation(scene).rollout(torques, quantities=QUANTITIES, threads=1)
    assert not stepped
    assert_same(result, one_by_one(scene, torques, 10, 1))


@pytest.mark.parametrize('name, method', [
    # Error of the energy balance; of the closure; closed equations that drift.
    ('bistable_toggle', {'integrator': 'rk4'}), ('bistable_toggle', {'integrator': 'heun'}),
    ('slider_crank_end_stop', {'integrator': 'rk4', 'stabilisation': 'none',
                               'step_size': 0.005}),
    ('bistable_toggle', {'integrator': 'rk4', 'stabilisation': 'independent'})],
    ids=lambda value: value if isinstance(value, str) else None)
def test_what_a_guard_ends_is_ended(stepped, name, method):
    scene = load_scene(name)
    scene = replace(scene, method=replace(scene.method, **method))
    torques = torques_for(scene, 3, 24, 1.0, 5)
    torques[1] *= 20.0
    torques[2, 12:] *= 1e3
    simulation = Simulation(scene)
    result = simulation.rollout(torques, steps=24, threads=1)
    assert result.failures and stepped
    for sample, rows in enumerate(torques):
        simulation.reset()
        reason = None
        try:
            for row in rows:
                simulation.step(row)
            simulation.judge()
            reason = simulation.stepping.energy_guard.finding or None
        except SimulationError as error:
            reason = str(error)
        assert result.failures.get(sample) == reason


def test_simulations_are_kept_until_something_changes(monkeypatch):
    simulation = Simulation.from_scene('slider_crank_end_stop')
    first = simulation.rollout(duration=0.05).position
    built = []
    original = Simulation.__init__
    monkeypatch.setattr(Simulation, '__init__', lambda self, scene: built.append(scene) or
                        original(self, scene))
    np.testing.assert_array_equal(simulation.rollout(duration=0.05).position, first)
    assert not built
    simulation.set_effect('gravity', acceleration=(0.0, -1.62))
    second = simulation.rollout(duration=0.05).position
    simulation.stepping.prepare_method(step_size=5e-4)()
    assert simulation.rollout(duration=0.05).position.shape[1] == 101
    assert [scene.method.step_size for scene in built] == [1e-3, 5e-4]
    assert not np.array_equal(second, first)


def test_the_number_of_threads_changes_nothing():
    simulation = Simulation.from_scene('three_rrr')
    torques = torques_for(simulation.scene, 16, 50)
    results = [simulation.rollout(torques, threads=threads, quantities=QUANTITIES)
               for threads in (1, 2, 5)]
    for result in results[1:]:
        assert_same(result, {name: getattr(results[0], name) for name in QUANTITIES})


@pytest.mark.parametrize('build, size', [(lambda: load_scene('three_rrr'), 2.0),
                                         (lambda: linkage(integrator='rk4'), 0.02)],
                         ids=['three_rrr', 'linkage'])
def test_samples_start_at_states_of_their_own(build, size):
    scene = build()
    names, rng = scene.mechanism.coordinates, np.random.default_rng(2)
    position = np.array([names.moved(np.array(scene.initial.position), change)
                         for change in rng.uniform(-0.02, 0.02, (3, names.nv))])
    velocity = 0.5 * size * rng.normal(size=(3, names.nv))
    torques = torques_for(scene, 3, 5, size)
    result = Simulation(scene).rollout(torques, position, velocity, quantities=QUANTITIES)
    assert_same(result, one_by_one(scene, torques, 5, 1, (position, velocity)))
    assert result.closure.max() < 1e-11
    if names.nq > names.nv:
        position[1, -4:] *= 2.0
        failed = Simulation(scene).rollout(torques, position, velocity)
        assert list(failed.failures) == [1] and 'a unit quaternion' in failed.failures[1]
        np.testing.assert_array_equal(failed.position[[0, 2]], result.position[[0, 2]])


@pytest.mark.parametrize('method', [{}, {'integrator': 'rk4'}, {'integrator': 'rodas4'}],
                         ids=lambda method: method.get('integrator', 'auto'))
def test_samples_start_at_a_state_they_share(stepped, method):
    scene = load_scene('carpet_scraper_dry')
    scene = replace(scene, method=replace(scene.method, **method))
    moving = Simulation(scene)
    moving.step(duration=0.05)
    start, torques = (moving.position, moving.velocity), torques_for(scene, 4, 6)
    result = moving.rollout(torques, *start, quantities=QUANTITIES, threads=1)
    assert not stepped and result.failures == {}
    assert_same(result, one_by_one(scene, torques, 6, 1, [[state] * 4 for state in start]))


def test_velocities_alone_start_from_the_position_of_the_scene():
    scene = load_scene('three_rrr')
    velocity = np.zeros((2, 7))
    velocity[:, 0] = 1.0, 2.0
    result = Simulation(scene).rollout(initial_velocity=velocity, steps=2)
    np.testing.assert_array_equal(result.velocity[:, 0, 0], (1.0, 2.0))
    np.testing.assert_array_equal(result.position[:, 0, 0], scene.initial.position[0])


@pytest.mark.parametrize('build, changed, size', [
    (lambda: load_scene('three_rrr'), 'platform', 2.0),
    (lambda: linkage(integrator='rk4'), 'rod', 0.02)], ids=['three_rrr', 'linkage'])
def test_parameters_are_those_of_changed_scenes(build, changed, size):
    scene, gravity = build(), -1.62
    body = next(body for body in scene.mechanism.bodies if body.name == changed)
    masses = body.mass * np.array([0.4, 1.0, 2.2])

    def of_sample(sample):
        bodies = tuple(replace(body, mass=masses[sample]) if each is body else each
                       for each in scene.mechanism.bodies)
        acceleration = (0.0, gravity, *scene.effects['gravity'].acceleration[2:])
        return replace(
            scene, mechanism=replace(scene.mechanism, bodies=bodies),
            effects={'gravity': replace(scene.effects['gravity'], acceleration=acceleration)})

    torques = torques_for(scene, 3, 20, size)
    result = Simulation(scene).rollout(torques, quantities=QUANTITIES, parameters={
        f'mechanism.bodies.{changed}.mass': masses, 'effects.gravity.acceleration.1': gravity})
    assert_same(result, one_by_one(of_sample, torques, 20, 1))
    assert np.ptp(result.position[:, -1, 0]) > 1e-9


def test_present_effects_count_and_nothing_of_the_simulation_changes():
    scene = load_scene('three_rrr_payload_friction')
    simulation = Simulation(scene)
    simulation.set_effect('part', mass=1.0)
    simulation.set_effect('gear_1', enabled=False)
    simulation.step({'theta_1': 1.0}, 0.01)
    before = simulation.position, simulation.velocity, simulation.time
    result = simulation.rollout(duration=0.02)
    np.testing.assert_array_equal(simulation.position, before[0])
    np.testing.assert_array_equal(simulation.velocity, before[1])
    assert simulation.time == before[2]
    simulation.reset()
    simulation.step(duration=0.02)
    np.testing.assert_array_equal(result.position[0, -1], simulation.position)
    assert not np.array_equal(result.position, Simulation(scene).rollout(duration=0.02).position)


def test_a_sample_that_fails_is_reported_and_harms_no_other():
    scene = load_scene('four_bar')
    torques = torques_for(scene, 4, 40)
    torques[1, 20:] = 3e6
    result = Simulation(scene).rollout(torques, parameters={
        'mechanism.bodies.crank.mass': [1.0, 1.0, -1.0, 1.0],
        'mechanism.joints.crank_joint.position.0': [0.0, 0.0, 0.0, 50.0]})
    assert set(result.failures) == {1, 2, 3}
    assert 'smaller torques' in result.failures[1]
    assert 'mass' in result.failures[2] and 'cannot be assembled' in result.failures[3]
    assert np.isfinite(result.position[0]).all()
    assert np.isfinite(result.position[1, :21]).all() and np.isnan(result.position[1, -1]).all()
    assert np.isnan(result.position[2:]).all()
    alone = Simulation(scene).rollout(torques[0], parameters={'mechanism.bodies.crank.mass': 1.0})
    np.testing.assert_array_equal(result.position[0], alone.position[0])


def test_only_what_is_asked_for_is_returned():
    result = Simulation.from_scene('four_bar').rollout([1.0], steps=6, every=6,
                                                       quantities=['closure'])
    assert result.closure.shape == (1, 2)
    assert result.position is None and result.constraint_forces is None


@pytest.mark.parametrize('arguments, words', [
    ({}, ['steps', 'duration']),
    ({'steps': 3, 'duration': 1.0}, ['steps', 'both']),
    ({'duration': 0.00105}, ['duration', 'multiple', '0.001']),
    ({'steps': 0}, ['steps', '> 0']),
    ({'steps': 10, 'every': 3}, ['every (3)', '10']),
    ({'torques': np.zeros((2, 4, 3))}, ['torques', '(samples, rows, 1)', '(2, 4, 3)']),
    ({'torques': [[float('nan')]]}, ['torques', 'finite']),
    ({'torques': np.zeros((2, 4, 1)), 'steps': 9}, ['rows of torques (4)', '9']),
    ({'torques': np.zeros((2, 4, 1)), 'initial_position': np.zeros((5, 3))},
     ['2 in torques', '5 in initial_position']),
    ({'steps': 1, 'quantities': ['positon']}, ['positon', "did you mean 'position'?"]),
    ({'steps': 1, 'parameters': {'mechanism.bodies.crank.mas': [1.0]}},
     ['mechanism.bodies.crank.mas', "did you mean 'mass'?"]),
    ({'steps': 1, 'threads': 0}, ['threads', '> 0']),
])
def test_arguments_that_make_no_sense_are_refused(arguments, words):
    with pytest.raises(ValueError) as error:
        Simulation.from_scene('four_bar').rollout(**arguments)
    for word in words:
        assert word in str(error.value)


def test_the_compiled_loop_is_what_runs_plain_scenes():
    assert is_plain(Simulation.from_scene('three_rrr', integrator='rk4'))
    assert not is_plain(Simulation.from_scene('three_rrr'))
    assert not is_plain(Simulation.from_scene('bricard', integrator='rk4'))


def test_the_method_takes_what_the_function_takes():
    of_method = inspect.signature(Simulation.rollout).parameters
    of_function = inspect.signature(rollout).parameters
    assert list(of_method)[1:] == list(of_function)[1:]
    for name in list(of_method)[1:]:
        assert of_method[name].default == of_function[name].default
