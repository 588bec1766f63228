# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of accelerations and multipliers: differences of a dense twin, and refusals."""

from dataclasses import replace
from unittest import mock

from closedloop_dynamics import (
    codegen, Differentiator, Linearisation, load_scene, Model, Scene, Sensitivity, Simulation,
    SimulationError, SingularityError)
from closedloop_dynamics.codegen.differentiation import differentiated, gradients
from closedloop_dynamics.codegen.expression_graph import (
    arctangent, chosen, cosine, exponential, ExpressionGraph, LOAD, logarithm, Q, sine,
    square_root)
from closedloop_dynamics.effects.registry import (
    Bushing, EndStop, ExternalForce, FluidDrag, ForceTable, JointDamping, JointSpring, Law,
    PointSpring, PrescribedForce, Tendon)
from closedloop_dynamics.scene.key_paths import numbers
import numpy as np
import pytest

from ..reference import maximal
from ..reference.compare import assert_agree, SOLVE

# Of sixth order.
WEIGHTS = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
PARALLELOGRAM = """\
name: parallelogram
bodies:
  left: {mass: 1.0, center_of_mass: [0.25, 0.0], inertia: 0.02}
  bar: {mass: 1.0, center_of_mass: [0.5, 0.0], inertia: 0.1}
  right: {mass: 1.0, center_of_mass: [0.25, 0.0], inertia: 0.02}
joints:
  a: {type: revolute, parent: ground, child: left, position: [0.0, 0.0], actuated: true}
  b: {type: revolute, parent: left, child: bar, position: [0.5, 0.0]}
  c: {type: revolute, parent: ground, child: right, position: [1.0, 0.0]}
cut_joints:
  d: {type: revolute, body_a: bar, point_a: [1.0, 0.0], body_b: right, point_b: [0.5, 0.0]}
"""
PARALLELOGRAM_SCENE = """\
mechanism: ./parallelogram.yaml
initial: {position: {a: 0.7, b: -0.7, c: 0.7}, hold: [a]}
effects: {gravity: {type: gravity, acceleration: [0.0, -9.81]}}
"""
BALL = """\
name: ball
bodies:
  rod: {mass: 1.5, center_of_mass: [0.3, 0.1, 0.0], inertia: [0.02, 0.03, 0.04, 0.001, 0.0, 0.0]}
  arm: {mass: 0.5, center_of_mass: [0.2, 0.0, 0.0], inertia: [0.01, 0.02, 0.02]}
joints:
  ball: {type: spherical, parent: ground, child: rod, position: [0.0, 0.0, 0.0]}
  hinge: {type: revolute, parent: rod, child: arm, position: [0.6, 0.0, 0.0],
          axis: [0.0, 1.0, 0.0], actuated: true}
"""
BALL_SCENE = """\
mechanism: ./ball.yaml
initial:
  position: {ball: {orientation: {rpy: [0.3, -0.4, 1.1]}}, hinge: 0.4}
  velocity: {ball: {angular_velocity: [0.5, -1.0, 2.0]}, hinge: 1.0}
effects: {gravity: {type: gravity, acceleration: [0.0, 0.0, -9.81]}}
"""
# A slider-crank whose slider turns a wheel by a rack.
PRESS = """\
name: press
bodies:
  crank: {mass: 1.0, center_of_mass: [0.05, 0.0], inertia: 0.001}
  rod: {mass: 0.6, center_of_mass: [0.15, 0.0], inertia: 0.0045}
  slider: {mass: 2.0, center_of_mass: [0.02, 0.01], inertia: 0.002}
  wheel: {mass: 0.5, center_of_mass: [0.01, 0.0], inertia: 0.001}
joints:
  a: {type: revolute, parent: ground, child: crank, position: [0.0, 0.0], actuated: true}
  b: {type: revolute, parent: crank, child: rod, position: [0.1, 0.0]}
  c: {type: revolute, parent: rod, child: slider, position: [0.3, 0.0]}
  d: {type: revolute, parent: crank, child: wheel, position: [0.05, 0.0]}
cut_joints:
  slide: {type: prismatic, body_a: slider, point_a: [0.0, 0.0],
          body_b: ground, point_b: [0.0, 0.0]}
couplings:
  rack: {joints: {slide: 20.0, d: 1.5}, offset: 7.0}
"""
PRESS_SCENE = """\
mechanism: ./press.yaml
initial: {position: {a: 1.0, b: -1.3, c: 0.3, d: 0.2}, hold: [a]}
effects: {gravity: {type: gravity, acceleration: [0.0, -9.81]}}
"""


# Laws with corners, and with lists of numbers. At the start theta_1 is 1.05, theta_2 5.42 and
# theta_6 4.19 rad: beyond an upper end, between both, and below a lower one.
IN_PLANE = {
    'reached': EndStop('theta_1', 40.0, upper=0.9, damping=0.3),
    'free': EndStop('theta_2', 40.0, lower=2.0, upper=8.0),
    'below': EndStop('theta_6', 30.0, lower=4.5),
    'tendon': Tendon({'theta_1': 0.3, 'theta_3': -0.2}, (5.0, 2.0), (0.1, 0.05), (-0.1, 0.05)),
    'gas': ForceTable((0.1, 0.4, 0.7, 1.1), (5.0, 3.0, -4.0, 2.0), point_a='corner_2',
                      anchor=(0.1, 0.7), interpolation='cubic', damping=0.3),
    'hinge': ForceTable((0.0, 4.0, 7.0), (2.0, -1.0, 0.5), 'theta_2', damping=0.1),
    'drag': FluidDrag('corner_1', (0.3, 0.2), (1.0, 2.0), 0.1, 0.2, (0.5, -0.3), 0.4),
    'mount': Bushing('platform_center', None, (0.1, 0.7), (20.0, 30.0), (0.2, 0.3), 2.0, 0.1,
                     0.3, 0.2),
    'pressed': Law({'q': '-9*(q - 0.8)*on - 0.1*(1 - on)'}, joints={'q': 'theta_1'},
                   event={'on': '0.8 - q'}, energy='4.5*(q - 0.8)**2*on + 0.1*q*(1 - on)'),
    'apart': Law({'q': '-9*(q - 8)*on - 0.1*v*(1 - on)'}, joints={'q': 'theta_2'},
                 rates={'v': 'q'}, event={'on': '8 - q'})}
IN_SPACE = {
    'tendon': Tendon({'crank': 0.3, 'rocker': -0.2}, (5.0, 2.0), (0.1, 0.05), (-0.1, 0.05)),
    'gas': ForceTable((0.1, 0.4, 0.7, 1.1), (5.0, 3.0, -4.0, 2.0), point_a='rocker_end',
                      anchor=(0.1, 0.2, 0.7), interpolation='cubic', damping=0.3),
    'drag': FluidDrag('rocker_end', (0.3, 0.2, 0.1), (1.0, 2.0, 0.5), (0.1, 0.2, 0.15),
                      (0.2, 0.1, 0.3), (0.5, -0.3, 0.2), orientation=(0.1, 0.3, 0.3, 0.9)),
    'mount': Bushing('rocker_end', None, (0.1, 0.2, 0.7), (20.0, 30.0, 10.0), (0.2, 0.3, 0.1),
                     (2.0, 1.0, 0.5), (0.1, 0.2, 0.3), orientation=(0.1, 0.3, 0.3, 0.9),
                     rest_orientation=(0.1, 0.1, 0.7, 0.7))}


def simulation_of(scene, effects=(), **method):
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    scene = replace(scene, effects={**scene.effects, **dict(effects)})
    return Simulation.from_scene(scene, **method)


def torques(simulation):
    rng = np.random.default_rng(5)
    return dict(zip(simulation.actuated_joints,
                    0.3 * rng.normal(size=len(simulation.actuated_joints))))


def by_loops(scene, effects):
    """Return a simulation that uses no code generated for its mechanism."""
    with mock.patch.object(codegen, 'can_be_unrolled', lambda model: False):
        simulation = simulation_of(scene, effects, integrator='rk4')
    assert not simulation.data.system.is_unrolled
    return simulation


def twin(scene, effects, command, present):
    """Return accelerations and multipliers of changes, at the time and by loops over bodies."""
    simulation = by_loops(scene, effects)
    tau = simulation.joint_torques(command)
    state = present.data.integrated.copy()
    nq, nv = len(simulation.position), len(simulation.velocity)

    def moved(q, qd, change):
        state[:nq], state[nq:nq + nv] = q, qd + change[nv:2 * nv]
        if simulation.data.system.manifold is None:
            state[:nq] += change[:nv]
        else:
            simulation.data.system.manifold.move(state[:nq], change[:nv].copy(), 1.0)
        simulation.data.system.tau[:] = tau + change[2 * nv:]
        simulation.data.system.native.evaluate_state(state)
        return np.concatenate((simulation.data.system.qdd, simulation.data.system.lam))
    return moved


def require_derivatives(scene, effects=(), duration=0.2, step=1e-3):
    """Compare all derivatives, in a state that moves, with differences of the twin."""
    simulation = simulation_of(scene, effects, integrator='rk4', step_size=1e-3)
    command = torques(simulation)
    simulation.step(command, duration)
    q, qd, nv = simulation.position, simulation.velocity, len(simulation.velocity)
    assert np.abs(qd).max() > 1e-3
    found = Differentiator(simulation)(q, qd, command)
    dense = twin(scene, effects, command, simulation)
    np.testing.assert_allclose(
        np.concatenate((found.acceleration, found.multipliers)),
        dense(q, qd, np.zeros(3 * nv)), rtol=1e-9, atol=1e-9)
    for first, derivative in enumerate((found.by_position, found.by_velocity, found.by_torque)):
        expected = np.stack([sum(
            weight / step * (dense(q, qd, k * step * unit) - dense(q, qd, -k * step * unit))
            for k, weight in WEIGHTS) for unit in np.eye(3 * nv)[first * nv:][:nv]], axis=1)
        np.testing.assert_allclose(derivative, expected, rtol=0,
                                   atol=1e-9 * max(1.0, np.abs(expected).max()))
    return simulation, found


@pytest.mark.parametrize('scene', ('four_bar', 'three_rrr_vertical', 'slider_crank'))
def test_derivatives_in_the_plane_are_differences_of_a_dense_twin(scene):
    require_derivatives(scene)


def test_derivatives_of_effects_in_the_plane():
    points = [point.name for point in load_scene('three_rrr').mechanism.points]
    require_derivatives('three_rrr', {
        'spring': JointSpring('theta_1', 3.0, 0.2), 'damper': JointDamping('theta_2', 0.05),
        'strut': PointSpring(points[0], None, (0.1, 0.7), 20.0, 0.3, 0.1),
        'push': ExternalForce(points[1], (0.4, -0.3), 0.05, 'body')})


def test_derivatives_in_space_with_effects():
    mechanism = load_scene('rssr_four_bar').mechanism
    require_derivatives('rssr_four_bar', {
        'damper': JointDamping(mechanism.coordinates.names[0], 0.02),
        'strut': PointSpring(mechanism.points[0].name, None, (0.1, 0.2, 0.7), 20.0, 0.3, 0.1)},
        step=2e-3)


def test_derivatives_of_laws_with_corners_and_lists_of_numbers():
    simulation, _ = require_derivatives('three_rrr', IN_PLANE)
    readings = {name: simulation.effect_readings(name) for name in IN_PLANE}
    assert [readings[name]['depth'] > 0.01 for name in ('reached', 'free', 'below')] == [
        True, False, True]
    require_derivatives('rssr_four_bar', IN_SPACE, step=2e-3)


@pytest.mark.parametrize('size', [1.0, 0.04, 0.0])
def test_derivatives_of_springs_that_turn_orientations(size, tmp_path):
    (tmp_path / 'ball.yaml').write_text(BALL)
    (tmp_path / 'scene.yaml').write_text(BALL_SCENE.replace('rpy: [0.3, -0.4, 1.1]', (
        f'rpy: [{0.3 * size}, {-0.4 * size}, {1.1 * size}]')))
    spring = {'spring': JointSpring('ball', 7.0)}
    simulation, found = require_derivatives(
        tmp_path / 'scene.yaml', spring, duration=1e-3 if size else 1e-9)
    # The spring stands against turning.
    without = Differentiator(simulation_of(tmp_path / 'scene.yaml'))(
        simulation.position, simulation.velocity, torques(simulation))
    assert np.abs(found.by_position - without.by_position).max() > 1.0


def test_lists_of_numbers_that_have_changed_are_not_taken_for_the_old_ones():
    simulation = simulation_of('three_rrr', {'tendon': IN_PLANE['tendon']})
    differentiate, state = Differentiator(simulation), (simulation.position, simulation.velocity)
    before = differentiate(*state).by_position
    simulation.set_effect('tendon', stiffness=(50.0, 2.0))
    with pytest.raises(SimulationError, match='lists of numbers'):
        differentiate(*state)
    assert not np.allclose(Differentiator(simulation)(*state).by_position, before, rtol=1e-3)


def test_derivatives_of_laws_of_users():
    one, two = [point.name for point in load_scene('three_rrr').mechanism.points][:2]
    in_plane = Law(
        {'q': '-k*sin(q)*abs(v) - v**3 + 0.1*exp(-q)', 'd': 'k*atan2(d, w + 2) - log(d)',
         'y': 'min(y, 5)*c**y', 'x': '(x*x + 1)**q'},
        joints={'q': 'theta_1'}, distances={'d': (one, (0.1, 0.7))},
        components={'y': (two, 'y'), 'x': (one, 'x')}, rates={'v': 'q', 'w': 'd'},
        parameters={'k': 0.7, 'c': 1.3})
    simulation, _ = require_derivatives('three_rrr', {'it': in_plane})
    assert np.isfinite(simulation.effect_readings('it')['power'])
    mechanism = load_scene('rssr_four_bar').mechanism
    point = mechanism.points[0].name
    in_space = Law({'d': '-k*d**1.5 - w', 'z': 'hypot(z, d)'},
                   distances={'d': (point, (0.1, 0.2, 0.7))}, components={'z': (point, 'z')},
                   rates={'w': 'd'}, parameters={'k': 9.0})
    require_derivatives('rssr_four_bar', {'it': in_space}, step=2e-3)


def test_laws_of_users_whose_arithmetic_has_changed_are_differentiated_again():
    law = Law({'q': '-k*q'}, joints={'q': 'crank_joint'}, parameters={'k': 2.0})
    simulation = simulation_of('four_bar', {'it': law})
    state = simulation.position, simulation.velocity
    differentiate = Differentiator(simulation)
    before = differentiate(*state)
    simulation.set_effect('it', parameters={'k': 5.0})
    after, again = differentiate(*state), Differentiator(simulation)(*state)
    assert not np.allclose(after.by_position, before.by_position, rtol=1e-3)
    np.testing.assert_array_equal(after.by_position, again.by_position)
    simulation.set_effect('it', forces={'q': '-k*q*q'})
    with pytest.raises(SimulationError, match='other expressions'):
        differentiate(*state)


def test_forces_over_time_are_differentiated_at_their_time():
    point = load_scene('three_rrr').mechanism.points[1].name
    simulation, _ = require_derivatives('three_rrr', {
        'push': PrescribedForce('sine', point=point, direction=(0.6, 0.8), axes='body',
                                amplitude=20.0, frequency=1.0, phase=0.2),
        'turn': PrescribedForce('table', 'theta_2', times=(0.0, 0.5), values=(1.0, 3.0)),
        'law': Law({'q': '-3*q*cos(5*t)'}, joints={'q': 'theta_1'})})
    forces = [simulation.effect_readings(name)['force'] for name in ('push', 'turn')]
    assert forces == pytest.approx([20.0 * np.sin(0.4 * np.pi + 0.2), 1.8])
    differentiate = Differentiator(simulation)
    before = differentiate(simulation.position, simulation.velocity).by_position
    simulation.step(None, 0.2)
    after = differentiate(simulation.position, simulation.velocity).by_position
    again = Differentiator(simulation)(simulation.position, simulation.velocity).by_position
    np.testing.assert_array_equal(after, again)
    assert not np.allclose(after, before, rtol=1e-3)
    require_derivatives('rssr_four_bar', {'push': PrescribedForce(
        'sine', point=load_scene('rssr_four_bar').mechanism.points[0].name,
        direction=(0.6, 0.0, 0.8), amplitude=20.0, frequency=1.0)}, step=2e-3)


def test_forces_over_time_have_no_derivatives_along_a_motion():
    scene = load_scene('three_rrr')
    scene = replace(scene, effects={**scene.effects, 'turn': PrescribedForce(
        'trapezoid', 'theta_2', amplitude=1.0, rise=0.1, hold=0.1, period=1.0)})
    with pytest.raises(SimulationError, match='effects.turn .*it follows the time'):
        Sensitivity(Model(scene), {'integrator': 'rk4', 'step_size': 1e-3})
    simulation = Simulation.from_scene(scene)
    with pytest.raises(SimulationError, match='follow the time'):
        Linearisation(simulation).discrete_model(0.01)
    with pytest.raises(ValueError, match='profile over time'):
        Differentiator(simulation, ['effects.turn.period'])


def test_laws_of_users_with_states_are_refused():
    law = Law({'q': 'z'}, joints={'q': 'crank_joint'}, states={'z': '1'})
    with pytest.raises(SimulationError, match='effects.it .*states of its own'):
        Differentiator(simulation_of('four_bar', {'it': law}))


@pytest.mark.slow
def test_derivatives_with_orientations():
    simulation, _ = require_derivatives('stewart_platform', duration=0.05)
    assert simulation.data.system.manifold is not None


def test_derivatives_by_torque_solve_the_dense_equations():
    simulation, found = require_derivatives('carpet_scraper')
    inertia, jac = simulation.inertia, simulation.constraint_jacobian
    nv, nc = len(inertia), len(jac)
    system = np.block([[inertia, -jac.T], [jac, np.zeros((nc, nc))]])
    np.testing.assert_allclose(
        system @ found.by_torque, np.eye(nv + nc)[:, :nv], rtol=0, atol=1e-9)


def test_states_that_cannot_be_written_are_read():
    simulation = simulation_of('slider_crank')
    state = simulation.snapshot()
    assert not state.q.flags.writeable
    found = Differentiator(simulation)(state.q, state.qd)
    np.testing.assert_array_equal(
        found.by_position, Differentiator(simulation)(state.q.tolist(), state.qd).by_position)


def test_parameters_are_read_again():
    simulation = simulation_of('four_bar', {'damper': JointDamping('crank_joint', 0.1)})
    differentiate = Differentiator(simulation)
    state = simulation.position, simulation.velocity
    before = differentiate(*state).by_velocity
    simulation.set_effect('damper', coefficient=0.3)
    after = differentiate(*state)
    np.testing.assert_allclose(
        after.by_velocity[:, 0] - before[:, 0], -0.2 * after.by_torque[:, 0], rtol=1e-9)
    simulation.set_effect('damper', enabled=False)
    with pytest.raises(SimulationError, match='Other effects are switched on'):
        differentiate(*state)


def test_singular_positions_are_refused(tmp_path):
    (tmp_path / 'parallelogram.yaml').write_text(PARALLELOGRAM)
    (tmp_path / 'scene.yaml').write_text(PARALLELOGRAM_SCENE)
    simulation = simulation_of(tmp_path / 'scene.yaml')
    differentiate = Differentiator(simulation)
    assert np.isfinite(differentiate(simulation.position, simulation.velocity).by_position).all()
    with pytest.raises(SingularityError, match='closure equations depend on one another'):
        differentiate(np.zeros(3), np.zeros(3))


def with_open_loops(model, state, torque):
    """Return a simulation moved to a state that need not close the loops: readings take it."""
    simulation = Simulation(model)
    numbers_of_state = np.concatenate((state.q, state.qd, state.own))
    simulation.data.integrated[:len(numbers_of_state)] = numbers_of_state
    simulation.data.system.tau[:] = simulation.joint_torques(torque)
    simulation.data.touch()
    return simulation


def require_wrenches(scene, keys, effects=(), step=1e-3):
    """Compare derivatives of the wrenches in joints with differences of the dense equations."""
    simulation = simulation_of(scene, effects, integrator='rk4', step_size=1e-3)
    command = torques(simulation)
    simulation.step(command, 0.1)
    q, qd, nv = simulation.position, simulation.velocity, len(simulation.velocity)
    assert np.abs(qd).max() > 1e-3
    found = Differentiator(simulation, keys).wrenches(q, qd, command)
    cuts = tuple(cut.name for cut in simulation.mechanism.cut_joints)
    assert cuts and found.joints[-len(cuts):] == cuts
    np.testing.assert_allclose(
        found.wrench, [simulation.force(name) for name in found.joints], rtol=0,
        atol=1e-10 * np.abs(found.wrench).max())
    dense = by_loops(scene, effects)
    tau, manifold = dense.joint_torques(command), dense.data.system.manifold

    def wrenches(change):
        state = np.concatenate((q, qd + change[nv:2 * nv]))
        if manifold is None:
            state[:nv] += change[:nv]
        else:
            manifold.move(state[:len(q)], change[:nv].copy(), 1.0)
        dense.data.integrated[:] = simulation.data.integrated
        dense.data.integrated[:len(state)], dense.data.system.tau[:] = state, tau + change[2 * nv:]
        dense.data.touch()
        return np.array([dense.force(name) for name in found.joints])

    def require(derivative, function, step):
        expected = sum(weight / step * (function(k * step) - function(-k * step))
                       for k, weight in WEIGHTS)
        np.testing.assert_allclose(derivative, expected, rtol=0,
                                   atol=2e-9 * max(1.0, np.abs(expected).max()))

    parts = np.concatenate((found.by_position, found.by_velocity, found.by_torque), axis=2)
    for unit, derivative in zip(np.eye(3 * nv), np.moveaxis(parts, 2, 0)):
        require(derivative, lambda size: wrenches(size * unit), step)
    model = Model(simulation.scene)
    for place, key in enumerate(keys):
        value = numbers(simulation.scene)[key]

        def of_other(change):
            other = with_open_loops(
                model.with_parameters({key: value + change}), simulation.snapshot(), command)
            return np.array([other.force(name) for name in found.joints])
        require(found.by_parameter[:, :, place], of_other, 2e-3 * abs(value))


def test_derivatives_of_wrenches_in_the_plane():
    point = load_scene('three_rrr').mechanism.points[0].name
    require_wrenches('three_rrr', (
        'mechanism.bodies.distal_1.mass', 'mechanism.joints.theta_4.position.0',
        'mechanism.bodies.proximal_1.center_of_mass.0', 'effects.damper.coefficient'),
        {'damper': JointDamping('theta_2', 0.05),
         'push': PrescribedForce('sine', point=point, direction=(0.6, 0.8), axes='body',
                                 amplitude=20.0, frequency=1.0),
         'strut': PointSpring(point, None, (0.1, 0.7), 20.0, 0.3, 0.1)})


def test_derivatives_of_wrenches_in_space():
    # In space the origins of bodies depend on their centres of mass.
    require_wrenches('rssr_four_bar', (
        'mechanism.bodies.rod.mass', 'mechanism.bodies.crank.center_of_mass.0',
        'effects.gravity.acceleration.2'), step=2e-3)


def test_wrenches_are_complex_steps_of_newton_and_euler():
    # All joints turn: their forces are the multipliers, their moments the torques.
    simulation = simulation_of('three_rrr_vertical', {
        'damper': JointDamping('theta_2', 0.05), 'spring': JointSpring('theta_4', 3.0, 0.2)})
    mechanism, command = simulation.mechanism, torques(simulation)
    simulation.step(command, 0.1)
    state = np.concatenate((simulation.position, simulation.velocity,
                            simulation.joint_torques(command)))
    names, nv = simulation.joint_names, len(simulation.velocity)
    damped, sprung = (names.index(name) for name in ('theta_2', 'theta_4'))

    def wrenches(state):
        q, qd, tau = np.split(state, 3)
        tau = tau.copy()
        tau[damped] -= 0.05 * qd[damped]
        tau[sprung] -= 3.0 * (q[sprung] - 0.2)
        found = maximal.forward_dynamics(mechanism, q, qd, tau, solve=np.linalg.solve)
        moments = np.concatenate((tau, np.zeros(len(mechanism.cut_joints))))
        forces = np.concatenate((*(found.reactions[name] for name in names), found.lam))
        return np.column_stack((moments, forces.reshape(-1, 2)))

    found = Differentiator(simulation).wrenches(*np.split(state[:2 * nv], 2), command)
    assert found.joints == (*names, *(cut.name for cut in mechanism.cut_joints))
    assert_agree(found.wrench, wrenches(state), SOLVE)
    expected = np.stack([wrenches(state + 1e-30j * unit).imag / 1e-30
                         for unit in np.eye(3 * nv)], axis=2)
    assert_agree(np.concatenate(
        (found.by_position, found.by_velocity, found.by_torque), axis=2), expected, 1e-11)


def test_derivatives_of_wrenches_at_a_cut_joint_that_is_coupled(tmp_path):
    require_wrenches(slide_that_turns_a_wheel(tmp_path), ())


@pytest.mark.slow
def test_derivatives_of_wrenches_with_orientations():
    require_wrenches('stewart_platform', (
        'mechanism.bodies.platform.mass', 'mechanism.joints.foot_1.position.0'))


def redundant():
    return load_scene('bennett')


def coupled_at_a_cut():
    scene = load_scene('geared_five_bar')
    coupling, = scene.mechanism.couplings
    joints = {'crank_1_joint': 0.02, scene.mechanism.cut_joints[0].name: -0.04}
    return replace(scene, effects={}, initial=replace(scene.initial, hold=()), mechanism=replace(
        scene.mechanism, couplings=(replace(coupling, joints=joints),)))


def slide_that_turns_a_wheel(folder):
    """Return a scene in which a coupling acts along a cut joint."""
    (folder / 'press.yaml').write_text(PRESS)
    (folder / 'scene.yaml').write_text(PRESS_SCENE)
    return load_scene(folder / 'scene.yaml')


@pytest.mark.parametrize('scene', [redundant, coupled_at_a_cut])
def test_wrenches_that_multipliers_do_not_tell_are_refused(scene):
    simulation = Simulation.from_scene(scene())
    differentiate, state = Differentiator(simulation), (simulation.position, simulation.velocity)
    assert np.isfinite(differentiate(*state).by_torque).all()
    with pytest.raises(SimulationError, match='not unique, or couplings'):
        differentiate.wrenches(*state)


@pytest.mark.parametrize('scene, name, reason', (
    ('three_rrr_payload_friction', 'effects.gear_1', 'dry friction jumps'),
    ('rope_hoist', 'effects.rope', 'it slackens')))
def test_effects_without_derivatives_are_refused(scene, name, reason):
    with pytest.raises(SimulationError) as error:
        Differentiator(simulation_of(scene))
    assert name in str(error.value) and reason in str(error.value)


def test_every_operation_is_differentiated_as_complex_steps_tell():
    graph = ExpressionGraph()
    x, y = (graph.put(LOAD, Q, place) for place in range(2))

    def formulas(x, y, sine, cosine, root, pick, power, log, angle):
        return [x + y, x - 2.0 * y, x * y * x, y / x, -x * 3.0, sine(x * y), cosine(x / y),
                power(x * y), log(x + y), angle(y * x, x), x ** y, x ** 2.5, 1.7 ** y,
                root(x * x + y), pick(x, y), 2.0 / (x * sine(y)), x - x]

    def evaluated(values):
        known = []
        for kind, *operands in graph.operations:
            one = [known[o] if isinstance(o, int) and kind != LOAD else o for o in operands]
            known.append((
                lambda: values[one[1]], lambda: one[0] + one[1], lambda: one[0] - one[1],
                lambda: one[0] * one[1], lambda: one[0] / one[1], lambda: -one[0],
                lambda: np.sin(one[0]), lambda: np.cos(one[0]), lambda: one[0] < one[1],
                lambda: one[0] >= one[1], lambda: one[1] if one[0] else one[2],
                lambda: one[0] and one[1], lambda: np.sqrt(one[0]), lambda: np.exp(one[0]),
                lambda: np.log(one[0]), lambda: np.arctan2(*one), lambda: one[0] ** one[1])[
                    kind]())
        return known

    found = formulas(x, y, sine, cosine, square_root, lambda a, b: chosen(a < b, a * a, b),
                     exponential, logarithm, arctangent)
    seeds = {x.place: 0.7, y.place: -0.4}
    changes = differentiated(graph, found, seeds)
    weights = [0.3 + 0.1 * n for n in range(len(found))]
    reverse = gradients(graph, found, weights, [x, y])
    values = 0.8, 1.3
    known = evaluated(values)
    step = 1e-30
    exact = formulas(*(value + 1j * step * seed for value, seed in zip(values, seeds.values())),
                     np.sin, np.cos, np.sqrt, lambda a, b: a * a if a.real < b.real else b,
                     np.exp, np.log, lambda b, a: np.arctan(b / a))
    for change, value in zip(changes, exact):
        number = known[change.place] if hasattr(change, 'place') else change
        assert number == pytest.approx(value.imag / step, rel=1e-13, abs=1e-13)
    total = sum(weight * value.imag / step for weight, value in zip(weights, exact))
    assert sum(known[one.place] * seed for one, seed in zip(reverse, seeds.values())) == (
        pytest.approx(total, rel=1e-13))
