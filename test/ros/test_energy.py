# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The energy account of a starved node: what is unexplained is the error of the steps, no more."""

from test.ros.test_control import FakeClock

from closedloop_dynamics import Simulation
from closedloop_dynamics.ros.simulator_node import SimulatorNode
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

# Gaps between ticks of 2 ms that a starved process sees, and how often [s].
GAPS, SHARES = (0.002, 0.004, 0.02, 0.06, 0.4), (0.7, 0.15, 0.1, 0.04, 0.01)


def drive_starved(node, rng, duration):
    """Let a node's time pass in gaps, with commands at any moment; return what it simulated."""
    node.clock = node.pacer.clock = FakeClock()
    node.mode.start()
    log, advance = [], node.simulation.advance

    def note(tau, steps):
        log.append((tau.copy(), steps))
        advance(tau, steps)
        # Computing takes time, too.
        node.clock.now += 2e-5 * steps

    node.simulation.advance = note
    while node.clock.now < 50.0 + duration:
        node.clock.now += rng.choice(GAPS, p=SHARES)
        # Late, early, twice, or not at all.
        for _ in range(rng.integers(3)):
            node.on_torque_command(Float64MultiArray(data=rng.uniform(-20.0, 20.0, 1).tolist()))
        node.tick()
    assert node.exit_code is None
    return log


def repeat(log, finer):
    """Return the energy balance of the same torques in smaller steps."""
    simulation = Simulation.from_scene(
        'carpet_scraper', integrator='rk4', step_size=0.001 / finer)
    for tau, steps in log:
        simulation.advance(tau, finer * steps)
    return simulation.energy_balance


@pytest.mark.parametrize('seed', [1])
def test_energy_unexplained_in_a_starved_run_is_truncation(make_node, seed):
    node = make_node(SimulatorNode, scene='carpet_scraper', publish_rate=500.0, integrator='rk4')
    log = drive_starved(node, np.random.default_rng(seed), 3.0)
    assert node.pacer.dropped > 0.0
    assert node.mode.left_out > 0
    balance = node.simulation.energy_balance
    # Much is moved, and the crank whirls: steps of 1 ms miss a part of it.
    assert abs(balance.work) > 1.0
    assert abs(balance.residual) > 1e-6
    # The node books what the library books for the same torques; of a method of fourth order
    # steps of a tenth leave less than a thousandth.
    assert repeat(log, 1).residual == pytest.approx(balance.residual, rel=1e-6)
    assert abs(repeat(log, 10).residual) < 1e-3 * abs(balance.residual)


def test_states_that_are_set_and_resets_are_booked_as_nobodys_energy(make_node):
    node = make_node(SimulatorNode, scene='carpet_scraper', publish_rate=500.0, step_size=1e-4)
    rng = np.random.default_rng(3)
    joints = node.simulation.joint_names
    for turn in range(3):
        drive_starved(node, rng, 0.3)
        before = node.simulation.energy_balance.residual
        position = rng.uniform(0.5, 1.0)
        node.on_set_state(JointState(
            name=[joints[0]], position=[position], velocity=[5.0]))
        assert node.counts['states set'] == turn + 1
        assert node.simulation.energy_balance.residual == pytest.approx(before, abs=1e-9)
    drive_starved(node, rng, 0.3)
    assert abs(node.simulation.energy_balance.residual) < 1e-4
