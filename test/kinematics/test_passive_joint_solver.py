# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Whole positions from measured joints: those of a simulated motion, and what is refused."""

import math

from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.kinematics.passive_joint_solver import (
    PassiveJointError, PassiveJointSolver)
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
import pytest


def places_of(simulation, names):
    rates = [simulation.joint_names.index(name) for name in names]
    return np.array(simulation.coordinates.place)[rates], rates


# Driven joints; a passive one that is measured instead; in space, with a ball that is held.
@pytest.mark.parametrize('scene, measured', [
    ('four_bar', ['crank_joint']), ('four_bar', ['coupler_joint']),
    ('three_rrr_horizontal', ['theta_1', 'theta_6', 'theta_7']),
    ('delta_robot', ['hip_1', 'hip_2', 'hip_3']), ('bennett', ['joint_1'])])
def test_simulated_motion_is_met(scene, measured):
    simulation = Simulation.from_scene(scene)
    places, rates = places_of(simulation, measured)
    completion = PassiveJointSolver(simulation.mechanism, measured, simulation.position)
    rng = np.random.default_rng(5)
    torque = rng.uniform(-0.5, 0.5, len(simulation.actuated_joints))
    for _ in range(40):
        simulation.step(torque, 0.005)
        completion.complete(simulation.position[places], simulation.velocity[rates])
        # The run itself is closed to 1e-12.
        np.testing.assert_allclose(completion.position, simulation.position, atol=3e-10)
        np.testing.assert_allclose(completion.velocity, simulation.velocity, atol=3e-9)
        # Motions without a number that is measured, such as the spin of a rod, stay out of it.
        jac, error = equations_at(simulation.mechanism, completion.position)
        assert np.abs(jac @ completion.velocity).max() < 1e-11 and error < 1e-12
        assert completion.residual < 1e-12 and not completion.passed
    assert np.abs(simulation.velocity).max() > 0.01


def equations_at(mechanism, q):
    """Return J and the largest closure error."""
    equations = Geometry(mechanism).equations.move(q)
    return equations.jacobian(), equations.closure_error()


def test_contradicting_sensors_are_balanced_by_their_weights():
    simulation = Simulation.from_scene('three_rrr_horizontal')
    names = ['theta_1', 'theta_6', 'theta_7', 'theta_2', 'theta_4']
    places, _ = places_of(simulation, names)
    weights = np.array([4.0, 1.0, 1.0, 9.0, 0.5])
    completion = PassiveJointSolver(simulation.mechanism, names, simulation.position, weights)
    rng = np.random.default_rng(3)
    exact = simulation.position[places]
    completion.complete(exact)
    assert completion.residual < 1e-12
    for _ in range(5):
        noisy = exact + rng.normal(0.0, 0.01, len(names))
        completion.complete(noisy)
        q = completion.position
        jac, _ = equations_at(simulation.mechanism, q)
        # Where the sum of weighted squares is least, its gradient is a sum of closures'.
        gradient = np.zeros(len(q))
        gradient[places] = weights * (noisy - q[places])
        parts, *_ = np.linalg.lstsq(jac.T, gradient, rcond=None)
        np.testing.assert_allclose(jac.T @ parts, gradient, atol=1e-9)
        assert 1e-4 < completion.residual < 0.05
        assert np.abs(gradient).max() > 1e-3


def test_angles_may_differ_by_turns_and_ways_are_followed_in_pieces():
    simulation = Simulation.from_scene('four_bar')
    places, _ = places_of(simulation, ['crank_joint'])
    completion = PassiveJointSolver(simulation.mechanism, ['crank_joint'], simulation.position)
    begin, = simulation.position[places]
    completion.complete([begin + 3.0 + 4.0 * math.pi])
    # The same, taken slowly.
    slow = PassiveJointSolver(simulation.mechanism, ['crank_joint'], simulation.position)
    for part in np.linspace(0.0, 1.0, 100):
        slow.complete([begin + 3.0 * part])
    np.testing.assert_allclose(completion.position, slow.position, atol=1e-11)
    assert not completion.passed


def test_what_no_position_of_the_mechanism_has_is_refused_and_the_last_one_kept():
    simulation = Simulation.from_scene('four_bar')
    places, _ = places_of(simulation, ['rocker_joint'])
    completion = PassiveJointSolver(simulation.mechanism, ['rocker_joint'], simulation.position)
    begin, = simulation.position[places]
    completion.complete([begin + 0.01])
    kept, sines = completion.position.copy(), []
    # The rocker swings between two limits, at which the measured joint tells nothing.
    with pytest.raises(PassiveJointError, match='no position that closes the loops'):
        for k in range(400):
            completion.complete([begin + 0.01 * k])
            kept = completion.position.copy()
            sines.append(completion.sine)
    np.testing.assert_array_equal(completion.position, kept)
    assert min(sines) < 0.5 * sines[0]
    # The mechanism may have gone on the other way from there: that is reported, and this way kept.
    assert completion.passed
    completion.complete([begin])
    np.testing.assert_allclose(completion.position, simulation.position, atol=1e-10)


def test_singular_position_that_is_passed_is_reported():
    simulation = Simulation.from_scene('three_rrr')
    names = ['theta_1', 'theta_6', 'theta_7']
    places, _ = places_of(simulation, names)
    completion, sines = PassiveJointSolver(simulation.mechanism, names, simulation.position), []
    # Under its weight alone it falls through positions in which locked drives would not hold it.
    for _ in range(200):
        simulation.step(None, 0.005)
        try:
            completion.complete(simulation.position[places])
        except PassiveJointError:
            break
        apart = np.abs(simulation.coordinates.apart(
            completion.position, simulation.position)).max()
        sines.append(completion.sine)
        if completion.passed:
            break
        # Never on another branch without a word.
        assert apart < 1e-6
    assert min(sines) < 0.1


@pytest.mark.parametrize('measured, weights, problem', [
    (['cut_1'], None, 'measured: expected different ones of'), ([], None, 'got none'),
    (['theta_1', 'theta_1', 'theta_6'], None, 'different ones'),
    (['theta_1', 'theta_6'], None, 'leave 1 of 3 degrees of freedom open'),
    (['theta_1', 'theta_6', 'theta_7'], [1.0, 0.0, 1.0], 'positive numbers'),
    (['theta_1', 'theta_6', 'theta_7'], [1.0], 'expected 3 positive')])
def test_measurements_that_do_not_do_are_refused(measured, weights, problem):
    simulation = Simulation.from_scene('three_rrr')
    with pytest.raises(ValueError, match=problem):
        PassiveJointSolver(simulation.mechanism, measured, simulation.position, weights)


@pytest.mark.parametrize('values', [[math.nan], [math.inf], [], [1.0, 2.0]])
def test_other_than_finite_numbers_are_refused(values):
    simulation = Simulation.from_scene('four_bar')
    completion = PassiveJointSolver(simulation.mechanism, ['crank_joint'], simulation.position)
    with pytest.raises(ValueError, match='expected 1 finite'):
        completion.complete(values)


def test_velocities_beyond_all_bounds_are_refused():
    simulation = Simulation.from_scene('four_bar')
    completion = PassiveJointSolver(simulation.mechanism, ['crank_joint'], simulation.position)
    places, _ = places_of(simulation, ['crank_joint'])
    with pytest.raises(PassiveJointError, match='beyond all bounds'):
        completion.complete(simulation.position[places] + 0.01, [1.7e308])
    np.testing.assert_array_equal(completion.position, simulation.position)
    assert not completion.velocity.any()


def test_a_slide_that_jumps_is_refused():
    simulation = Simulation.from_scene('slider_crank')
    completion = PassiveJointSolver(simulation.mechanism, ['slider_joint'], simulation.position)
    with pytest.raises(PassiveJointError, match='moved by 1e\\+03 rad or m at once'):
        completion.complete([1e3 + simulation.position[2]])
