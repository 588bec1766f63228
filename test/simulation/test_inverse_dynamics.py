# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Torques for a motion: the least of many, those that effects take over, and refusals."""

from dataclasses import replace

from closedloop_dynamics import Linearisation, load_scene, Simulation, SimulationError
from closedloop_dynamics.effects.registry import JointSpring, Law
import numpy as np
import pytest

from ..reference import cases, dense
from ..reference.scenes import simulated


def built(mechanism, q, qd, **effects):
    """Return the inverse dynamics of a simulation in the earth's gravity."""
    return simulated(mechanism, q, qd, effects, dense.EARTH).data.inverse


def at_once(inverse, q, qd, qdd):
    """Return torques and multipliers by the engine alone."""
    assert inverse.find(q, qd, qdd)
    return inverse.torque, inverse.lam


def closed_motion(rng, mechanism, q, qd):
    """Return accelerations that the closures allow."""
    jac, bias = dense.closure_jacobian(mechanism, q), dense.constraint_bias(mechanism, q, qd)
    qdd = rng.normal(size=len(q))
    return qdd - np.linalg.lstsq(jac, jac @ qdd + bias, rcond=None)[0]


def needed(mechanism, q, qd, qdd):
    """Return I qdd + c by the dense twin."""
    return (dense.generalized_inertia_matrix(mechanism, q) @ qdd
            + dense.bias_force(mechanism, q, qd))


@pytest.mark.parametrize('case', ['four_bar', 'three_rrr', 'carpet_scraper'])
def test_torques_of_more_drives_than_freedoms_are_the_least(case):
    rng, mechanism, q, qd = cases.drawn(case)
    mechanism = replace(mechanism, joints=tuple(
        replace(joint, actuated=True) for joint in mechanism.joints))
    qdd = closed_motion(rng, mechanism, q, qd)
    torque, lam = built(mechanism, q, qd).solve(q, qd, qdd)
    jac, need = dense.closure_jacobian(mechanism, q), needed(mechanism, q, qd, qdd)
    np.testing.assert_allclose(torque + jac.T @ lam, need, atol=1e-10 * np.abs(need).max())
    # All joints are driven: the least torques are what no multipliers can take over.
    expected = np.linalg.lstsq(jac.T, need, rcond=None)[0]
    np.testing.assert_allclose(lam, expected, atol=1e-9 * np.abs(need).max())
    np.testing.assert_allclose(
        torque, need - jac.T @ expected, atol=1e-9 * np.abs(need).max())
    given = at_once(built(mechanism, q, qd), q, qd, qdd)
    np.testing.assert_allclose(given[0], torque, atol=1e-9 * np.abs(need).max())
    np.testing.assert_allclose(given[1], lam, atol=1e-9 * np.abs(need).max())


@pytest.mark.parametrize('drives', [1, 2])
def test_redundant_equations_take_the_least_multipliers(drives):
    scene = load_scene('bennett')
    one = Simulation(replace(scene, mechanism=replace(scene.mechanism, joints=tuple(
        replace(joint, actuated=n < drives) for n, joint in enumerate(scene.mechanism.joints)))))
    q, qd = one.position, one.velocity
    qdd, _ = one.forward_dynamics(q, qd, np.ones(drives))
    torque, lam = at_once(one.data.inverse, q, qd, qdd)
    jac, need = one.constraint_jacobian, one.data.tree_torque(q, qd, qdd)
    # One drive is all that moves the linkage; of two, what they do against each other is least.
    unknowns = np.concatenate((np.eye(len(q))[:, :drives], jac.T), axis=1)
    np.testing.assert_allclose(
        unknowns @ [*torque, *lam], need, atol=1e-12 * np.abs(need).max())
    left = need - np.pad(torque, (0, len(q) - drives))
    expected = np.linalg.lstsq(jac.T, left, rcond=1e-9)[0]
    np.testing.assert_allclose(lam, expected, atol=1e-9 * np.abs(lam).max())
    slack = np.linalg.svd(unknowns)[2][np.linalg.matrix_rank(unknowns, 1e-9):]
    assert np.abs(slack[:, :drives] @ torque).max() < 1e-9 * np.abs(need).max()


def test_a_stretched_leg_that_hangs_at_rest_needs_no_torque():
    # The drives hold a stretched leg against each other: any multiple of that adds up to nothing.
    simulation = Simulation.from_scene('three_rrr_vertical')
    rest = Linearisation(simulation).equilibrium().position
    motion = rest, np.zeros(7), np.zeros(7)
    inverse = simulation.data.inverse
    for torque, _ in (inverse.solve(*motion), at_once(inverse, *motion)):
        assert np.abs(torque).max() < 1e-6


def test_a_spring_takes_its_part_of_the_torque_over():
    rng, mechanism, q, qd = cases.drawn('four_bar')
    qdd = closed_motion(rng, mechanism, q, qd)
    alone, held = built(mechanism, q, qd).solve(q, qd, qdd)
    helped, same = built(mechanism, q, qd, spring=JointSpring(
        mechanism.actuated_joints[0], 7.0, 0.2)).solve(q, qd, qdd)
    place = mechanism.joint_names.index(mechanism.actuated_joints[0])
    assert helped[0] - alone[0] == pytest.approx(7.0 * (q[place] - 0.2), rel=1e-9)
    np.testing.assert_allclose(same, held, atol=1e-9 * np.abs(held).max())


@pytest.mark.parametrize('form', [np.array, list])
def test_effects_are_in_the_states_that_the_run_is_in(form):
    # A memory of the place, which steps evaluate between their ends, too.
    law = Law({'x': '-k*z'}, parameters={'k': 3.0}, states={'z': '5*(x - z)'},
              joints={'x': 'theta_1'})
    one = Simulation(replace(load_scene('three_rrr'), effects={'memory': law}))
    one.step([1.0, 0.5, -0.5], 0.1)
    memory = one.data.integrated[-2]
    q, qd = one.position, one.velocity
    qdd, _ = one.forward_dynamics(q, qd, [0.2, -0.1, 0.3])
    one.advance(one.joint_torques([1.0, 0.5, -0.5]), 2)
    torque, _ = one.inverse_dynamics(form(q), form(qd), form(qdd))
    expected = 0.2 + 3.0 * (one.data.integrated[-2] - memory)
    assert torque == pytest.approx([expected, -0.1, 0.3], abs=1e-12)


def test_what_the_drives_cannot_do_and_what_opens_the_loops_is_reported_with_its_size():
    rng, mechanism, q, qd = cases.drawn('three_rrr')
    idle = replace(mechanism, joints=tuple(
        replace(joint, actuated=joint.name == 'theta_1') for joint in mechanism.joints))
    qdd = closed_motion(rng, mechanism, q, qd)
    with pytest.raises(SimulationError, match=r'theta_1\) cannot produce .* N m is missing'):
        built(idle, q, qd).solve(q, qd, qdd)
    opened = qdd + 1e-3 * np.eye(len(q))[0]
    part = np.abs(dense.closure_jacobian(mechanism, q)[:, 0]).max() * 1e-3
    with pytest.raises(SimulationError, match=f'separate at {part:.3g} m/s'):
        built(mechanism, q, qd).solve(q, qd, opened)
