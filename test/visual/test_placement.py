# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of how bodies move, and of states in which they are where they are wanted."""

from closedloop_dynamics import Simulation
from closedloop_dynamics.mechanism.kinematics import poses_in_space
from closedloop_dynamics.visual.placement import Placement, PlacementError
import numpy as np
import pytest

# In the plane, and with quaternions in space; the end effector, which fixes all joints.
MACHINES = [('three_rrr', 'platform'), ('stewart_platform', 'platform')]


def moved(scene, duration=0.1):
    simulation = Simulation.from_scene(scene)
    simulation.step(duration=duration)
    return simulation, Placement(simulation.mechanism)


def pose_of(simulation, body):
    row = [one.name for one in simulation.mechanism.bodies].index(body)
    return poses_in_space(simulation.body_poses[row])


@pytest.mark.parametrize('scene, body', MACHINES)
def test_a_pose_and_a_velocity_lead_back_to_the_state_that_has_them(scene, body):
    simulation, placement = moved(scene)
    start = Simulation.from_scene(scene)
    found = placement.position(start.position, body, pose_of(simulation, body))
    velocity = placement.velocity(simulation.position, simulation.velocity, body)
    rates = placement.rates(found, np.zeros_like(simulation.velocity), body, velocity)
    simulation_there = Simulation.from_scene(scene)
    simulation_there.set_state(found, rates)
    np.testing.assert_allclose(
        pose_of(simulation_there, body), pose_of(simulation, body), rtol=0, atol=1e-9)
    # Differences of poses.
    np.testing.assert_allclose(placement.velocity(
        simulation_there.position, simulation_there.velocity, body), velocity, rtol=1e-7,
        atol=1e-7 * np.abs(velocity).max())


@pytest.mark.parametrize('scene, body', MACHINES)
def test_an_acceleration_is_how_the_velocity_of_a_run_changes(scene, body):
    simulation, placement = moved(scene)
    found = placement.acceleration(
        simulation.position, simulation.velocity, simulation.acceleration, body)
    before = placement.velocity(simulation.position, simulation.velocity, body)
    change = 1e-4
    simulation.step(duration=change)
    # Of the middle of the step: the mean of both ends, to second order.
    found = 0.5 * (found + placement.acceleration(
        simulation.position, simulation.velocity, simulation.acceleration, body))
    after = placement.velocity(simulation.position, simulation.velocity, body)
    assert np.abs(found).max() > 0.1
    np.testing.assert_allclose((after - before) / change, found, rtol=0,
                               atol=1e-4 * np.abs(found).max())


def test_what_the_loops_do_not_let_a_body_have_is_refused():
    simulation, placement = moved('three_rrr')
    q, pose = simulation.position, pose_of(simulation, 'platform')
    for change in (np.eye(7)[2], 5.0 * np.eye(7)[0]):
        with pytest.raises(PlacementError, match='the nearest that was found is'):
            placement.position(q, 'platform', pose + change)
    # A link that turns about a fixed point.
    with pytest.raises(PlacementError, match='this velocity'):
        placement.rates(q, simulation.velocity, 'proximal_1', np.eye(6)[0])
