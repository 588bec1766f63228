# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of trajectories: twins in complex numbers, differences, flows, and refusals."""

from dataclasses import replace
from pathlib import Path
import runpy

import closedloop_dynamics as cld
from closedloop_dynamics import (
    ClosureError, Differentiator, NumericalError, SimulationError, SingularityError)
from closedloop_dynamics.effects.registry import (
    ExternalForce, JointDamping, JointSpring, Payload, PointSpring, Rotor)
from closedloop_dynamics.scene.key_paths import numbers
import numpy as np
import pytest

from .test_derivatives import PARALLELOGRAM, PARALLELOGRAM_SCENE, with_open_loops

ROOT = Path(__file__).resolve().parents[2]
# Of sixth order.
WEIGHTS = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
STEPS, EVERY, ROWS = 60, 20, 6
ROD = {'mass': 2.0, 'center_of_mass': [0.4, 0.1], 'inertia': 0.3}
PENDULUM = {
    'mechanism': {'name': 'pendulum', 'bodies': {'rod': ROD}, 'joints': {'pivot': {
        'type': 'revolute', 'parent': 'ground', 'child': 'rod', 'position': [0.0, 0.0],
        'actuated': True}}},
    'initial': {'position': {'pivot': 0.3}, 'velocity': {'pivot': 0.7}},
    'effects': {'gravity': {'type': 'gravity', 'acceleration': [0.5, -9.81]},
                'bearing': {'type': 'joint_damping', 'joint': 'pivot', 'coefficient': 0.2},
                'spring': {'type': 'joint_spring', 'joint': 'pivot', 'stiffness': 3.0,
                           'rest': 0.1}}}


def differences(function, step):
    """Return the derivative of a function of one number at zero."""
    return sum(weight * (function(k * step) - function(-k * step)) for k, weight in WEIGHTS) / step


class Case:
    """A model with a trajectory, a cost with random weights, and a direction of everything."""

    def __init__(self, scene, integrator='rk4', parameters=(), effects=(), size=0.3, **method):
        scene = cld.load_scene(scene)
        self.model = cld.Model(replace(scene, effects={**scene.effects, **dict(effects)}))
        self.method = {'integrator': integrator, 'step_size': 1e-3, **method}
        self.sensitivity = cld.Sensitivity(self.model, self.method, parameters)
        self.rng = np.random.default_rng(3)
        self.torques = size * self.rng.normal(size=(ROWS, len(self.model.actuated_joints)))
        self.start = self.model.assemble()
        self.trajectory = self.run(self.torques, self.start)
        self.of_position = self.rng.normal(size=self.trajectory.position.shape)
        self.of_velocity = self.rng.normal(size=self.trajectory.velocity.shape)
        self.gradient = self.trajectory.gradient(self.of_position, self.of_velocity)
        self.own = self.trajectory.independent

    def run(self, torques, start):
        return self.sensitivity.trajectory(start, torques, steps=STEPS, every=EVERY)

    def run_many(self, torques, start):
        return self.sensitivity.trajectories(start, torques, steps=STEPS, every=EVERY)

    def cost(self, position, velocity):
        return np.sum(self.of_position * position) + np.sum(self.of_velocity * velocity)

    def rollout(self, torques, start, model=None):
        """Return the cost of a rollout, and require that it is fine."""
        done = cld.rollout(model or self.model, start, torques, method=self.method, steps=STEPS,
                           every=EVERY)
        assert np.isfinite(done.velocity).all()
        return self.cost(done.position[0], done.velocity[0])

    def moved(self, position, velocity, model=None):
        """Return the start with independent coordinates and rates changed."""
        q, qd = self.start.q.copy(), self.start.qd.copy()
        places = [self.model.joint_names.index(name) for name in self.own]
        q[places] += position
        qd[places] += velocity
        return (model or self.model).assemble(q, qd, hold=self.own)

    def require_one_derivative(self, directions=3):
        """Compare what directions do with what the gradient says of them."""
        shapes = {'torques': self.torques.shape, 'position': (len(self.own),),
                  'velocity': (len(self.own),), 'parameters': self.gradient.parameters.shape}
        given = {name: self.rng.normal(size=(directions, *shape))
                 for name, shape in shapes.items()}
        # Each counts about as much.
        for name in given:
            given[name] /= 1e-9 + np.abs(getattr(self.gradient, name)).max(initial=0.0)
        changes = self.trajectory.changes(**given)
        forward = [self.cost(*one) for one in zip(*changes)]
        parts = [(given[name] * getattr(self.gradient, name)).reshape(directions, -1).sum(axis=1)
                 for name in given]
        size = np.abs(parts).max()
        np.testing.assert_allclose(forward, np.sum(parts, axis=0), rtol=0, atol=1e-12 * size)


def pendulum(values, integrator, steps, step_size, torques):
    """Return angles and rates after each step; any numbers, complex ones too."""
    angle, rate, mass, x, y, inertia, g_x, g_y, damping, stiffness, rest = values
    whole = inertia + mass * (x * x + y * y)

    def acceleration(angle, rate, torque):
        along = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
        moment = mass * (along[0] * g_y - along[1] * g_x)
        return (torque + moment - damping * rate - stiffness * (angle - rest)) / whole

    found = [(angle, rate)]
    for step in range(steps):
        torque, h = torques[step * len(torques) // steps], step_size
        if integrator == 'semi_implicit_euler':
            rate = rate + h * acceleration(angle, rate, torque)
            angle = angle + h * rate
        else:
            slopes = [(rate, acceleration(angle, rate, torque))]
            for share in (0.5, 0.5, 1.0):
                a, b = slopes[-1]
                slopes.append((rate + h * share * b, acceleration(
                    angle + h * share * a, rate + h * share * b, torque)))
            angle, rate = (now + h / 6 * (one[0] + 2 * one[1] + 2 * one[2] + one[3])
                           for now, one in zip((angle, rate), zip(*slopes)))
        found.append((angle, rate))
    return np.array(found)


@pytest.mark.parametrize('integrator', ['rk4', 'semi_implicit_euler'])
def test_a_pendulum_as_complex_steps_say(integrator):
    keys = ['mechanism.bodies.rod.mass', 'mechanism.bodies.rod.center_of_mass.0',
            'mechanism.bodies.rod.center_of_mass.1', 'mechanism.bodies.rod.inertia',
            'effects.gravity.acceleration.0', 'effects.gravity.acceleration.1',
            'effects.bearing.coefficient', 'effects.spring.stiffness', 'effects.spring.rest']
    scene = cld.load_scene(PENDULUM)
    values = [0.3, 0.7, *(numbers(scene)[key] for key in keys)]
    torques, steps, size = np.array([0.5, -1.0, 0.25]), 30, 0.01
    sensitivity = cld.Sensitivity(cld.Model(scene), {'integrator': integrator, 'step_size': size},
                                  keys)
    trajectory = sensitivity.trajectory(None, torques[:, np.newaxis], steps=steps)
    twin = pendulum(values, integrator, steps, size, torques)
    np.testing.assert_allclose(trajectory.position[:, 0], twin[:, 0], rtol=1e-12)
    weights = np.random.default_rng(0).normal(size=twin.shape)

    def derivative(place):
        changed = np.array([*values, *torques], dtype=complex)
        changed[place] += 1e-40j
        found = pendulum(changed[:len(values)], integrator, steps, size, changed[len(values):])
        return np.sum(weights * found.imag) / 1e-40
    expected = np.array([derivative(place) for place in range(len(values) + len(torques))])
    found = trajectory.gradient(weights[:, :1], weights[:, 1:])
    np.testing.assert_allclose(
        np.concatenate((found.position, found.velocity, found.parameters, found.torques[:, 0])),
        expected, rtol=1e-11, atol=1e-12 * np.abs(expected).max())


def test_an_oscillator_as_powers_of_its_step():
    # x'' = -k x + tau on a slider of mass 1: a step of RK4 is the series of exp(h A) up to h^4.
    slide = {'type': 'prismatic', 'parent': 'ground', 'child': 'cart', 'position': [0.0, 0.0],
             'actuated': True}
    model = cld.Model.from_scene({
        'mechanism': {'name': 'cart', 'bodies': {'cart': {
            'mass': 1.0, 'center_of_mass': [0.0, 0.0], 'inertia': 1.0}}, 'joints': {'x': slide}},
        'initial': {'position': {'x': 0.2}},
        'effects': {'spring': {'type': 'joint_spring', 'joint': 'x', 'stiffness': 9.0,
                               'rest': 0.0}}})
    h, steps = 0.05, 20
    trajectory = cld.Sensitivity(model, {'integrator': 'rk4', 'step_size': h}).trajectory(
        None, np.zeros((steps, 1)))
    a, step, term, driven = np.array([[0.0, 1.0], [-9.0, 0.0]]), np.eye(2), np.eye(2), np.eye(2)
    for order in range(1, 5):
        driven = driven if order == 1 else driven + term / order
        term = h / order * term @ a
        step = step + term
    powers = [np.linalg.matrix_power(step, k) for k in range(steps + 1)]
    last = np.zeros((steps + 1, 1))
    last[-1] = 1.0
    found = trajectory.gradient(last)
    np.testing.assert_allclose((found.position[0], found.velocity[0]), powers[-1][0], rtol=1e-13)
    # A torque adds h (1 + h A / 2 + ... + (h A)^3 / 24) (0, 1) to the state after its step.
    np.testing.assert_allclose(
        found.torques[:, 0], [h * (powers[steps - 1 - k] @ driven)[0, 1] for k in range(steps)],
        rtol=1e-12)


EFFECTS = {'spring': JointSpring('theta_1', 3.0, 0.2), 'damper': JointDamping('theta_2', 0.05),
           'strut': PointSpring('platform_center', None, (0.1, 0.7), 20.0, 0.3, 0.1),
           'push': ExternalForce('corner_1', (0.4, -0.3), 0.05, 'body'),
           'load': Payload('platform', 0.7, (0.02, 0.01), 1e-3), 'gear': Rotor('theta_1', 2e-3)}
PARAMETERS = (
    'mechanism.bodies.platform.mass', 'mechanism.bodies.distal_1.center_of_mass.0',
    'mechanism.bodies.proximal_1.inertia', 'mechanism.joints.theta_4.position.0',
    'mechanism.cut_joints.cut_1.point_a.0', 'effects.gravity.acceleration.1',
    'effects.spring.rest', 'effects.damper.coefficient', 'effects.strut.free_length',
    'effects.push.torque', 'effects.load.position.0', 'effects.gear.inertia')


@pytest.fixture(scope='module')
def three_rrr():
    """Return a closed loop with effects and parameters."""
    return Case('three_rrr', 'rk4', PARAMETERS, EFFECTS)


def test_forward_and_reverse_are_one_derivative(three_rrr):
    three_rrr.require_one_derivative()


@pytest.mark.parametrize('scene, integrator, stabilisation', [
    ('three_rrr', 'semi_implicit_euler', 'projection'), ('three_rrr', 'heun', 'projection'),
    ('three_rrr', 'rk4', 'velocity_projection'), ('three_rrr', 'rk4', 'none'),
    ('rssr_four_bar', 'rk4', 'projection'), ('rssr_four_bar', 'semi_implicit_euler', 'projection'),
    pytest.param('stewart_platform', 'rk4', 'projection', marks=pytest.mark.slow),
    pytest.param('scissor_lift', 'rk4', 'projection', marks=pytest.mark.slow)])
def test_of_all_methods_they_are_the_derivative(scene, integrator, stabilisation):
    case = Case(scene, integrator, stabilisation=stabilisation, size=0.02)
    if stabilisation == 'projection':
        # What is differentiated closes loops.
        for q, qd in zip(case.trajectory.position, case.trajectory.velocity):
            assert case.model.evaluate(case.model.state(q, qd)).closure < 1e-10
    case.require_one_derivative()
    direction = case.rng.normal(size=case.torques.shape)
    expected = differences(
        lambda size: case.cost(*values(case.run(case.torques + size * direction, case.start))),
        1e-3)
    found = np.sum(direction * case.gradient.torques)
    assert abs(found - expected) < 1e-8 * (abs(direction) * abs(case.gradient.torques)).sum()


def values(trajectory):
    return trajectory.position, trajectory.velocity


def test_a_gradient_passes_an_impact_on_a_stop():
    model = cld.Model.from_scene('slider_crank_end_stop')
    torques, steps = np.full((5, 1), 0.1), 650
    method, start = {'integrator': 'rk4', 'step_size': 1e-3}, model.assemble()
    trajectory = cld.Sensitivity(model, method).trajectory(start, torques, steps=steps)
    stroke = trajectory.position[:, model.joint_names.index('slider_joint')]
    # It meets the stop, at 0.38 m, and has left it.
    assert stroke.max() > 0.381 and stroke[-1] < 0.38

    def last(size):
        done = cld.rollout(model, start, torques + size, method=method, steps=steps)
        return done.velocity[0, -1].sum()

    weights = np.zeros_like(trajectory.velocity)
    weights[-1] = 1.0
    np.testing.assert_array_equal(trajectory.velocity[-1].sum(), last(0.0))
    # Between evaluations that differ in which side of the stop they are at.
    assert trajectory.gradient(by_velocity=weights).torques.sum() == pytest.approx(
        differences(last, 1e-6), rel=1e-6)


@pytest.mark.parametrize('integrator', ['rk4', 'semi_implicit_euler'])
@pytest.mark.parametrize('scene', ['three_rrr', 'rssr_four_bar'])
def test_a_trajectory_is_the_rollout_but_for_rounding(scene, integrator):
    # Where it needs multipliers, other products are rounded.
    case = Case(scene, integrator)
    done = cld.rollout(case.model, case.start, case.torques, method=case.method, steps=STEPS,
                       every=EVERY)
    if not (scene == 'rssr_four_bar' and integrator == 'semi_implicit_euler'):
        # There a guard ends the rollout.
        for found, expected in ((case.trajectory.position, done.position[0]),
                                (case.trajectory.velocity, done.velocity[0])):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(found).max())
    np.testing.assert_allclose(case.trajectory.time, done.time, rtol=1e-15)


def test_the_gradient_is_that_of_rollouts(three_rrr):
    case, found = three_rrr, three_rrr.gradient
    n = len(case.own)
    none, direction = np.zeros(n), case.rng.normal(size=case.torques.shape)
    by_position, by_velocity = case.rng.normal(size=(2, n))
    for gradient, expected in (
            (np.sum(found.torques * direction), differences(lambda size: case.rollout(
                case.torques + size * direction, case.start), 1e-2)),
            (found.position @ by_position, differences(lambda size: case.rollout(
                case.torques, case.moved(size * by_position, none)), 1e-3)),
            (found.velocity @ by_velocity, differences(lambda size: case.rollout(
                case.torques, case.moved(none, size * by_velocity)), 1e-2))):
        assert gradient == pytest.approx(expected, rel=1e-8)


def test_the_gradient_by_parameters_is_that_of_rollouts_of_other_models(three_rrr):
    case, none = three_rrr, np.zeros(len(three_rrr.own))
    for key, found in zip(PARAMETERS, case.gradient.parameters):
        value = numbers(case.model.scene)[key]

        def cost(change):
            model = case.model.with_parameters({key: value + change})
            return case.rollout(case.torques, case.moved(none, none, model), model)
        assert found == pytest.approx(differences(cost, 2e-3 * abs(value)), rel=2e-7), key


@pytest.mark.slow
def test_parameters_in_space():
    keys = ('mechanism.bodies.platform.mass', 'mechanism.joints.foot_1.position.0',
            'mechanism.cut_joints.head_2.point_a.1', 'effects.gravity.acceleration.2')
    case = Case('stewart_platform', parameters=keys)
    case.require_one_derivative()
    none = np.zeros(len(case.own))
    for key, found in zip(keys, case.gradient.parameters):
        value = numbers(case.model.scene)[key]

        def cost(change):
            model = case.model.with_parameters({key: value + change})
            return case.rollout(case.torques, case.moved(none, none, model), model)
        assert found == pytest.approx(differences(cost, 2e-3 * abs(value)), rel=2e-7), key


@pytest.mark.parametrize('scene', ['three_rrr', 'rssr_four_bar', 'four_bar'])
def test_a_start_later_on_the_way_is_an_end_later_on_it(scene):
    # Under constant torques: changes by the rates and accelerations at the start become those by
    # the rates and accelerations at the end.
    model = cld.Model.from_scene(scene)
    sensitivity = cld.Sensitivity(model, {'integrator': 'rk4', 'step_size': 5e-4})
    torques = np.full((1, len(model.actuated_joints)), 0.1)
    moving = sensitivity.trajectory(None, torques, steps=200)
    start = model.state(moving.position[-1], moving.velocity[-1])
    trajectory = sensitivity.trajectory(start, torques, steps=100, every=100)
    places = [model.joint_names.index(name) for name in trajectory.independent]
    accelerations = [model.evaluate(model.state(q, qd), torques[0]).acceleration
                     for q, qd in zip(trajectory.position, trajectory.velocity)]
    found = trajectory.changes(position=start.qd[places], velocity=accelerations[0][places])
    np.testing.assert_allclose(found.velocity[-1], accelerations[-1], rtol=0,
                               atol=1e-7 * np.abs(accelerations).max())
    if not len(model.coordinates.balls):
        np.testing.assert_allclose(found.position[-1], trajectory.velocity[-1], rtol=0,
                                   atol=1e-7 * np.abs(trajectory.velocity).max())


def test_changes_in_one_direction_are_without_an_axis(three_rrr):
    directions = three_rrr.rng.normal(size=(2, len(three_rrr.own)))
    both = three_rrr.trajectory.changes(position=directions)
    one = three_rrr.trajectory.changes(position=directions[1])
    np.testing.assert_array_equal(both.position[1], one.position)
    np.testing.assert_array_equal(both.velocity[1], one.velocity)
    nothing = three_rrr.trajectory.changes()
    assert not nothing.position.any() and nothing.velocity.shape == one.velocity.shape


@pytest.mark.parametrize('many', ['starts', 'torques', 'both'])
def test_many_trajectories_are_single_ones(three_rrr, many):
    case, n = three_rrr, len(three_rrr.own)
    shift = 0.02 * case.rng.normal(size=(2, 3, n))
    starts = [case.moved(*one) for one in zip(*shift)]
    torques = case.torques * np.array([1.0, -0.5, 2.0])[:, np.newaxis, np.newaxis]
    batch = case.model.state(*(np.stack([getattr(one, name) for one in starts])
                               for name in ('q', 'qd')))
    if many == 'torques':
        batch, starts = case.start, [case.start] * 3
    if many == 'starts':
        torques = case.torques
    found = case.run_many(torques, batch)
    assert len(found) == 3 and found.independent == case.own
    weights = case.rng.normal(size=found.position.shape), case.rng.normal(
        size=found.velocity.shape)
    gradient = found.gradient(*weights)
    directions = {'torques': case.rng.normal(size=(3, *case.torques.shape)),
                  'position': case.rng.normal(size=(3, n)),
                  'velocity': case.rng.normal(size=(3, n)),
                  'parameters': case.rng.normal(size=(3, *case.gradient.parameters.shape))}
    changes = found.changes(**directions)
    for k, start in enumerate(starts):
        one = case.run(np.broadcast_to(torques, (3, *case.torques.shape))[k], start)
        np.testing.assert_array_equal(found.position[k], one.position)
        np.testing.assert_array_equal(found.velocity[k], one.velocity)
        for all_of, single in (
                (gradient, one.gradient(*(each[k] for each in weights))),
                (changes, one.changes(**{name: each[k] for name, each in directions.items()}))):
            for several, value in zip(all_of, single):
                np.testing.assert_allclose(
                    several[k], value, rtol=0, atol=1e-13 * np.abs(value).max(initial=1.0))
        # Of rollouts, by one torque of each.
        step, others = 1e-3, np.broadcast_to(torques, (3, *case.torques.shape))[k]

        def cost(amount):
            done = cld.rollout(case.model, start, others + amount * directions['torques'][k],
                               method=case.method, steps=STEPS, every=EVERY)
            return np.sum(weights[0][k] * done.position[0]) + np.sum(
                weights[1][k] * done.velocity[0])

        expected = differences(cost, step)
        assert np.sum(gradient.torques[k] * directions['torques'][k]) == pytest.approx(
            expected, rel=1e-7)


def test_many_trajectories_of_no_number_are_refused(three_rrr):
    case = three_rrr
    with pytest.raises(ValueError, match='got a single state'):
        case.run_many(case.torques, case.start)
    found = case.run_many(np.stack([case.torques] * 2), case.start)
    with pytest.raises(ValueError, match='by_position: expected a leading axis of 2'):
        found.gradient(found.position[0])
    with pytest.raises(NumericalError, match='trajectory 1: '):
        case.run_many(np.stack([case.torques, 1e300 * case.torques]), case.start)


def test_results_never_change(three_rrr):
    for array in (three_rrr.trajectory.time, *values(three_rrr.trajectory), *three_rrr.gradient,
                  *three_rrr.trajectory.changes()):
        with pytest.raises(ValueError, match='read-only'):
            array[...] = 0.0
    with pytest.raises(AttributeError):
        three_rrr.trajectory.time = None


def test_another_trajectory_leaves_the_first_ones_derivatives(three_rrr):
    before = three_rrr.trajectory.gradient(three_rrr.of_position)
    three_rrr.run(2.0 * three_rrr.torques, three_rrr.start)
    for one, other in zip(before, three_rrr.trajectory.gradient(three_rrr.of_position)):
        np.testing.assert_array_equal(one, other)


def test_accelerations_by_parameters_are_those_of_other_models(three_rrr):
    simulation = cld.Simulation(three_rrr.model, None, three_rrr.method)
    simulation.step(dict(zip(simulation.actuated_joints, three_rrr.torques[0])), 0.05)
    state = simulation.position, simulation.velocity
    found = Differentiator(simulation, PARAMETERS)(*state, three_rrr.torques[0])
    nv = len(state[1])
    for place, key in enumerate(PARAMETERS):
        value = numbers(three_rrr.model.scene)[key]

        def results(change):
            # Other lengths leave its loops open.
            model = three_rrr.model.with_parameters({key: value + change})
            other = with_open_loops(model, simulation.snapshot(), three_rrr.torques[0])
            return np.concatenate((other.acceleration, other.multipliers))
        expected = differences(results, 2e-3 * abs(value))
        np.testing.assert_allclose(found.by_parameter[:, place], expected, rtol=0,
                                   atol=1e-9 * max(1.0, np.abs(expected).max()))
    lengths = [key.startswith(('mechanism.joints', 'mechanism.cut_joints')) for key in PARAMETERS]
    assert found.by_parameter.shape == (nv + found.jacobian.shape[0], len(PARAMETERS))
    np.testing.assert_array_equal(found.closure_by_parameter.any(axis=0), lengths)


@pytest.mark.parametrize('method, reason', [
    ('auto', 'depend on error estimates'), ('dop853', 'depend on error estimates'),
    ('rodas4_fixed', 'second derivatives'),
    ({'integrator': 'rk4', 'stabilisation': 'independent'}, 'are exchanged'),
    ({'integrator': 'rk4', 'stabilisation': 'baumgarte', 'baumgarte_time_constant': 0.05},
     'has no derivative')])
def test_methods_without_derivatives_are_refused(method, reason):
    with pytest.raises(ValueError, match=reason):
        cld.Sensitivity(cld.Model.from_scene('four_bar'), method)


@pytest.mark.parametrize('scene, name, reason', [
    ('three_rrr_payload_friction', 'effects.gear_1', 'dry friction jumps'),
    ('carpet_scraper_on_carpet', 'effects.carpet', 'its friction jumps'),
    ('carpet_scraper_dry', 'effects.motor', 'its torque has limits'),
    ('differential', 'effects.engine', 'it follows the time')])
def test_what_is_not_smooth_is_refused(scene, name, reason):
    with pytest.raises(SimulationError) as error:
        cld.Sensitivity(cld.Model.from_scene(scene), {'integrator': 'rk4', 'step_size': 1e-4})
    assert name in str(error.value) and reason in str(error.value)


@pytest.mark.parametrize('key, reason', [
    ('mechanism.bodies.nothing.mass', 'expected one of'),
    ('mechanism.bodies.crank', 'leads to several'),
    ('method.step_size', 'got one of the method'),
    ('initial.position.crank_joint', 'a start is varied as a state'),
    ('mechanism.cut_joints.coupler_rocker_joint.length', 'not given')])
def test_numbers_that_are_no_parameters_are_refused(key, reason):
    model = cld.Model.from_scene('four_bar')
    if 'cut_joints' in key:
        key = key.replace('coupler_rocker_joint', model.mechanism.cut_joints[0].name)
    with pytest.raises(ValueError, match=reason):
        cld.Sensitivity(model, 'rk4', [key])


def test_a_number_that_may_not_change_to_both_sides_is_refused():
    scene = cld.load_scene('four_bar')
    scene = replace(scene, effects={**scene.effects, 'damper': JointDamping('crank_joint', 0.0)})
    with pytest.raises(ValueError, match='may change a little to both sides'):
        cld.Sensitivity(cld.Model(scene), 'rk4', ['effects.damper.coefficient'])


@pytest.mark.slow
def test_positions_at_which_frames_jump_are_refused():
    with pytest.raises(ValueError, match='frames of bodies jump'):
        cld.Sensitivity(cld.Model.from_scene('stewart_platform'), 'rk4',
                        ['mechanism.joints.leg_1.position.0'])


def test_arguments_that_make_no_sense_are_refused(three_rrr):
    sensitivity, trajectory = three_rrr.sensitivity, three_rrr.trajectory
    for arguments, message in (
            ({'torques': np.zeros((2, 3, 3)), 'steps': 6}, 'those of one trajectory'),
            ({'torques': np.zeros((2, 2)), 'steps': 6}, 'actuated joints last'),
            ({'torques': np.zeros((4, 3)), 'steps': 6}, 'a multiple of rows'),
            ({'state': cld.State.stack(2 * [three_rrr.start]), 'steps': 6}, 'a batch of 2'),
            ({'state': cld.Model.from_scene('four_bar').assemble(), 'steps': 6},
             'expected one of three_rrr'),
            ({}, 'got neither')):
        with pytest.raises(ValueError, match=message):
            sensitivity.trajectory(**arguments)
    for arguments, message in (
            ({'by_position': np.zeros(7)}, r'by_position: expected shape \(4, 7\)'),
            ({'by_velocity': np.full((4, 7), np.nan)}, 'by_velocity: expected finite')):
        with pytest.raises(ValueError, match=message):
            trajectory.gradient(**arguments)
    for arguments, message in (
            ({'position': np.zeros(2)}, r'position: expected shape \(3,\)'),
            ({'position': np.zeros((2, 3)), 'velocity': np.zeros((3, 3))},
             r'velocity: expected shape \(2, 3\)'),
            ({'torques': np.inf * np.ones((ROWS, 3))}, 'torques: expected finite')):
        with pytest.raises(ValueError, match=message):
            trajectory.changes(**arguments)
    with pytest.raises(TypeError, match='expected a Model'):
        cld.Sensitivity('three_rrr')
    with pytest.raises(ValueError, match='independent: expected names of'):
        cld.Sensitivity(three_rrr.model, 'rk4', independent=['nothing'])
    with pytest.raises(ValueError, match='independent: expected 3 names'):
        _ = cld.Sensitivity(three_rrr.model, 'rk4', independent=['theta_1']).trajectory(
            steps=2).independent


def test_independent_coordinates_may_be_chosen(three_rrr):
    names = ('theta_2', 'theta_1', 'theta_6')
    trajectory = cld.Sensitivity(three_rrr.model, three_rrr.method, independent=names).trajectory(
        three_rrr.start, three_rrr.torques, steps=STEPS, every=EVERY)
    assert trajectory.independent == names
    found = trajectory.changes(position=np.eye(3))
    # At the start each is changed alone.
    places = [three_rrr.model.joint_names.index(name) for name in names]
    np.testing.assert_allclose(found.position[:, 0][:, places], np.eye(3), atol=1e-14)


def test_singular_positions_have_no_derivatives(tmp_path):
    (tmp_path / 'parallelogram.yaml').write_text(PARALLELOGRAM)
    (tmp_path / 'scene.yaml').write_text(PARALLELOGRAM_SCENE)
    model = cld.Model.from_scene(tmp_path / 'scene.yaml')
    sensitivity = cld.Sensitivity(model, {'integrator': 'rk4', 'step_size': 1e-3})
    flat = sensitivity.trajectory(model.state(np.zeros(3)), steps=3)
    with pytest.raises(SingularityError, match='depend on one another'):
        flat.gradient(np.ones((4, 3)))
    with pytest.raises(SingularityError, match='depend on one another'):
        flat.changes(np.ones((1, 1)))


def test_what_cannot_be_run_is_reported_with_the_time():
    model = cld.Model.from_scene(PENDULUM)
    sensitivity = cld.Sensitivity(model, {'integrator': 'rk4', 'step_size': 1e-3})
    with pytest.raises(NumericalError, match='In the step from .* s on the numbers grow'):
        sensitivity.trajectory(None, [[1e308]], steps=10)
    loop = cld.Model.from_scene('four_bar')
    with pytest.raises((ClosureError, NumericalError), match='In the step from'):
        cld.Sensitivity(loop, {'integrator': 'rk4', 'step_size': 1e-3}).trajectory(
            None, [[1e12]], steps=10)


@pytest.mark.slow
def test_the_example_finds_the_least_effort():
    example = runpy.run_path(str(ROOT / 'doc' / 'examples' / 'optimise_trajectory.py'))
    for scene, (move, duration) in example['MOVES'].items():
        torques, effort, distance = example['optimise'](scene, move, duration)
        assert effort == pytest.approx((torques ** 2).mean()) and distance < 1e-6
        # Along all directions that lead to the goal, too, no torques are less.
        model = cld.Model.from_scene(scene)
        sensitivity = cld.Sensitivity(
            model, {'integrator': 'rk4', 'step_size': duration / example['STEPS']})
        trajectory = sensitivity.trajectory(None, torques, steps=example['STEPS'])
        ends = []
        for what in ('position', 'velocity'):
            names = model.assemble().coordinates.columns(what)
            for name in model.actuated_joints:
                weights = np.zeros_like(getattr(trajectory, what))
                weights[-1, names.index(f'{what}.{name}')] = 1.0
                ends.append(trajectory.gradient(**{f'by_{what}': weights}).torques.ravel())
        beside = torques.ravel() - np.linalg.pinv(np.array(ends)) @ (
            np.array(ends) @ torques.ravel())
        assert np.abs(beside).max() < 1e-3 * np.abs(torques).max(), scene
