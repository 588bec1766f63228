# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Dry friction along sums of joint coordinates: that of one joint, rest by hand, energy, loops."""

from closedloop_dynamics.effects.registry import (
    ExternalForce, Gravity, JointFriction, TendonFriction)
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated
from ..reference import cases

# Of two slides of 1.5 and 1.25 kg.
ARMS, INVERSE = np.array([0.5, -2.0, 0.0]), np.diag([1 / 1.5, 1 / 1.25, 1 / 0.5])


def sheath(force, push=(1.0, 2.0), velocity=(0.0, 0.0, 0.0)):
    """Return the flyer, pushed in its centre, with friction along its slides."""
    return simulated(flyer(), {
        'sheath': TendonFriction({'x': 0.5, 'y': -2.0}, force),
        'push': ExternalForce('ball', push)}, [0.0, 0.0, 0.0], velocity)


@pytest.mark.parametrize('push', [0.3, 2.0])
def test_a_tendon_of_one_joint_is_its_friction(push):
    one, other = (simulated(block(2.0), {
        'friction': friction, 'push': ExternalForce('center', (push, 0.0))}, [0.1], [-0.5])
        for friction in (TendonFriction({'slide': 1.0}, 1.5), JointFriction('slide', 1.5)))
    for _ in range(8):
        one.step(duration=0.1)
        other.step(duration=0.1)
        assert np.allclose(one.position, other.position, rtol=0.0, atol=1e-12)
        assert np.allclose(one.velocity, other.velocity, rtol=0.0, atol=1e-12)
    assert one.energy_balance.dissipated == pytest.approx(
        other.energy_balance.dissipated, rel=1e-12)


@pytest.mark.parametrize('share', [0.5, 0.999, 1.001, 3.0])
def test_at_rest_it_holds_the_sum_up_to_its_limit(share):
    push = np.array([1.0, 2.0, 0.0])
    # That holds the sum: r . M^-1 (push - r F) = 0.
    needed = ARMS @ INVERSE @ push / (ARMS @ INVERSE @ ARMS)
    simulation = sheath(abs(needed) / share)
    force = np.clip(needed, -abs(needed) / share, abs(needed) / share)
    assert np.allclose(simulation.acceleration, INVERSE @ (push - ARMS * force), atol=1e-13)
    simulation.step(duration=0.3)
    sum_of_rates = ARMS @ simulation.velocity
    assert (abs(sum_of_rates) < 1e-12) == (share < 1.0)
    assert_balanced(simulation, 1e-11)


def test_it_stops_the_sum_when_the_impulse_says_and_no_other_motion():
    # The sum slows down evenly, at r . M^-1 r F, until it stands.
    velocity = np.array([1.0, -2.0, 3.0])
    simulation = sheath(0.8, (0.0, 0.0), velocity)
    stop = ARMS @ velocity / (0.8 * ARMS @ INVERSE @ ARMS)
    simulation.step(duration=0.5 * stop)
    assert ARMS @ simulation.velocity == pytest.approx(0.5 * ARMS @ velocity, rel=1e-9)
    simulation.step(duration=stop)
    left = velocity - INVERSE @ ARMS * 0.8 * stop
    assert np.allclose(simulation.velocity, left, atol=1e-9)
    assert simulation.energy_balance.dissipated == pytest.approx(
        0.8 * ARMS @ velocity * stop / 2.0, rel=1e-8)
    assert simulation.effect_readings('sheath')['force'] == pytest.approx(0.0, abs=1e-12)


def test_in_a_machine_with_loops_it_comes_to_rest_and_the_balance_closes():
    _, mechanism, q, _ = cases.drawn('three_rrr')
    first, second = mechanism.joint_names[:2]
    simulation = simulated(mechanism, {
        'gravity': Gravity((0.0, -9.81)),
        'sheath': TendonFriction({first: 1.0, second: -0.5}, 2.0),
        'brake': JointFriction(second, 1.0)}, q, step_size=1e-4)
    simulation.step(duration=0.5)
    assert simulation.energy_balance.dissipated > 0.0
    assert_balanced(simulation, 1e-7)
