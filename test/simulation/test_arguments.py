# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers that are not finite, or of other shapes, are refused wherever they come in."""

from dataclasses import replace
import math
import re

import closedloop_dynamics as cld
from closedloop_dynamics import Linearisation, load_scene, Model, rollout, Sensitivity, Simulation
from closedloop_dynamics.effects.registry import Actuator
import numpy as np
import pytest

JOINTS = 7


@pytest.fixture(scope='module')
def model():
    return Model.from_scene('three_rrr')


@pytest.mark.parametrize('tau, words', [
    ((0.1,), r'expected shape \(7,\), for theta_1, .*; got shape \(1,\)'),
    (np.float64(0.1), r'.*got shape \(\)'), (0.1, r'.*got shape \(\)'),
    (np.full((JOINTS, 1), 0.1), r'.*got shape \(7, 1\)'),
    (np.full((2, JOINTS), 0.1), r'.*got shape \(2, 7\)'),
    (np.full(JOINTS, 0.1 + 0.2j), 'expected real numbers'),
    (np.full(JOINTS, np.nan), 'expected finite numbers'),
    (['0.1'] * JOINTS, 'expected numbers')])
@pytest.mark.parametrize('delay', [0.0, 0.003])
def test_torques_of_other_shapes_are_refused(tau, words, delay):
    # Commands that are late take another way.
    scene = load_scene('three_rrr')
    scene = replace(scene, effects={**scene.effects, 'motor': Actuator('theta_1', delay=delay)})
    simulation, other = (Simulation(scene) for _ in range(2))
    with pytest.raises(ValueError, match=f'torque: {words}'):
        simulation.advance(tau, 10)
    for one in (simulation, other):
        one.advance(np.zeros(JOINTS), 10)
    np.testing.assert_array_equal(simulation.state, other.state)
    # Lists and whole numbers are numbers.
    simulation.advance([0] * JOINTS, 1)


@pytest.mark.parametrize('delay', [0.0, 0.003])
def test_torques_of_the_actuated_joints_are_those_of_step(delay):
    scene = load_scene('three_rrr')
    scene = replace(scene, effects={**scene.effects, 'motor': Actuator('theta_1', delay=delay)})
    runs = [Simulation(scene) for _ in range(3)]
    torque = np.array([0.3, -0.2, 0.1])
    whole = np.zeros(JOINTS)
    whole[[runs[0].torque_names.index(name) for name in runs[0].actuated_joints]] = torque
    for _ in range(5):
        runs[0].step(torque)
        runs[1].advance(torque, 1)
        runs[2].advance(whole, 1)
    for run in runs[1:]:
        np.testing.assert_array_equal(run.state, runs[0].state)


def test_what_is_shown_is_short_and_names_what_it_is_of():
    model, run = Model.from_scene('three_rrr'), Simulation.from_scene('three_rrr')
    state = model.assemble()
    sensitivity = cld.Sensitivity(model, 'rk4')
    trajectory = sensitivity.trajectory(steps=2)
    differentiate = cld.Differentiator(run)
    linear = model.linearise(state)
    for one, words in (
            (run, 'three_rrr at t = 0 s'), (linear, 'position.theta_1'),
            (cld.Linearisation(run), 'three_rrr'), (differentiate, 'three_rrr'),
            (differentiate(run.position, run.velocity), r'by_position array\(11, 7\)'),
            (differentiate.wrenches(run.position, run.velocity), r'wrench array\(9, 3\)'),
            (sensitivity, 'rk4'), (trajectory, r'position array\(3, 7\)'),
            (trajectory.gradient(), r'torques array\(1, 3\)'),
            (trajectory.changes(), r'velocity array\(3, 7\)'),
            (cld.rollout(model, steps=2), r'failures {}'),
            (model.stepper(0.01), 'theta_1, theta_6, theta_7')):
        assert re.search(words, repr(one)), repr(one)
        assert len(repr(one)) < 500


@pytest.mark.parametrize('steps', [-5, True, False, 2.0, '3', None, np.int64(-1)])
def test_numbers_of_steps_that_are_none_are_refused(steps):
    simulation = Simulation.from_scene('three_rrr')
    with pytest.raises(ValueError, match='steps: expected a whole number >= 0, got'):
        simulation.advance(np.zeros(JOINTS), steps)
    assert simulation.time == 0.0
    simulation.advance(np.zeros(JOINTS), np.int64(3))
    assert simulation.time == pytest.approx(3 * simulation.step_size)


IMAGINARY = 1.0 + 0.5j


@pytest.mark.parametrize('use', [
    lambda model, one: one.step(np.full(3, IMAGINARY)),
    lambda model, one: one.step({'theta_1': np.complex128(IMAGINARY)}),
    lambda model, one: one.step(np.full(3, IMAGINARY), 0.1),
    lambda model, one: one.rollout(np.full((2, 1, 3), IMAGINARY), steps=2),
    lambda model, one: one.rollout(initial_position=one.position * IMAGINARY, steps=2),
    lambda model, one: one.rollout(
        steps=2, parameters={'mechanism.bodies.distal_1.mass': [IMAGINARY]}),
    lambda model, one: rollout(model, torques=np.full((2, 1, 3), IMAGINARY), steps=2),
    lambda model, one: one.set_state(one.position * IMAGINARY),
    lambda model, one: one.restore(one.state * IMAGINARY, 0.0),
    lambda model, one: one.forward_dynamics(one.position, one.velocity * IMAGINARY),
    lambda model, one: one.inverse_dynamics(one.position, one.velocity, np.full(7, IMAGINARY)),
    lambda model, one: model.state(one.position * IMAGINARY),
    lambda model, one: model.state(one.position, one.velocity + IMAGINARY),
    lambda model, one: model.assemble(one.position * IMAGINARY),
    lambda model, one: model.assemble({'theta_1': np.array([IMAGINARY, 1.0])}),
    lambda model, one: model.evaluate(model.assemble(), np.full(3, IMAGINARY)),
    lambda model, one: model.inverse(model.assemble(), np.full(7, IMAGINARY)),
    lambda model, one: model.solve({'theta_1': np.array([IMAGINARY])}),
    lambda model, one: Linearisation(one).linear_model(one.position * IMAGINARY),
    lambda model, one: Sensitivity(model, {'integrator': 'heun'}).trajectory(
        torques=np.full((2, 3), IMAGINARY))])
def test_imaginary_parts_are_not_dropped(model, use):
    with pytest.raises(ValueError, match='expected real numbers'):
        use(model, Simulation(model))


@pytest.mark.parametrize('size, duration', [(1e4, 1e-5), (1e-3, 1e-15), (1e-3, 1.0000000001e-3)])
def test_the_shortest_step_is_made(size, duration):
    simulation = Simulation.from_scene('four_bar', step_size=size, integrator='auto')
    before = simulation.velocity
    simulation.step({'crank_joint': 1.0}, duration)
    assert simulation.time == pytest.approx(duration, rel=1e-9)
    # From rest: rates are accelerations times the time.
    acceleration = np.abs(simulation.acceleration).max()
    assert np.abs(simulation.velocity - before).max() == pytest.approx(
        acceleration * duration, rel=1e-2)
    assert math.isfinite(simulation.closure)


def test_independent_joints_are_named_once(model):
    names = ['theta_1', 'theta_1', 'theta_2']
    for use in (lambda: model.linearise(model.assemble(), independent=names),
                lambda: Linearisation(Simulation(model), names),
                lambda: Sensitivity(model, {'integrator': 'heun'}, independent=names)):
        with pytest.raises(ValueError, match="expected each name once, got 'theta_1' twice"):
            use()
