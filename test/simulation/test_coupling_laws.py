# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Couplings by functions of a joint's coordinate: a follower and a bar on it that a cam lifts."""

from itertools import product

from closedloop_dynamics import load_scene, read_mechanism, SceneError, Simulation, write_scene
from closedloop_dynamics.codegen.routines import topology
from closedloop_dynamics.formats.yaml_text import mechanism_text
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from .test_derivatives import by_loops, require_derivatives, simulation_of
from ..export.test_c_source import compiled, require_same_run
from ..reference.compare import assert_agree, SOLVE
from ..reference.loop_closure import closure, coupling_errors

GRAVITY = 9.81
PLANE = """\
name: cam
parameters: {height: 0.04}
bodies:
  cam: {mass: 2.0, center_of_mass: [0.03, 0.02], inertia: 0.01}
  follower: {mass: 0.8, center_of_mass: [0.1, 0.05], inertia: 0.002}
  bar: {mass: 0.5, center_of_mass: [0.2, 0.1], inertia: 0.01}
joints:
  turn: {type: revolute, parent: ground, child: cam, position: [0.0, 0.0], actuated: true}
  lift: {type: prismatic, parent: ground, child: follower, position: [0.1, 0.2], angle: 90 deg}
  swing: {type: revolute, parent: follower, child: bar, position: [0.1, 0.0], angle: -90 deg}
couplings:
  law: {joints: {lift: 1.0}, offset: 0.3, law: LAW}
"""
# The same, with axes that are not those of the world.
SPACE = """\
name: cam
parameters: {height: 0.04}
bodies:
  cam: {mass: 2.0, center_of_mass: [0.03, 0.0, 0.02], inertia: [0.02, 0.01, 0.03]}
  follower: {mass: 0.8, center_of_mass: [0.1, 0.2, 0.0], inertia: [0.002, 0.001, 0.001]}
  bar: {mass: 0.5, center_of_mass: [0.2, 0.7, 0.1], inertia: [0.01, 0.01, 0.01]}
joints:
  turn: {type: revolute, parent: ground, child: cam, position: [0.0, 0.0, 0.0],
         axis: [0.0, -1.0, 0.0], actuated: true}
  lift: {type: prismatic, parent: ground, child: follower, position: [0.1, 0.3, 0.2],
         axis: [0.0, 0.0, 1.0]}
  swing: {type: revolute, parent: follower, child: bar, position: [0.1, 0.0, 0.0],
          axis: [0.0, -1.0, 0.0]}
couplings:
  law: {joints: {lift: 1.0}, offset: 0.3, law: LAW}
"""
MACHINES = {'plane': PLANE, 'space': SPACE}
SCENE = """\
mechanism: ./cam.yaml
initial: {position: {turn: 0.4, lift: 0.31, swing: -0.5}, hold: [turn, swing],
          velocity: {turn: 5.0, swing: 1.0}}
effects: {gravity: {type: gravity, acceleration: [0.0, UP-9.81]}}
"""
X = np.linspace(0.0, 2.0 * np.pi, 9)
ROUND = np.array([0.0, 0.01, 0.03, 0.02, 0.03, 0.01, -0.01, 0.005, 0.0])
X_OPEN = np.array([-0.5, 0.3, 1.0, 2.2, 3.0])


def written(x, values, more=''):
    return f'{{joint: turn, x: {x.tolist()}, values: {values.tolist()}{more}}}'


def polynomial(*coefficients):
    one = np.polynomial.Polynomial(coefficients)
    return tuple(one.deriv(k) for k in range(3))


def table(x, values, ends):
    spline = CubicSpline(x, values, bc_type=ends)
    if ends == 'periodic':
        return tuple(lambda a, k=k: spline(a % x[-1], k) for k in range(3))
    # Straight beyond its ends.
    inside = np.clip
    return (lambda a: spline(inside(a, x[0], x[-1])) + spline(inside(a, x[0], x[-1]), 1) * (
                a - inside(a, x[0], x[-1])),
            lambda a: spline(inside(a, x[0], x[-1]), 1),
            lambda a: spline(a, 2) * (x[0] <= a <= x[-1]))


# What is written, and the function with two derivatives.
LAWS = {
    'polynomial': ('{joint: turn, polynomial: [0.01, height/2, 0.01, -0.0005]}',
                   polynomial(0.01, 0.02, 0.01, -0.0005)),
    'periodic': (written(X, ROUND, ', period: 2*pi'), table(X, ROUND, 'periodic')),
    'table': (written(X_OPEN, ROUND[:5]), table(X_OPEN, ROUND[:5], 'natural')),
    'expression': ('{joint: turn, expression: height*(1 - cos(x)) + exp(0.1*x)/100}', (
        lambda a: 0.04 * (1.0 - np.cos(a)) + 0.01 * np.exp(0.1 * a),
        lambda a: 0.04 * np.sin(a) + 0.001 * np.exp(0.1 * a),
        lambda a: 0.04 * np.cos(a) + 0.0001 * np.exp(0.1 * a)))}


CASES = list(product(LAWS, MACHINES))


def scene_of(folder, law, machine='plane'):
    (folder / 'cam.yaml').write_text(MACHINES[machine].replace('LAW', law))
    (folder / 'scene.yaml').write_text(SCENE.replace('UP', '0.0, ' * (machine == 'space')))
    return load_scene(folder / 'scene.yaml')


def lagrange(law, q, qd, tau):
    """Return accelerations and the coupling's force, of the coordinates of cam and bar alone."""
    (a, _, b), (rate, _, turning) = q, qd
    _, f1, f2 = (one(a) for one in law)
    # The bar's centre: how it rises with its angle.
    x, y = 0.2, 0.1
    up, bent = x * np.cos(b) - y * np.sin(b), -x * np.sin(b) - y * np.cos(b)
    both, own = 0.8 + 0.5, 0.5
    matrix = np.array([[0.01 + 2.0 * (0.03 ** 2 + 0.02 ** 2) + both * f1 * f1, own * f1 * up],
                       [own * up * f1, 0.01 + own * (x * x + y * y)]])
    pull = 2.0 * GRAVITY * (0.03 * np.cos(a) - 0.02 * np.sin(a))
    right = [tau - both * f1 * f2 * rate ** 2 - own * f1 * bent * turning ** 2 - pull
             - GRAVITY * both * f1, -own * up * f2 * rate ** 2 - GRAVITY * own * up]
    cam, bar = np.linalg.solve(matrix, right)
    lift = f1 * cam + f2 * rate ** 2
    force = both * (lift + GRAVITY) + own * (up * bar + bent * turning ** 2)
    return [cam, lift, bar], force


@pytest.mark.parametrize('kind, machine', CASES)
def test_accelerations_and_forces_are_those_of_reduced_equations(kind, machine, tmp_path):
    law = LAWS[kind][1]
    scene = scene_of(tmp_path, LAWS[kind][0], machine)
    rng = np.random.default_rng(len(kind))
    for simulation in (Simulation.from_scene(scene), by_loops(scene, {})):
        for a in (-0.9, 0.4, 2.9, 5.0, 11.0):
            q = np.array([a, 0.3 + law[0](a), rng.normal()])
            qd = np.array([3.0, 3.0 * law[1](a), rng.normal()])
            simulation.set_state(q, qd)
            simulation.advance(simulation.joint_torques([0.7]), 0)
            qdd, force = lagrange(law, q, qd, 0.7)
            assert_agree(simulation.acceleration, qdd, SOLVE)
            assert simulation.coupling_forces == pytest.approx([force], rel=1e-10)
            assert closure(scene.mechanism, q[None])[0] < 1e-13


@pytest.mark.parametrize('kind, machine', CASES)
def test_energy_stays_and_the_reaction_only_passes_power_on(kind, machine, tmp_path):
    law = LAWS[kind][1]
    simulation = Simulation.from_scene(
        scene_of(tmp_path, LAWS[kind][0], machine), accuracy=1e-10)
    energy = simulation.energy
    simulation.step(duration=3.0)
    assert np.abs(simulation.velocity).max() > 0.5
    assert simulation.energy == pytest.approx(energy, abs=1e-7)
    simulation.step([0.6], duration=0.5)
    assert abs(simulation.energy_balance.residual) < 1e-7
    # What the coupling gives to follower and bar is what it takes from the cam.
    (a, *_), (rate, lifting, _) = simulation.position, simulation.velocity
    qdd, force = lagrange(law, simulation.position, simulation.velocity, 0.6)
    moved = (0.01 + 2.0 * 0.0013) * qdd[0] + 2.0 * GRAVITY * (
        0.03 * np.cos(a) - 0.02 * np.sin(a)) - 0.6
    assert moved * rate + simulation.coupling_forces[0] * lifting == pytest.approx(
        0.0, abs=1e-6 * abs(force * lifting) + 1e-7)


@pytest.mark.parametrize('kind, machine', CASES)
def test_derivatives_are_differences_of_the_loops(kind, machine, tmp_path):
    require_derivatives(scene_of(tmp_path, LAWS[kind][0], machine))


@pytest.mark.parametrize('machine', MACHINES)
def test_the_jacobian_is_made_of_differences_of_the_closure(machine, tmp_path):
    simulation = Simulation.from_scene(scene_of(tmp_path, LAWS['periodic'][0], machine))
    step = 1e-5
    for turned in (0.0, 0.9, 7.0):
        q = simulation.position + [turned, 0.0, 0.0]
        q[1] = 0.3 + LAWS['periodic'][1][0](q[0])
        simulation.set_state(q, np.zeros(3))
        found = (coupling_errors(simulation.mechanism, q + step * np.eye(3))[0]
                 - coupling_errors(simulation.mechanism, q - step * np.eye(3))[0]) / (2.0 * step)
        assert_agree(simulation.constraint_jacobian[0], found, 1e-8)


def test_a_linear_law_is_a_gear(tmp_path):
    command, found = {'turn': 0.4}, []
    for coupling in ('{joints: {lift: 1.0, turn: -0.03}, offset: 0.3}',
                     '{joints: {lift: 1.0}, offset: 0.3, law: {joint: turn, '
                     'polynomial: [0, 0.03]}}'):
        scene_of(tmp_path, '')
        (tmp_path / 'cam.yaml').write_text(PLANE.replace(
            '{joints: {lift: 1.0}, offset: 0.3, law: LAW}', coupling))
        simulation = Simulation.from_scene(
            load_scene(tmp_path / 'scene.yaml'), integrator='rk4', step_size=1e-3)
        simulation.step(command, 1.0)
        found.append((*simulation.position, *simulation.velocity, *simulation.coupling_forces))
    assert_agree(*found, 1e-13)


@compiled
@pytest.mark.parametrize('kind, machine', [
    ('periodic', 'plane'), ('table', 'space'), ('expression', 'space')])
def test_a_run_in_c_is_that_of_the_package(kind, machine, tmp_path):
    require_same_run(tmp_path, simulation_of(scene_of(tmp_path, LAWS[kind][0], machine),
                                             integrator='rk4', step_size=1e-3))


@pytest.mark.parametrize('kind', LAWS)
def test_a_law_is_written_and_read_again(kind, tmp_path):
    scene = scene_of(tmp_path, LAWS[kind][0])
    (tmp_path / 'again.yaml').write_text(mechanism_text(scene.mechanism))
    assert read_mechanism(tmp_path / 'again.yaml') == scene.mechanism
    write_scene(scene, tmp_path / 'again.yaml')
    assert load_scene(tmp_path / 'again.yaml').mechanism == scene.mechanism


@pytest.mark.parametrize('machine', MACHINES)
def test_other_numbers_of_a_law_need_no_other_code(machine, tmp_path):
    law = LAWS['expression'][0]
    one, other = (Simulation.from_scene(scene_of(tmp_path, each, machine)).data.system.model
                  for each in (law, law.replace('0.1*x', '0.3*x')))
    assert (one.cut_point != other.cut_point).any()
    assert topology(one) == topology(other)


@pytest.mark.parametrize('law, fault', {
    '{joint: turn, x: [0, 2, 1], values: [0, 1, 0]}':
        r'law.x\[2\]: expected numbers that grow \(more than 2\), got 1',
    '{joint: turn, x: [0, 1], values: [0, 1]}': 'law.x: expected 3 to 200 points, got 2',
    '{joint: turn, x: [0, 1, 2]}': 'law.values: expected 3 values, one for each x, got none',
    '{joint: turn, x: [0, 1, 2], values: [0, 1, 2], period: 2}':
        r'law.values\[2\]: expected the first value \(0\) again at the end of the period, got 2',
    '{joint: turn, x: [0, 1, 2], values: [0, 1, 0], period: 2*pi}':
        'law.x: expected numbers over one period of 6.28319, got 0 to 2',
    '{joint: turn, polynomial: [0, 1, -1], period: 1}':
        'law.polynomial: expected a polynomial whose slope is the same at both ends of its '
        'period, got 1 at 0 and -1 at 1',
    '{joint: turn, polynomial: [0, 1], period: 1}': 'polynomial whose value is the same',
    '{joint: turn, polynomial: [1]}': 'law.polynomial: expected 2 to 17 coefficients, .* got 1',
    '{joint: turn, expression: sin(y)}': "law.expression: .*the unknown name 'y'",
    '{joint: turn, expression: abs(x)}': "law.expression: .*the unknown function 'abs'",
    '{joint: turn, expression: 2*height}': 'law.expression: .*which does not name x',
    '{joint: turn}': 'law: expected one of polynomial, x with values, and expression, got none',
    '{joint: turn, polynomial: [0, 1], expression: x}': 'got polynomial and expression',
    '{joint: turn, expression: x, period: 1}': 'law.period: expected this key not beside expr',
    '{joint: lift, polynomial: [0, 1]}': 'law.joint: expected a joint without a factor',
    '{joint: other, polynomial: [0, 1]}': "law.joint: expected one of the joints .*'other'",
    '{joint: turn, lift: 1, polynomial: [0, 1]}': "law.lift: .*the unknown key 'lift'",
}.items())
def test_faults_are_named(law, fault, tmp_path):
    with pytest.raises(SceneError, match=fault):
        scene_of(tmp_path, law)


def test_two_laws_of_one_joint_are_refused(tmp_path):
    scene_of(tmp_path, LAWS['polynomial'][0])
    more = '  again: {joints: {lift: 2.0}, law: {joint: swing, polynomial: [0, 1]}}\n'
    (tmp_path / 'cam.yaml').write_text((tmp_path / 'cam.yaml').read_text() + more)
    with pytest.raises(SceneError, match='couplings.again.joints.lift: expected a joint that '
                       "follows from one law, got 'lift', which 'law' gives already"):
        load_scene(tmp_path / 'scene.yaml')
