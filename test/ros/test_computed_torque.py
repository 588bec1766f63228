# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of ComputedTorque against the simulation itself."""

from closedloop_dynamics import Simulation
from closedloop_dynamics.control.references import Reference, Wave
from closedloop_dynamics.control.torque_laws import ComputedTorque, ProportionalDerivative
import numpy as np
import pytest

CRANK_SPEED = 4.7124


class Demand:
    """A controller that asks for given accelerations."""

    def __init__(self, acceleration):
        self.acceleration = np.array(acceleration)

    def torque(self, time, position, velocity):
        return self.acceleration


def spread(value, count):
    return np.full(count, float(value))


@pytest.mark.parametrize('scene, demand', [
    ('three_rrr', [1.0, -2.0, 3.0]), ('carpet_scraper', [5.0]), ('slider_crank', [-2.0])])
def test_torques_produce_the_accelerations_asked_for(scene, demand):
    simulation = Simulation.from_scene(scene)
    count = len(demand)
    law = ComputedTorque(
        Simulation.from_scene(scene), Demand(demand), spread(0, count), spread(np.inf, count))
    torque = law.torque(0.0, simulation.position, simulation.velocity)
    acceleration, _ = simulation.forward_dynamics(
        simulation.position, simulation.velocity, torque)
    actuated = [simulation.joint_names.index(name) for name in simulation.actuated_joints]
    assert acceleration[actuated] == pytest.approx(demand, rel=1e-9)


def test_limit_and_feedforward_are_of_torques():
    simulation = Simulation.from_scene('four_bar')
    plain, shifted, limited = (
        ComputedTorque(simulation, Demand([10.0]), spread(feedforward, 1), spread(limit, 1))
        .torque(0.0, simulation.position, simulation.velocity)[0]
        for feedforward, limit in ((0.0, np.inf), (0.5, np.inf), (0.0, 1e-3)))
    assert shifted == pytest.approx(plain + 0.5)
    assert limited == 1e-3


def follow(scene, speed, kp, kd, duration, period=0.01, move=0.0):
    """Return positions and velocities of the actuated joints, driven as the nodes do it."""
    simulation = Simulation.from_scene(scene)
    count = len(simulation.actuated_joints)
    reference = Reference(spread(np.nan, count), spread(speed, count), Wave(
        spread(move, count), spread(0.25, count), np.arange(count) * 2.0))
    controller = ProportionalDerivative(
        reference, spread(kp, count), spread(kd, count), spread(0, count), spread(0, count),
        spread(np.inf, count))
    law = ComputedTorque(
        Simulation.from_scene(scene), controller, spread(0, count), spread(np.inf, count))
    actuated = [simulation.joint_names.index(name) for name in simulation.actuated_joints]
    start = simulation.position[actuated]
    history = []
    while simulation.time < duration:
        torque = law.torque(simulation.time, simulation.position, simulation.velocity)
        simulation.step(torque, period)
        target, _ = reference.at(simulation.time, start)
        history.append((simulation.position[actuated] - target, simulation.velocity[actuated]))
    errors, velocities = map(np.array, zip(*history))
    return errors, velocities


def test_crank_of_the_scraper_holds_45_rpm():
    errors, velocities = follow('carpet_scraper', CRANK_SPEED, kp=100.0, kd=20.0, duration=4.0)
    turning = velocities[200:, 0]
    assert turning.mean() == pytest.approx(CRANK_SPEED, rel=0.005)
    assert np.abs(turning - CRANK_SPEED).max() < 0.05 * CRANK_SPEED
    assert np.abs(errors[200:]).max() < 0.05


def test_platform_of_the_3_rrr_follows_a_motion():
    errors, _ = follow('three_rrr', 0.0, kp=100.0, kd=20.0, duration=4.0, move=0.15)
    assert np.abs(errors).max() < 0.02


def test_states_missed_at_the_start_do_not_spoil_what_follows():
    # The first answer of a busy machine is 0.2 s old when the second state comes.
    simulation = Simulation.from_scene('carpet_scraper')
    controller = ProportionalDerivative(
        Reference(spread(np.nan, 1), spread(CRANK_SPEED, 1), Wave(
            spread(0, 1), spread(0.25, 1), spread(0, 1))),
        spread(100, 1), spread(20, 1), spread(0, 1), spread(0, 1), spread(np.inf, 1), inertia=1.0)
    law = ComputedTorque(
        Simulation.from_scene('carpet_scraper'), controller, spread(0, 1), spread(np.inf, 1))
    simulation.step(law.torque(-0.2, simulation.position, simulation.velocity), 0.01)
    while simulation.time < 2.0:
        simulation.step(
            law.torque(simulation.time, simulation.position, simulation.velocity), 0.01)
        assert abs(simulation.velocity[0]) < 2.0 * CRANK_SPEED
