# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Models, states and evaluations: against runs, against the laws of motion, and misused."""

from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import FrozenInstanceError, replace
import math
import pickle
import warnings

import closedloop_dynamics as cld
from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.mechanism.config import shipped_names
from closedloop_dynamics.simulation.model import begins
import numpy as np
import pytest

from ..reference import cases

READINGS = ('acceleration', 'multipliers', 'effort', 'joint_forces', 'constraint_forces',
            'coupling_forces', 'points', 'body_poses', 'energy', 'closure')


def model_of(name):
    return cld.Model.from_scene(name)


def close(found, expected, share=1e-10):
    """Assert that numbers agree to a share of the largest, NaN where NaN is."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert found.shape == expected.shape
    assert np.array_equal(np.isnan(found), np.isnan(expected))
    scale = max(1.0, np.abs(np.nan_to_num(expected)).max(initial=0.0))
    assert np.nan_to_num(np.abs(found - expected)).max(initial=0.0) <= share * scale


@pytest.mark.parametrize('name', cases.only(cases.CLASSES, shipped_names('scenes')))
def test_an_evaluation_tells_what_a_run_tells(name):
    simulation = cld.Simulation.from_scene(name)
    torque = np.linspace(0.1, 0.3, len(simulation.actuated_joints))
    simulation.step(torque, 0.02)
    model = cld.Model(simulation.scene)
    state, acting = simulation.snapshot(), simulation.data.system.tau[simulation.data.actuated]
    for now in (model.evaluate(state, acting), simulation.evaluation()):
        for quantity in READINGS:
            close(getattr(now, quantity), getattr(simulation, quantity))
        for joint in now.joint_forces:
            close(now.joint_forces[joint], simulation.force(joint))
        for point in now.points:
            close(now.points[point], simulation.point(point))
        close(list(now.motion_forces.values()), list(simulation.motion_forces.values()))
        assert now.energy == pytest.approx(now.kinetic_energy + now.stored_energy)
    close(model.inertia(state), simulation.inertia)
    close(model.constraint_jacobian(state), simulation.constraint_jacobian)


def test_forces_in_joints_have_names_everywhere():
    start = RRR.assemble()
    run = cld.Simulation(RRR, start, 'rk4')
    many = run.rollout(np.full((2, 1, 3), 0.5), steps=3, quantities=('joint_forces',))
    run.step(0.5 * np.ones(3), 3 * run.step_size)
    alone = run.joint_forces
    assert alone.names == many.joint_forces.names == RRR.evaluate(start).joint_forces.names
    assert many.joint_forces.shape == (2, 4, 7, 3)
    for place, name in enumerate(alone.names):
        assert np.array_equal(alone[name], run.force(name))
        assert np.array_equal(alone[place], alone[name])
        assert np.array_equal(many.joint_forces[name], many.joint_forces[..., place, :])
    # Arithmetic is that of arrays, on either side.
    assert np.array_equal(2.0 * alone - alone, alone.array)
    assert np.array_equal(np.abs(alone), np.abs(alone.array))
    with pytest.raises(KeyError, match='joint_forces: expected one of theta_1.*did you mean'):
        many.joint_forces['theta_8']


def test_scenes_are_shown_in_a_line_and_distinguished_by_their_contents():
    scene = RRR.scene
    assert repr(scene).startswith('<Scene three_rrr of three_rrr: ')
    assert repr(RRR.mechanism) == ('<Mechanism three_rrr: 7 bodies, 7 joints, 2 cut joints, '
                                   'actuated: theta_1, theta_6, theta_7>')
    heavier = RRR.with_parameters({'mechanism.bodies.proximal_1.mass': 2.0}).scene
    assert scene.digest() == replace(scene, path=None).digest() != heavier.digest()


@pytest.mark.parametrize('name', ['three_rrr', 'four_bar', 'stewart_platform', 'bricard'])
def test_the_power_of_torques_is_the_change_of_energy(name):
    simulation = cld.Simulation.from_scene(name)
    torque = np.linspace(1.0, 3.0, len(simulation.actuated_joints))
    simulation.step(torque, 0.05)
    model, state = cld.Model(simulation.scene), simulation.snapshot()
    now, h = model.evaluate(state, torque), 1e-5
    energies = [model.evaluate(model.state(
        model.coordinates.moved(state.q, sign * h * state.qd + 0.5 * h * h * now.acceleration),
        state.qd + sign * h * now.acceleration)).energy for sign in (1.0, -1.0)]
    found = (energies[0] - energies[1]) / (2.0 * h)
    assert found == pytest.approx(now.torque[:len(state.qd)] @ state.qd, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize('name', ['three_rrr', 'stewart_platform', 'bennett'])
def test_inverse_dynamics_finds_the_torques(name):
    model = model_of(name)
    state = model.assemble()
    torque = np.linspace(1.0, 3.0, len(model.actuated_joints))
    now = model.evaluate(state, torque)
    needed = model.inverse(state, now.acceleration)
    close(needed.torque, torque, 1e-8)
    # Where equations repeat others, there are many multipliers of one constraint force.
    jac, found = model.constraint_jacobian(state), model.evaluate(state, needed.torque)
    close(jac.T @ found.multipliers, jac.T @ needed.multipliers, 1e-8)


def test_nothing_moves_without_forces():
    scene = cld.load_scene('three_rrr')
    model = cld.Model(scene).with_parameters({'effects.gravity.acceleration.1': 0.0})
    now = model.evaluate(model.assemble())
    assert np.abs(now.acceleration).max() < 1e-12 and np.abs(now.joint_forces).max() < 1e-12
    # The scene's own model is another one.
    assert np.abs(cld.Model(scene).evaluate(model.assemble()).acceleration).max() > 1.0


PENDULUM = {
    'name': 'pendulum',
    'bodies': {'rod': {'mass': 2.0, 'center_of_mass': (0.5, 0.0), 'inertia': 0.3}},
    'joints': {'pivot': {'type': 'revolute', 'parent': 'ground', 'child': 'rod',
                         'position': np.zeros(2), 'actuated': True}},
    'points': {'tip': {'body': 'rod', 'position': (1.0, 0.0)}}}


def pendulums():
    """Return one pendulum, built of records and of mappings."""
    mechanism = cld.Mechanism(
        'pendulum', bodies=(cld.Body('rod', 2.0, (0.5, 0.0), 0.3),),
        joints=(cld.Joint('pivot', 'revolute', 'ground', 'rod', (0.0, 0.0), actuated=True),),
        points=(cld.Point('tip', 'rod', (1.0, 0.0)),))
    effects = {'gravity': {'type': 'gravity', 'acceleration': [0.0, -9.81]}}
    start = {'position': {'pivot': 0.3}}
    return (
        cld.Scene('swing', None, '', mechanism, cld.Initial((0.3,), (0.0,)),
                  {'gravity': Gravity((0.0, -9.81))}),
        cld.load_scene({'mechanism': PENDULUM, 'initial': start, 'effects': effects}),
        cld.load_scene({'mechanism': cld.read_mechanism(PENDULUM), 'initial': start,
                        'effects': effects}))


def test_a_pendulum_built_in_python_obeys_its_law():
    for scene in pendulums():
        model = cld.Model(scene)
        state = model.assemble({'pivot': np.linspace(-1.0, 1.0, 5)})
        now = model.evaluate(state, {'pivot': 0.7})
        angle = state.position['pivot']
        close(now.acceleration[:, 0],
              (0.7 - 2.0 * 9.81 * 0.5 * np.cos(angle)) / (0.3 + 2.0 * 0.5 ** 2), 1e-14)
        close(now.points['tip'], np.stack([np.cos(angle), np.sin(angle)], axis=1), 1e-15)


def test_scenes_built_in_python_go_to_a_file_and_back(tmp_path):
    first, *others = pendulums()
    cld.write_scene(first, tmp_path / 'swing.yaml')
    for other in (*others, cld.load_scene(tmp_path / 'swing.yaml')):
        for key in ('mechanism', 'initial', 'effects', 'method'):
            assert getattr(other, key) == getattr(first, key)


def test_a_mechanism_in_the_scene_is_refused_with_its_line(tmp_path):
    path = tmp_path / 'scene.yaml'
    cld.write_scene(pendulums()[0], path)
    path.write_text(path.read_text().replace('"mass": 2.0', '"mass": -2.0'))
    line = next(n for n, text in enumerate(path.read_text().splitlines(), 1) if '-2.0' in text)
    with pytest.raises(cld.SceneError, match=rf'scene.yaml:{line}: mechanism.bodies.rod.mass'):
        cld.load_scene(path)
    broken = {**PENDULUM, 'bodies': {'rod': {**PENDULUM['bodies']['rod'], 'weight': 1.0}}}
    with pytest.raises(cld.SceneError, match='mechanism.bodies.rod.*weight'):
        cld.load_scene({'mechanism': broken, 'initial': {'position': {}}})
    with pytest.raises(cld.MechanismError, match='bodies.rod.*weight'):
        cld.read_mechanism(broken)


@pytest.mark.parametrize('name', [
    'three_rrr', 'stewart_platform', 'bennett', 'carpet_scraper_on_carpet'])
def test_a_batch_is_its_states_one_by_one(name):
    simulation = cld.Simulation.from_scene(name)
    model, states = cld.Model(simulation.scene), []
    for _ in range(4):
        simulation.step(duration=0.01)
        states.append(simulation.snapshot())
    batch = cld.State.stack(states)
    torques = np.random.default_rng(1).normal(size=(4, len(model.actuated_joints)))
    together = model.evaluate(batch, torques)
    assert len(batch) == 4 and together.acceleration.shape == batch.qd.shape
    for k, (state, torque) in enumerate(zip(batch, torques)):
        assert state.time == states[k].time and np.array_equal(state.q, states[k].q)
        one = model.evaluate(state, torque)
        for quantity in READINGS:
            assert np.array_equal(
                np.asarray(getattr(together, quantity))[k], getattr(one, quantity), True)
    needed = model.inverse(batch, together.acceleration) if name == 'three_rrr' else None
    if needed is not None:
        close(needed.torque, torques, 1e-8)
    # One row of torques is for all of them.
    same = model.evaluate(batch, torques[0])
    assert np.array_equal(same.acceleration[3], model.evaluate(batch[3], torques[0]).acceleration)
    assert batch[1:3].q.shape == (2, model.coordinates.nq)


def reported_by(function, *arguments, **options):
    """Return what a function returns, and its warnings, those that are counted, too."""
    with warnings.catch_warnings(record=True) as reported:
        warnings.simplefilter('always')
        found = function(*arguments, **options)
    words = [str(one.message) for one in reported]
    if words and words[-1].endswith('more notes on these states'):
        words[-1:] = int(words[-1].split()[1]) * ['and more']
    return found, words


@pytest.mark.parametrize('name', cases.first(4, [
    'four_bar', 'stewart_platform', 'three_rrr', 'slider_crank_end_stop', 'bennett',
    'carpet_scraper', 'rope_hoist', 'humanoid_ankle', 'geared_five_bar']))
@pytest.mark.parametrize('held', [True, False])
def test_a_batch_is_assembled_as_its_states_one_by_one(name, held):
    model, rng = cld.Model.from_scene(name), np.random.default_rng(7)
    start, names = model.assemble(), model.coordinates
    q = names.moved(np.tile(start.q, (24, 1)), 0.02 * rng.uniform(-1.0, 1.0, (24, names.nv)))
    qd = np.where(rng.uniform(size=(24, 1)) < 0.5, 0.0, rng.normal(size=(24, names.nv)))
    hold = model.scene.initial.hold if held else ()
    each, notes = [], []
    for k in range(len(q)):
        state, reported = reported_by(model.assemble, q[k], qd[k], hold, time=0.1)
        each.append(state)
        notes += [f'state {k}: {note}' for note in reported]
    batch, reported = reported_by(model.assemble, q, qd, hold, time=0.1)
    one_by_one = cld.State.stack(each)
    for key in ('time', 'q', 'qd', 'own'):
        np.testing.assert_allclose(
            getattr(batch, key), getattr(one_by_one, key), rtol=0.0, atol=1e-12)
    assert reported[:3] == notes[:3] and len(reported) == len(notes)


def test_notes_of_a_batch_are_those_of_its_states():
    model, notes = cld.Model.from_scene('four_bar'), []
    # Degrees; the other branch; far away; nothing.
    cranks, rockers = (0.3, 90.0, 0.3, 3.0, 1.2), (1.5, 1.5, -1.5, 1.5, 1.5)
    for k, (crank, rocker) in enumerate(zip(cranks, rockers)):
        _, reported = reported_by(model.assemble, {'crank_joint': crank, 'rocker_joint': rocker},
                                  hold=['crank_joint'])
        notes += [f'state {k}: {note}' for note in reported]
    _, reported = reported_by(model.assemble, {'crank_joint': cranks, 'rocker_joint': rockers},
                              hold=['crank_joint'])
    assert reported[:3] == notes[:3] and len(reported) == len(notes) > 3


def test_states_of_a_batch_that_cannot_be_closed_are_named():
    model = cld.Model.from_scene('four_bar')
    with pytest.raises(cld.AssemblyError, match='^state 2: .*cannot be assembled') as error:
        model.assemble({'rocker_joint': [1.727, 1.75, 0.2, 0.1]}, hold=['rocker_joint'])
    with pytest.raises(cld.AssemblyError) as single:
        model.assemble({'rocker_joint': 0.2}, hold=['rocker_joint'])
    assert str(error.value) == f'state 2: {single.value}'
    with pytest.raises(ValueError, match='^state 1.position.crank_joint: expected a f'):
        model.assemble({'crank_joint': [0.3, np.nan]}, hold=['crank_joint'])
    q = model.assemble({'crank_joint': [0.3, 0.4, 0.5]}, hold=['crank_joint']).q.copy()
    assert len(model.state(q)) == 3
    q[1, 2] += 1e-3
    with pytest.raises(cld.AssemblyError, match='^state 1: .*leaves cut_joints'):
        model.state(q)


def test_what_is_assembled_closes_the_loops_and_keeps_what_is_held():
    model, hold = model_of('three_rrr'), ['theta_1', 'theta_6', 'theta_7']
    start = model.assemble()
    wanted = {name: start.position[name] + 0.05 for name in hold}
    state = model.assemble(wanted, {'theta_1': 0.4}, hold)
    assert all(state.position[name] == value for name, value in wanted.items())
    assert state.velocity['theta_1'] == 0.4 and state.velocity['theta_6'] == 0.0
    now = model.evaluate(state)
    assert now.closure < 1e-13
    assert np.abs(model.constraint_jacobian(state) @ state.qd).max() < 1e-13
    simulation = cld.Simulation(model)
    simulation.set_state(wanted, {'theta_1': 0.4}, hold)
    assert np.array_equal(simulation.position, state.q)
    assert np.array_equal(simulation.velocity, state.qd)
    many = model.assemble({**wanted, 'theta_1': np.linspace(1.0, 1.1, 3)}, None, hold)
    assert np.array_equal(many.position['theta_1'], np.linspace(1.0, 1.1, 3))


def test_what_may_not_be_meant_is_reported_and_what_cannot_be_is_refused():
    model = model_of('three_rrr')
    with pytest.warns(RuntimeWarning, match='closed far from the position given'):
        model.assemble({'theta_1': 0.3})
    with pytest.raises(cld.AssemblyError, match='^Holding theta_1 .* degrees of freedom stay'):
        model.assemble({'theta_1': 0.3}, hold=['theta_1'])
    # The rocker of a crank-rocker does not turn round.
    with pytest.raises(cld.AssemblyError, match='^state 1: '):
        model_of('four_bar').assemble({'rocker_joint': [1.727, 0.0]}, hold=['rocker_joint'])
    with pytest.raises(ValueError, match='^state 0.position.theta_1: expected a .*, got .*nan'):
        model.assemble({'theta_1': [math.nan, 1.0]})
    with pytest.warns(RuntimeWarning) as warned:
        model.assemble({'theta_1': np.linspace(0.3, 0.4, 9)})
    assert [str(each.message)[:8] for each in warned] == [
        'state 0:', 'state 1:', 'state 2:', 'and 6 mo']


def test_states_and_evaluations_never_change():
    simulation = cld.Simulation.from_scene('stewart_platform')
    model, state = cld.Model(simulation.scene), simulation.snapshot()
    now = model.evaluate(state)
    before = state.q.copy(), now.acceleration.copy(), np.array(now.points)
    simulation.step(duration=0.05)
    model.evaluate(simulation.snapshot())
    q = state.q.copy()
    given = model.state(q)
    q[:] = 7.0
    assert np.array_equal(given.q, state.q)
    for each, kept in zip((state.q, now.acceleration, np.asarray(now.points)), before):
        assert np.array_equal(each, kept)
    for copy in (lambda one: one, deepcopy, lambda one: pickle.loads(pickle.dumps(one))):
        same, then = copy(state), copy(now)
        assert np.array_equal(then.joint_forces, now.joint_forces, True)
        for array in (same.q, same.qd, same.own, same.velocity.array, then.acceleration,
                      then.multipliers, then.torque, then.effort, then.joint_forces.array,
                      next(iter(then.points.values()))):
            with pytest.raises(ValueError, match='read-only'):
                array[...] = 0.0
    for record, key in ((state, 'q'), (now, 'closure'), (now, 'state')):
        with pytest.raises(FrozenInstanceError):
            setattr(record, key, None)
    with pytest.raises(TypeError):
        now.points['joint'] = 0.0


def test_a_run_begins_in_a_state_and_comes_back_to_it():
    model = model_of('stewart_platform')
    run = cld.Simulation(model, method='rk4')
    run.step(duration=0.02)
    state = run.snapshot()
    for method in ('rk4', {'integrator': 'rk4'}, replace(model.scene.method, integrator='rk4')):
        other = cld.Simulation(model, state, method)
        assert other.time == state.time and np.array_equal(other.position, state.q)
        other.step(duration=0.02)
        assert other.energy_balance.residual == pytest.approx(0.0, abs=1e-6)
        moved = other.snapshot()
        other.reset()
        assert np.array_equal(other.snapshot().q, state.q) and other.time == state.time
    run.step(duration=0.02)
    assert np.array_equal(run.position, moved.q) and np.array_equal(run.velocity, moved.qd)
    assert run.time == pytest.approx(moved.time, abs=1e-15)
    # The model has not moved.
    assert np.array_equal(model.assemble().q, cld.Simulation(model).position)


@pytest.mark.parametrize('name', [
    'carpet_scraper_on_carpet', 'carpet_scraper_dry', 'cam_follower', 'rope_hoist', 'rack_press'])
def test_effects_go_on_where_they_were(name):
    model = model_of(name)
    run = cld.Simulation(model, method='rk4')
    run.step(duration=0.1)
    state = run.snapshot()
    assert len(state.own)
    other = cld.Simulation(model, state, 'rk4')
    for each in (run, other):
        each.step(duration=0.1)
    close(other.position, run.position)
    close(other.data.integrated, run.data.integrated, 1e-9)


def test_a_rollout_is_its_runs_one_by_one():
    model = model_of('three_rrr')
    start = model.assemble()
    batch = model.assemble(
        start.q + 0.01 * np.random.default_rng(2).normal(size=(5, len(start.q))))
    torques = np.random.default_rng(3).normal(size=(5, 4, 3))
    found = cld.rollout(model, batch, torques, method='rk4', steps=8, every=8)
    assert not found.failures
    for k, state in enumerate(batch):
        simulation = cld.Simulation(model, state, 'rk4')
        for row in torques[k]:
            simulation.step(row, 0.002)
        assert np.array_equal(found.position[k, -1], simulation.position)
    # A single state for all of them.
    assert cld.rollout(model, start, torques, method='rk4').position.shape[0] == 5
    assert cld.rollout(model, None, torques).position.shape[0] == 5


def test_a_rollout_from_where_effects_have_gone_on_is_refused():
    model = model_of('carpet_scraper_on_carpet')
    run = cld.Simulation(model)
    run.step(duration=0.2)
    state = run.snapshot()
    assert begins(model, model.assemble()) and not begins(model, state)
    with pytest.raises(ValueError, match='rollout: expected states in which the effects begin'):
        cld.rollout(model, state)


def test_several_threads_are_served():
    model = model_of('three_rrr')
    states = list(model.assemble(
        model.assemble().q + 0.01 * np.random.default_rng(4).normal(size=(40, 7))))
    expected = [model.evaluate(state).acceleration for state in states]
    with ThreadPoolExecutor(4) as pool:
        found = [now.acceleration for now in pool.map(model.evaluate, states)]
    assert np.array_equal(found, expected)
    copies = pickle.loads(pickle.dumps(model)), deepcopy(model)
    for copy in copies:
        assert np.array_equal(copy.evaluate(states[0]).acceleration, expected[0])


def test_an_evaluator_of_a_model_computes_the_same():
    model = model_of('bennett')
    state, evaluate = model.assemble(), model.evaluator('acceleration', 'multipliers')
    assert np.array_equal(evaluate.q, state.q)
    evaluate.qd[:] = state.qd
    evaluate()
    now = model.evaluate(state)
    close(evaluate.acceleration, now.acceleration)
    close(evaluate.multipliers, now.multipliers)


def test_what_things_are_is_shown():
    model = model_of('three_rrr')
    state = model.assemble()
    assert repr(model).startswith('<Model of three_rrr: 7 joint rates, 2 cut joints, actuated: ')
    assert repr(state).startswith('<State at t = 0 s: theta_1 = 1.0467, ') and (
        'and 1 more; at rest' in repr(state))
    batch = cld.State.stack([state, state])
    assert repr(batch) == '<2 States: q (2, 7), qd (2, 7), own (2, 0)>'
    assert 'acceleration (7,)' in repr(model.evaluate(state))
    assert 'Evaluation of 2 states' in repr(model.evaluate(batch))
    assert repr(model.evaluate(state).points).startswith('<points (4, 2) of platform_center, ')
    ball = model_of('stewart_platform').assemble()
    assert len(ball.position) == len(ball.coordinates.keys)
    for name in ball.coordinates.with_orientation:
        assert np.linalg.norm(ball.position[name][-4:]) == pytest.approx(1.0)


RRR, BAR = model_of('three_rrr'), model_of('four_bar')
HERE = RRR.assemble()
Q, QD = HERE.q, HERE.qd


@pytest.mark.parametrize('attack, message', [
    (lambda: RRR.state(Q[:-1]), r'expected q of shape \(7,\).* got \(6,\)'),
    (lambda: RRR.state(Q, QD[:3]), r'expected qd of shape \(7,\).* got \(3,\)'),
    (lambda: RRR.state([Q, Q], QD), r'expected qd of shape \(7,\).* got \(7,\) beside q'),
    (lambda: RRR.state([[Q]]), r'expected q of shape'),
    (lambda: RRR.state(0.3), 'expected a sequence for q, got'),
    (lambda: RRR.state(np.full(7, np.nan)), 'expected finite numbers for q'),
    (lambda: RRR.state(Q, time=math.inf), 'expected finite numbers for time'),
    (lambda: RRR.state(Q, time=[0.0, 1.0]), r'expected one time, or times of shape \(\), got'),
    (lambda: RRR.state(Q, own=[1.0]), r'expected 0 own states of effects, got own of shape'),
    (lambda: RRR.evaluate(Q), 'expected a State, .* got array'),
    (lambda: RRR.evaluate(BAR.assemble()), 'expected one of three_rrr, with the joints theta_1'),
    (lambda: RRR.evaluate(HERE, [1.0, 2.0]), r'torque: expected 3 values.*got shape \(2,\)'),
    (lambda: RRR.evaluate(HERE, np.zeros((2, 3))), r'torque: expected 3 .*got shape \(2, 3\)'),
    (lambda: RRR.evaluate(cld.State.stack([HERE] * 2), np.zeros((3, 3))),
     r'torque: expected shape \(3,\) or \(2, 3\) for 2 states.*got shape \(3, 3\)'),
    (lambda: RRR.evaluate(cld.State.stack([HERE])[:0]), 'expected at least one, got an empty'),
    (lambda: RRR.evaluate(HERE, {'theta_2': 1.0}), "torque: expected actuated joints.*'theta_2'"),
    (lambda: RRR.evaluate(HERE, {'theta_1': math.nan}), 'torque: expected finite numbers'),
    (lambda: RRR.inverse(HERE, np.zeros(3)), r'acceleration: expected shape \(7,\).*got \(3,\)'),
    (lambda: RRR.assemble({'theta_9': 1.0}), 'position.*theta_9'),
    (lambda: RRR.assemble({'theta_1': [1.0, 1.1]}, {'theta_1': [0.0] * 3}),
     'the same number of states everywhere, got 2 in position of theta_1, 3 in velocity'),
    (lambda: RRR.assemble({'theta_1': np.zeros((2, 2))}), r'theta_1: .* got shape \(2, 2\)'),
    (lambda: RRR.assemble(np.zeros((1, 1, 7))), r'one or two axes, got shape \(1, 1, 7\)'),
    (lambda: RRR.assemble(Q[:3]), r'position: expected 7 finite numbers'),
    (lambda: RRR.assemble(Q, time=math.nan), 'time: expected 1 finite number'),
    (lambda: RRR.with_parameters({'mechanism.bodies.nothing.mass': 1.0}), 'nothing'),
    (lambda: RRR.evaluator('energy'), "expected quantities of .*got 'energy'"),
    (lambda: cld.State.stack([]), 'expected at least one, got none'),
    (lambda: cld.State.stack([HERE, BAR.assemble()]), 'states of one mechanism'),
    (lambda: cld.Simulation(RRR, cld.State.stack([HERE])), r'single one, got a batch of q \(1, 7'),
    (lambda: cld.Simulation(RRR, BAR.assemble()), 'expected one of three_rrr'),
    (lambda: cld.Simulation(RRR, HERE, 'rk5'), "method.*integrator.*'rk5'"),
    (lambda: cld.Simulation(RRR, HERE, {'step': 1.0}), "method.*'?step"),
    (lambda: cld.Simulation('three_rrr'), "a Model or a Scene, got 'three_rrr'; .*from_scene"),
    (lambda: cld.Model('three_rrr'), "expected a Scene, as load_scene .* got 'three_rrr'"),
    (lambda: cld.rollout(RRR, BAR.assemble()), 'expected one of three_rrr'),
    (lambda: cld.rollout(RRR, cld.State.stack([HERE] * 2), np.zeros((3, 1, 3))),
     'the same number of samples everywhere'),
    (lambda: RRR.evaluate(HERE).points['elbow'], "points: expected one of platform.*'elbow"),
    (lambda: RRR.evaluate(HERE).joint_forces['theta_8'], "did you mean 'theta_"),
    (lambda: HERE[0], r'expected a batch, got a single state of q \(7,\)'),
])
def test_misuse_is_refused_with_what_was_expected_and_got(attack, message):
    with pytest.raises((ValueError, KeyError, TypeError), match=message):
        attack()
    # Nothing has happened.
    assert np.array_equal(RRR.assemble().q, Q)


def test_a_state_that_leaves_the_loops_open_is_refused():
    with pytest.raises(cld.AssemblyError, match='state: expected one that closes the loops'):
        cld.Simulation(RRR, RRR.state(Q + 0.1))
