# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Viscous damping in a joint."""

from closedloop_dynamics.effects.joint_damping import JointDamping
import numpy as np
import pytest

from .machines import assert_balanced, block, simulated


def test_rate_decays_exponentially_and_the_energy_is_dissipated():
    simulation = simulated(
        block(2.0), {'oil': JointDamping('slide', 3.0)}, [0.0], [4.0], step_size=1e-3)
    simulation.step(duration=1.0)
    assert simulation.velocity[0] == pytest.approx(4.0 * np.exp(-1.5), rel=1e-11)
    assert simulation.position[0] == pytest.approx(8.0 / 3.0 * (1.0 - np.exp(-1.5)), rel=1e-11)
    assert simulation.energy_balance.dissipated == pytest.approx(
        16.0 * (1.0 - np.exp(-3.0)), rel=1e-10)
    assert_balanced(simulation, 1e-11)
    assert simulation.effect_readings('oil')['torque'] == -3.0 * simulation.velocity[0]
