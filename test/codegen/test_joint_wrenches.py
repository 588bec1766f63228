# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forces in the joints: Newton and Euler hold for every body, whichever joints are cut."""

from dataclasses import replace

from closedloop_dynamics import (
    Body, CutJoint, Joint, Mechanism, Point, Simulation, SimulationError)
from closedloop_dynamics.effects.registry import (
    ExternalForce, Gravity, JointDamping, JointSpring, PointSpring, Rotor)
from closedloop_dynamics.engine.types import BODY_A, CUT_NUMBER, DOF
from closedloop_dynamics.mechanism.mechanism import GROUND, REVOLUTE
from closedloop_dynamics.simulation.recorded_run import joint_forces
from closedloop_dynamics.simulation.system import number_of_states
import numpy as np
import pytest

from .engine import Engine
from ..reference import cases
from ..reference.compare import assert_agree, IDENTITY
from ..reference.linkages import random_linkage, random_vector
from ..reference.numbers import equations, Numbers
from ..reference.scenes import simulated
from ..reference.trees import body_frames, derivative, placed, point_jacobian, turned, unit

GRAVITY = np.array([1.3, -9.0])
# Damping [N m s or N s/m], stiffness [N m/rad or N/m], inertia [kg m^2 or kg] of the first joint.
DAMPING, STIFFNESS, INERTIA = 0.7, 3.0, 0.4
FORCE = np.array([5.0, -11.0])
# Stiffness [N/m], damping [N s/m], free length [m] of a spring between two bodies.
SPRING = (40.0, 6.0, 0.3)


def cross(lever, force):
    return lever[0] * force[1] - lever[1] * force[0]


def loaded(seed):
    """Return a simulation of a random linkage with effects of every kind, and its torques."""
    rng = np.random.default_rng([71, seed])
    mechanism, q, qd = random_linkage(rng, n_subsystems=1 + seed % 3, max_cuts=1 + seed % 4,
                                      shuffle=seed % 2 == 1)
    joint = mechanism.joints[0].name
    mechanism = replace(mechanism, points=tuple(
        Point(f'on_{body.name}', body.name, random_vector(rng, 0.5))
        for body in mechanism.bodies))
    effects = {
        'gravity': Gravity(tuple(GRAVITY)), 'damper': JointDamping(joint, DAMPING),
        'spring': JointSpring(joint, STIFFNESS), 'rotor': Rotor(joint, INERTIA),
        'wind': ExternalForce(mechanism.points[0].name, tuple(FORCE)),
        'rope': PointSpring(mechanism.points[1].name, mechanism.points[2].name, None, *SPRING)}
    simulation = simulated(mechanism, q, qd, effects)
    simulation.step(rng.normal(size=len(simulation.actuated_joints)), 0.0)
    return simulation


def outside_forces(mechanism, frames, velocity):
    """Yield body, place and force of all that acts on bodies from outside the joints."""
    for body in mechanism.bodies:
        yield body.name, placed(frames[body.name], body.center_of_mass), body.mass * GRAVITY
    wind, near, far = mechanism.points[:3]
    yield wind.body, placed(frames[wind.body], wind.position), FORCE
    start, end = (placed(frames[point.body], point.position) for point in (near, far))
    length = np.linalg.norm(end - start)
    along = (end - start) / length
    stiffness, damping, free = SPRING
    pull = (stiffness * (length - free) + damping * along @ (
        velocity(far.body, far.position)[1:] - velocity(near.body, near.position)[1:])) * along
    yield near.body, start, pull
    yield far.body, end, -pull


@pytest.mark.parametrize('seed', cases.first(2, range(8)))
def test_newton_and_euler_hold_for_every_body(seed):
    simulation = loaded(seed)
    mechanism, q, qd = simulation.mechanism, simulation.position, simulation.velocity
    qdd, frames = simulation.acceleration, body_frames(simulation.mechanism, q)

    def velocity(body, point):
        return point_jacobian(mechanism, q, body, point) @ qd

    # Sums of what acts on each body, about the origin of the world.
    moment = dict.fromkeys(frames, 0.0)
    force = {name: np.zeros(2) for name in frames}

    def act(body, place, vector, couple=0.0):
        moment[body] += couple + cross(place, vector)
        force[body] += vector

    for joint, (couple, *vector) in zip(mechanism.joints, simulation.data.joint_forces):
        place, vector = frames[joint.child][0], np.array(vector)
        act(joint.child, place, vector, couple)
        act(joint.parent, place, -vector, -couple)
    for cut, (couple, *vector) in zip(mechanism.cut_joints, simulation.constraint_forces):
        place, vector = placed(frames[cut.body_a], cut.point_a), np.array(vector)
        act(cut.body_a, place, vector, couple)
        act(cut.body_b, place, -vector, -couple)
    for body, place, vector in outside_forces(mechanism, frames, velocity):
        act(body, place, vector)
    largest = max(np.abs(vector).max() for vector in force.values()) + np.abs(
        simulation.data.joint_forces).max()
    for body in mechanism.bodies:
        def rates(x, body=body):
            return point_jacobian(mechanism, x, body.name, body.center_of_mass) @ qd

        turning, *motion = (point_jacobian(mechanism, q, body.name, body.center_of_mass) @ qdd
                            + derivative(rates, q, qd))
        momentum = body.mass * np.array(motion)
        center = placed(frames[body.name], body.center_of_mass)
        np.testing.assert_allclose(force[body.name], momentum, rtol=0, atol=1e-10 * largest)
        assert moment[body.name] == pytest.approx(
            body.inertia * turning + cross(center, momentum), rel=0, abs=1e-10 * largest)


@pytest.mark.parametrize('seed', cases.first(2, range(4)))
def test_along_its_freedom_a_joint_hands_over_its_torques(seed):
    simulation = loaded(seed)
    mechanism, frames = simulation.mechanism, body_frames(
        simulation.mechanism, simulation.position)
    wrenches = simulation.data.joint_forces
    torque = simulation.effort
    torque[0] -= DAMPING * simulation.velocity[0] + STIFFNESS * simulation.position[0]
    torque[0] -= INERTIA * simulation.acceleration[0]
    for joint, (couple, *vector), expected in zip(mechanism.joints, wrenches, torque):
        along = couple if joint.type == REVOLUTE else unit(frames[joint.child][1]) @ vector
        assert along == pytest.approx(expected, rel=0, abs=1e-10 * np.abs(wrenches).max())


def four_bar(cut):
    """Return a four-bar linkage that is cut at one of its pins, and its state."""
    rng = np.random.default_rng(5)
    o, a, b, d = np.array([[0.0, 0.0], [0.2, 0.3], [0.9, 0.5], [0.7, -0.1]])
    inertia = rng.uniform(0.1, 0.5, 3)
    centers = rng.uniform(-0.2, 0.2, (3, 2)) + [(o + a) / 2, (a + b) / 2, (b + d) / 2]
    # Parents and pins from the ground around; frames parallel to the world at the start.
    trees = {
        'rocker_pin': (('crank', GROUND, o), ('coupler', 'crank', a), ('rocker', 'coupler', b)),
        'coupler_pin': (('crank', GROUND, o), ('coupler', 'crank', a), ('rocker', GROUND, d)),
        'crank_pin': (('crank', GROUND, o), ('rocker', GROUND, d), ('coupler', 'rocker', b)),
    }
    pins = {frozenset((GROUND, 'crank')): ('motor', o), frozenset(('crank', 'coupler')): (
        'crank_pin', a), frozenset(('coupler', 'rocker')): ('coupler_pin', b),
        frozenset(('rocker', GROUND)): ('rocker_pin', d)}
    tree = trees[cut]
    origin = {GROUND: o, **{child: place for child, _, place in tree}}
    joints = tuple(Joint(pins[frozenset((child, parent))][0], REVOLUTE, parent, child,
                         tuple(place - origin[parent]), 0.0, child == 'crank')
                   for child, parent, place in tree)
    bodies = tuple(Body(child, 1.0 + k, tuple(centers[k] - origin[child]), inertia[k])
                   for k, child in enumerate(('crank', 'coupler', 'rocker')))
    (open_pair,) = (names for names, pin in pins.items() if pin[0] == cut)
    first, second = sorted(open_pair)
    place = pins[open_pair][1]
    mechanism = Mechanism('loop', bodies, joints, (CutJoint(
        cut, REVOLUTE, first, second, tuple(place - origin[first]),
        tuple(place - origin[second])),))
    # Absolute rates that a crank at 2 rad/s asks for.
    right = 2.0 * turned(a - o)
    coupler, rocker = np.linalg.solve(
        np.transpose([turned(b - a), -turned(b - d)]), -right)
    rate = {GROUND: 0.0, 'crank': 2.0, 'coupler': coupler, 'rocker': rocker}
    rates = tuple(rate[child] - rate[parent] for child, parent, _ in tree)
    return simulated(mechanism, None, rates, gravity=(0.0, -9.81)), {
            joint.name: joint.child for joint in joints} | {cut: first}


def test_forces_are_the_same_whichever_joint_is_cut():
    found = []
    for cut in ('rocker_pin', 'coupler_pin', 'crank_pin'):
        simulation, on = four_bar(cut)
        simulation.step({'motor': 3.0}, 0.0)
        forces = {}
        for pin in ('motor', 'crank_pin', 'coupler_pin', 'rocker_pin'):
            # Told for the same body each time.
            body = {'motor': 'crank', 'crank_pin': 'coupler', 'coupler_pin': 'rocker',
                    'rocker_pin': 'rocker'}[pin]
            forces[pin] = simulation.force(pin) * (1.0 if on[pin] == body else -1.0)
        found.append(np.array(list(forces.values())))
    assert np.abs(found[0][:, 1:]).max() > 1.0
    np.testing.assert_allclose(found[0][:, 0], [3.0, 0.0, 0.0, 0.0], rtol=0, atol=1e-10)
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=0, atol=1e-10)


def test_a_joint_that_does_not_exist_is_named():
    with pytest.raises(SimulationError, match="no joint 'elbow'.*crank_joint.*rocker"):
        Simulation.from_scene('four_bar').force('elbow')


@pytest.mark.parametrize('case', cases.MACHINES_IN_SPACE)
def test_wrenches_in_space_are_those_of_the_recursions_on_numbers(case):
    rng, mechanism, q, qd = cases.drawn(case)
    engine = Engine(mechanism)
    model, work, numbers = engine.model, engine.work, Numbers(engine.model)
    # Loops opened, so that nothing is zero.
    q = engine.moved(q, 0.3 * rng.normal(size=engine.nv))
    numbers.move(q, qd)
    recursion, lam = numbers.recursion, rng.normal(size=engine.nc)
    qdd = rng.normal(size=engine.nv)
    torque = engine.tree_torque(q, qd, qdd)
    found, expected = np.empty((len(model.cut), 6)), np.zeros((len(model.cut), 6))
    model.cut_wrenches(work, work.body, lam, found)
    for place, a, equation in equations(recursion, model):
        expected[model.cut[a, CUT_NUMBER]] += lam[place] * np.array(equation.on_a)
    for cut, point in zip(model.cut, model.cut_point):
        # From the origin of body A to the cut point.
        lever = np.array(recursion.motion[cut[BODY_A]].frame) @ point[:3]
        wrench = expected[cut[CUT_NUMBER]]
        wrench[:3] -= np.cross(lever, wrench[3:])
    assert_agree(found, expected, IDENTITY)
    # In its own direction, a joint hands over what drives it: the torque less the cut forces'.
    state, shares = np.zeros((1, number_of_states(engine.system))), np.zeros(engine.nv)
    state[0, :len(q) + len(qd)] = *q, *qd
    wrenches = joint_forces(engine.system, np.zeros((1, engine.nv)), 1, 1, state,
                            qdd[np.newaxis], lam[np.newaxis])[0]
    for i, freedom in enumerate(model.tree[1:, DOF], start=1):
        shares[freedom] = np.dot(recursion.motion[i].axis, wrenches[freedom])
    assert_agree(numbers._own_axes(shares), torque - numbers.jacobian().T @ lam, IDENTITY)
