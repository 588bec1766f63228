# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Accelerations at and beside singular positions, against motions in closed form."""

from dataclasses import replace
import math

from closedloop_dynamics import Method, Simulation
import hard_machines as machines
import numpy as np
import pytest

# Central differences of the eighth order: of a value's slope and bend.
SLOPE = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
BEND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
STEP = 0.02


def links(x):
    """Return the angles of coupler and rocker of the change point linkage, crank at pi + x."""
    crank, span = np.array([-math.cos(x), -math.sin(x)]), math.sqrt(17.0 + 8.0 * math.cos(x))
    along = (5.0 + span ** 2) / (2.0 * span)
    # The height of the triangle of coupler and rocker, whose sign changes where all are in line.
    height = -math.sin(0.5 * x) * math.sqrt(
        8.0 * (span - 1.0) * (3.0 + along) / (span * (5.0 + span)))
    to_pivot = (np.array([4.0, 0.0]) - crank) / span
    coupler = along * to_pivot + height * np.array([-to_pivot[1], to_pivot[0]])
    rocker = crank + coupler - np.array([4.0, 0.0])
    return np.array([math.atan2(*coupler[::-1]), math.atan2(*rocker[::-1]) % (2.0 * math.pi)])


def motion(x, rate):
    """Return coordinates, rates and accelerations of that linkage, by Lagrange's equation."""
    near = np.array([links(x + STEP * k) for k in range(-4, 5)])
    angles, slope, bend = near[4], SLOPE @ near / STEP, BEND @ near / STEP ** 2
    phi, (coupler, rocker) = math.pi + x, angles
    middle = np.array([-math.sin(phi), math.cos(phi)]) + 1.5 * slope[0] * np.array(
        [-math.sin(coupler), math.cos(coupler)])
    middle_slope = -np.array([math.cos(phi), math.sin(phi)]) + 1.5 * (
        bend[0] * np.array([-math.sin(coupler), math.cos(coupler)])
        - slope[0] ** 2 * np.array([math.cos(coupler), math.sin(coupler)]))
    inertia = 1.0 / 3.0 + 2.25 * slope[0] ** 2 + 8.0 / 3.0 * slope[1] ** 2 + 3.0 * middle @ middle
    inertia_slope = 4.5 * slope[0] * bend[0] + 16.0 / 3.0 * slope[1] * bend[1] + (
        6.0 * middle @ middle_slope)
    weight = machines.G * (
        0.5 * math.cos(phi) + 3.0 * middle[1] + 2.0 * math.cos(rocker) * slope[1])
    found = -(0.5 * inertia_slope * rate ** 2 + weight) / inertia
    along = np.array([1.0, slope[0] - 1.0, slope[1]])
    return (np.array([phi, coupler - phi, rocker]), rate * along,
            found * along + rate ** 2 * np.array([0.0, bend[0], bend[1]]))


@pytest.mark.parametrize('beside', [0.0, 1e-8, -1e-5, 1e-4, -1e-3])
def test_acceleration_beside_a_change_point_has_ten_digits(beside):
    mechanism, *_ = machines.change_point_linkage()
    q, rates, expected = motion(beside, 3.0)
    simulation = Simulation(machines.scene(mechanism, q, rates, Method()))
    assert simulation.health.near_singular
    # Rounding, divided three times by the smallest singular value 0.02 rad away.
    np.testing.assert_allclose(
        simulation.acceleration, expected, rtol=0, atol=2e-10 * np.abs(expected).max())


def test_acceleration_beside_a_change_point_after_many_turns():
    mechanism, *_ = machines.change_point_linkage()
    q, rates, expected = motion(1e-4, 3.0)
    # More than the code for several places at once takes.
    q[0] += 2.0 * math.pi * 3e5
    simulation = Simulation(machines.scene(mechanism, q, rates, Method()))
    assert simulation.health.near_singular
    # The angle has ten digits, of which small singular values take some.
    np.testing.assert_allclose(
        simulation.acceleration, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize('in_space', [False, True])
@pytest.mark.parametrize('beside', [0.0, 1e-6, -1e-3])
def test_acceleration_where_three_loops_are_flat_at_once(beside, in_space):
    mechanism, q, rates = machines.ladder(3, 0.5 * math.pi + beside, 2.0)
    simulation = Simulation(machines.scene(mechanism, q, rates, Method()) if not in_space else (
        machines.scene(machines.in_space(mechanism), q, rates, Method(),
                       machines.gravity_in_space())))
    assert simulation.health.near_singular
    # Four legs swing about their ends, three couplers go round in circles.
    turning = machines.G * (0.5 * 4.0 + 3.0) / (4.0 / 3.0 + 3.0) * math.cos(beside)
    legs = np.arange(len(q)) % 2 == 0
    np.testing.assert_allclose(
        simulation.acceleration, np.where(legs, -turning, turning), rtol=1e-10)


def test_acceleration_beside_flat_positions_in_leaps_from_one_to_the_next():
    """The links of parallelograms turn evenly: rates that the places ahead begin with hold."""
    rng, mechanism = np.random.default_rng(3), machines.ladder(3)[0]
    start = machines.ladder(3, 0.5 * math.pi, 2.0)[1:]
    simulation = Simulation(machines.scene(mechanism, *start, Method()))
    for _ in range(200):
        beside, rate = rng.choice([-1.0, 1.0], 2) * 10.0 ** rng.uniform([-9.0, -2.0], [-2.0, 1.0])
        _, q, rates = machines.ladder(3, 0.5 * math.pi + beside, rate)
        turning = machines.G * (0.5 * 4.0 + 3.0) / (4.0 / 3.0 + 3.0) * math.cos(beside)
        found, _ = simulation.forward_dynamics(q, rates)
        legs = np.arange(len(q)) % 2 == 0
        # Rounding, also of the links' centripetal accelerations.
        np.testing.assert_allclose(
            found, np.where(legs, -turning, turning), rtol=0, atol=1e-10 * (turning + rate ** 2))


def test_multipliers_beside_a_change_point_fulfil_the_equations_of_motion():
    mechanism, *_ = machines.change_point_linkage()
    for beside in (1e-2, 1e-3, 1e-5):
        q, rates, _ = motion(beside, 3.0)
        simulation = Simulation(machines.scene(mechanism, q, rates, Method()))
        free = Simulation(machines.scene(replace(mechanism, cut_joints=()), q, rates, Method()))
        needed = simulation.inertia @ (simulation.acceleration - free.acceleration)
        given = simulation.constraint_jacobian.T @ simulation.multipliers
        np.testing.assert_allclose(given, needed, rtol=0, atol=1e-8 * np.abs(needed).max())


@pytest.mark.parametrize('angle', [0.004, 0.005, 0.006])
def test_acceleration_of_steady_motion_beside_a_flat_position_is_rounding(angle):
    rng = np.random.default_rng(0)
    mechanism, q, rates = machines.ladder(1, 0.5 * math.pi + angle, 10.0)
    # Off by the rounding of states that steps have led to. In the state alone, where it is divided
    # by the angle three times, 4e-7 of the links' 100 rad/s^2 remain; around it 1e-8.
    for noise in 1e-14 * rng.standard_normal((20, 3)):
        simulation = Simulation(machines.scene(mechanism, q + noise, rates, Method(), {}))
        assert np.abs(simulation.acceleration).max() < 6e-8


def test_turning_through_flat_positions_goes_on_with_an_accuracy_near_rounding():
    mechanism, q, rates = machines.ladder(1, 0.4, 10.0)
    simulation = Simulation(machines.scene(
        mechanism, q, rates, Method(step_size=1e-3, accuracy=1e-9), {}))
    simulation.advance(np.zeros(3), 25_000)
    np.testing.assert_allclose(simulation.position - q, 25.0 * rates, rtol=0, atol=1e-8)
