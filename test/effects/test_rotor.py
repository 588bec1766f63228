# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Inertia of rotors behind gears."""

from closedloop_dynamics import Body, CutJoint, Joint, Mechanism
from closedloop_dynamics.effects.registry import Gravity, JointDamping, Payload, Rotor
from closedloop_dynamics.engine.types import WRITTEN
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.simulation.system import link_evaluation, with_equations
import numpy as np
import pytest

from .machines import assert_balanced, block, pendulum, simulated
from ..reference import cases
from ..reference.compare import assert_agree
from ..reference.formulations import dense_dynamics, FORMULATIONS

EARTH = Gravity((0.0, -9.81))


@pytest.mark.parametrize('mechanism, own', [(block(2.0), 2.0), (pendulum(), 0.5)])
def test_the_reflected_inertia_slows_the_joint(mechanism, own):
    simulation = simulated(mechanism, {'motor': Rotor(mechanism.joint_names[0], 0.01, 20.0)},
                           [0.0], [3.0])
    simulation.step([6.0])
    assert simulation.acceleration[0] == pytest.approx(6.0 / (own + 4.0), rel=1e-14)
    simulation.reset()
    assert simulation.energy == pytest.approx(0.5 * (own + 4.0) * 9.0, rel=1e-14)


@pytest.mark.parametrize('case', cases.SHIPPED)
def test_rotors_add_to_the_diagonal_of_the_inertia(case):
    """Rotors at every joint, against the equations of motion with the sum written out."""
    _, mechanism, q, qd = cases.drawn(case)
    rng = np.random.default_rng(4)
    inertia = rng.uniform(0.01, 0.1, len(q))
    effects = {'gravity': EARTH, **{f'motor_{joint}': Rotor(joint, float(value), 2.0)
                                    for joint, value in zip(mechanism.joint_names, inertia)}}
    simulation = simulated(mechanism, effects, q, qd)
    bare = simulated(mechanism, {'gravity': EARTH}, q, qd)
    qdd, lam = simulation.forward_dynamics(q, qd)
    # Without rotors it moves the same way if their torques are taken from its joints.
    jac, gim = bare.constraint_jacobian, bare.inertia
    free, bare_lam = bare.forward_dynamics(q, qd)
    left = gim @ (qdd - free) + 4.0 * inertia * qdd - jac.T @ (lam - bare_lam)
    scale = np.abs(gim @ qdd).max() + np.abs(jac.T @ lam).max()
    assert np.abs(left).max() < 1e-11 * scale


@pytest.mark.slow
def test_rotors_in_every_freedom_add_to_the_diagonal_of_the_inertia():
    """Where the turning of their carriers does not count, in balls and universal joints, too."""
    bodies = tuple(Body(f'b{k}', 1.0 + k, (0.1, 0.2, 0.3), (0.1, 0.2, 0.25, 0.01, 0.02, 0.0))
                   for k in range(3))
    mechanism = Mechanism('tree', bodies, (
        Joint('drift', 'free', 'ground', 'b0', (0.0, 0.0, 1.0)),
        Joint('cross', 'universal', 'b0', 'b1', (0.1, 0.0, 0.0), axis=(1.0, 0.0, 0.0),
              second_axis=(0.0, 1.0, 0.0)),
        Joint('socket', 'spherical', 'b1', 'b2', (0.0, 0.3, 0.0),
              orientation=(0.5, 0.5, 0.5, 0.5))), ())
    rng = np.random.default_rng(6)
    names = mechanism.coordinates.names
    inertia, qd = np.repeat(rng.uniform(0.1, 1.0, 7), (1, 1, 1, 3, 1, 1, 3)), rng.normal(size=11)
    q = np.array([0.1, 0.2, 0.3, 0.5, -0.5, 0.5, 0.5, 0.3, 0.4, 0.1, 0.1, 0.7, 0.7])
    effects = {'gravity': Gravity((0.0, 0.0, -9.81)), **{
        f'motor_{k}': Rotor(name, float(inertia[first]) / 1e24, 1e12) for k, (name, first) in
        enumerate(zip((*names[:3], 'drift', *names[6:8], 'socket'), (0, 1, 2, 3, 6, 7, 8)))}}
    simulation = simulated(mechanism, effects, q, qd, integrator='dop853', tolerance=1e-11)
    bare = simulated(mechanism, {'gravity': effects['gravity']}, q, qd)
    qdd, free = (one.acceleration for one in (simulation, bare))
    gim = bare.inertia
    np.testing.assert_allclose(gim @ (qdd - free), -inertia * qdd, rtol=0.0,
                               atol=1e-12 * np.abs(gim @ qdd).max())
    simulation.step(duration=0.3)
    assert_balanced(simulation, 1e-8)
    with pytest.raises(FieldError, match='socket'):
        Rotor('socket', 0.1, 2.0).fit(mechanism)


@pytest.mark.parametrize('formulation', FORMULATIONS)
def test_dense_formulations_know_rotors(formulation):
    _, mechanism, q, qd = cases.drawn('slider_crank')
    effects = {'gravity': EARTH, 'motor': Rotor('crank_joint', 0.001, 5.0),
               'screw': Rotor('slider_joint', 1e-4, 30.0)}
    one = simulated(mechanism, effects, q, qd)
    for found, expected in zip((one.acceleration, one.multipliers),
                               dense_dynamics(one, formulation)):
        assert np.allclose(found, expected, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize('others', [{}, {'damping': JointDamping('slider_joint', 0.3)}])
def test_a_rotor_in_another_joint_leaves_multipliers_to_one_routine(others):
    _, mechanism, q, qd = cases.drawn('slider_crank')
    moved, there = (simulated(mechanism, {
        'gravity': EARTH, 'motor': Rotor(joint, 0.01, 5.0), **others}, q, qd)
        for joint in ('crank_joint', 'rod_joint'))
    for one in moved, there:
        link_evaluation(one.data.system)
    moved.set_effect('motor', joint='rod_joint')
    for one in moved, there:
        one.data.system.native.evaluate_state(one.data.integrated)
        # In parts it would say that others can go on from its results.
        assert one.data.system.work.health[WRITTEN] == 0.0
    for name in ('qdd', 'lam'):
        assert_agree(*(getattr(one.data.system, name) for one in (moved, there)), 1e-12)


def test_rotors_keep_the_energy():
    _, mechanism, q, qd = cases.drawn('slider_crank')
    simulation = simulated(mechanism, {
        'gravity': EARTH, 'motor': Rotor('crank_joint', 0.001, 5.0),
        'screw': Rotor('slider_joint', 1e-4, 30.0)}, q, qd, step_size=5e-4)
    simulation.step(duration=1.0)
    assert_balanced(simulation, 1e-7 * max(1.0, simulation.energy_balance.kinetic))


def test_rotors_in_a_leg_leave_its_loop_to_the_elimination():
    # A four-bar on a turntable. With this inertia at its hip the rod alone moves in one direction.
    y, masses = (0.0, 1.0, 0.0), ((0.02, 0.0, 0.01), (1e-4, 2e-4, 1e-4))
    names, carriers = ('crank', 'rod', 'rocker'), ('table', 'crank', 'table')
    places = (0.0, 0.0, 0.0), (0.05, 0.0, 0.14), (0.3, 0.0, 0.0)
    mechanism = Mechanism(
        'leg', tuple(Body(name, 0.1, *masses) for name in ('table', *names)),
        (Joint('turn', 'revolute', 'ground', 'table', (0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0)),
         *(Joint(*one, axis=y) for one in zip(
             ('hip', 'knee', 'pivot'), 3 * ('revolute',), carriers, names, places))),
        (CutJoint('pin', 'revolute', 'rod', 'rocker', (0.28, 0.0, 0.11), (0.03, 0.0, 0.25),
                  axis_a=y, axis_b=y),))
    one = simulated(mechanism, {'gravity': Gravity((0.0, 0.0, -9.81)), 'hip': Rotor('hip', 5.0),
                                'pivot': Rotor('pivot', 5.0)}, 4 * [0.0], [2.0, 0.0, 0.0, 0.0])
    system = one.data.system
    assert system.native.is_regular(one.position, one.velocity)
    # By loops over bodies, which refine what the same elimination without this leaves.
    loops = with_equations(system, system.model)
    loops.native.evaluate_state(one.data.integrated)
    expected = loops.qdd.copy(), loops.lam.copy()
    system.native.evaluate_state(one.data.integrated)
    assert_agree(system.qdd, expected[0], 1e-11)
    assert_agree(system.lam, expected[1], 1e-11)
    one.step(duration=0.5)
    assert_balanced(one, 1e-7)


def test_a_payload_is_the_same_as_a_heavier_body():
    payload = Payload('rod', 1.0, (0.2, 0.1), 0.05)
    simulation = simulated(pendulum(), {'gravity': EARTH, 'part': payload}, [0.3], [1.0])
    inertia = 0.5 + 0.05 + 0.05
    moment = 2.0 * 0.5 * np.cos(0.3) + 0.2 * np.cos(0.3) - 0.1 * np.sin(0.3)
    assert simulation.acceleration[0] == pytest.approx(-9.81 * moment / inertia, rel=1e-13)
    assert simulation.energy_balance.kinetic == pytest.approx(0.5 * inertia, rel=1e-13)
