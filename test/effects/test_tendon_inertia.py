# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Inertia along sums of joint coordinates: that of one joint, an inertia matrix, loops, energy."""

from closedloop_dynamics.effects.registry import (
    ExternalForce, Gravity, Rotor, TendonFriction, TendonInertia)
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated
from ..reference import cases

ARMS = np.array([0.5, -2.0, 0.3])
NAMES = 'x', 'y', 'turn'


def test_the_inertia_matrix_has_that_of_each_tendon_beside_its_own():
    rate, other = np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, -4.0])
    simulation = simulated(flyer(), {
        'motor': TendonInertia(dict(zip(NAMES, ARMS)), 0.7),
        'weight': TendonInertia(dict(zip(NAMES, other)), 2e3),
        'push': ExternalForce('ball', (1.0, 2.0), 0.5)}, [0.0, 0.0, 0.0], rate)
    inertia = (np.diag([1.5, 1.25, 0.5]) + 0.7 * np.outer(ARMS, ARMS)
               + 2e3 * np.outer(other, other))
    acceleration = np.linalg.solve(inertia, [1.0, 2.0, 0.5])
    assert np.allclose(simulation.acceleration, acceleration, rtol=1e-12)
    assert simulation.energy_balance.kinetic == pytest.approx(
        0.5 * rate @ inertia @ rate, rel=1e-13)
    assert simulation.effect_readings('motor')['force'] == pytest.approx(
        -0.7 * ARMS @ acceleration, rel=1e-12)
    # The turn has no drive: its own acceleration follows.
    wanted = np.array([0.3, -0.2, 0.0])
    wanted[2] = (0.5 - inertia[2] @ wanted) / inertia[2, 2]
    torque, _ = simulation.inverse_dynamics(simulation.position, rate, wanted)
    assert np.allclose(torque, (inertia @ wanted)[:2] - (1.0, 2.0), rtol=1e-11)


@pytest.mark.parametrize('case', ['three_rrr', 'slider_crank'])
def test_along_one_joint_of_a_loop_it_is_a_rotor(case):
    _, mechanism, q, qd = cases.drawn(case)
    name = mechanism.joint_names[0]
    one, other = (simulated(mechanism, {'gravity': Gravity((0.0, -9.81)), 'motor': motor}, q, qd)
                  for motor in (TendonInertia({name: 2.0}, 0.05), Rotor(name, 0.05, 2.0)))
    assert np.allclose(one.acceleration, other.acceleration, rtol=1e-9, atol=1e-11)
    assert one.energy_balance.kinetic == pytest.approx(other.energy_balance.kinetic, rel=1e-12)
    for simulation in (one, other):
        simulation.step(duration=0.2)
    assert np.allclose(one.position, other.position, rtol=0.0, atol=1e-8)


def test_the_energy_is_kept_in_a_machine_with_loops():
    _, mechanism, q, qd = cases.drawn('three_rrr')
    arms = dict(zip(mechanism.joint_names, (1.0, -1.0, 0.5)))
    simulation = simulated(mechanism, {
        'gravity': Gravity((0.0, -9.81)), 'motor': TendonInertia(arms, 0.3)}, q, 0.3 * qd,
        step_size=5e-4)
    simulation.step(duration=0.5)
    assert simulation.effect_readings('motor')['kinetic_energy'] > 0.0
    assert_balanced(simulation, 1e-7 * max(1.0, simulation.energy_balance.kinetic))


def test_beside_friction_at_rest_nothing_of_it_acts():
    simulation = simulated(block(2.0), {
        'motor': TendonInertia({'slide': 1.0}, 3.0), 'sheath': TendonFriction({'slide': 1.0}, 1.0),
        'push': ExternalForce('center', (0.9, 0.0))}, [0.0])
    assert abs(simulation.acceleration[0]) < 1e-15
    simulation.set_effect('push', force=(2.0, 0.0))
    assert simulation.acceleration[0] == pytest.approx(1.0 / 5.0, rel=1e-13)
