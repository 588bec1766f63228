# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tendons over joints: forces by hand, a virtual work, closed forms, energy."""

from closedloop_dynamics.effects.registry import EndStop, JointDamping, JointSpring, Tendon
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated


def test_a_tendon_of_one_joint_is_its_spring_and_damper():
    one, other = (simulated(block(2.0), effects, [0.3], [0.7]) for effects in (
        {'tendon': Tendon({'slide': 1.0}, 50.0, 3.0, 0.1)},
        {'spring': JointSpring('slide', 50.0, 0.1), 'damper': JointDamping('slide', 3.0)}))
    for _ in range(3):
        assert np.allclose(one.acceleration, other.acceleration, rtol=1e-13)
        assert one.energy_balance.stored == pytest.approx(other.energy_balance.stored, rel=1e-13)
        assert one.energy_balance.dissipated == pytest.approx(
            other.energy_balance.dissipated, rel=1e-12, abs=1e-14)
        one.step(duration=0.1)
        other.step(duration=0.1)


@pytest.mark.parametrize('length', [-0.7, -0.2, 0.1, 0.4])
def test_joint_torques_are_the_arms_times_a_polynomial_tension(length):
    stiffness, damping, rest = (20.0, -8.0, 30.0), (2.0, 0.5, 0.25), (-0.3, 0.2)
    # Two slides and a turn of 1.5 kg, 1.25 kg and 0.5 kg m^2.
    arms, inertia = np.array([0.5, -2.0, 0.3]), np.array([1.5, 1.25, 0.5])
    q = arms * length / (arms @ arms)
    qd = np.array([0.2, 0.4, -1.0])
    simulation = simulated(flyer(), {'tendon': Tendon(
        dict(zip(('x', 'y', 'turn'), arms)), stiffness, damping, rest)}, q, qd)
    stretch, rate = length - np.clip(length, *rest), arms @ qd
    tension = (stretch * (20.0 - 8.0 * stretch + 30.0 * stretch ** 2)
               + rate * (2.0 + 0.5 * abs(rate) + 0.25 * rate ** 2))
    assert np.allclose(simulation.acceleration, -arms * tension / inertia, rtol=1e-12)
    readings = simulation.effect_readings('tendon')
    assert readings['tension'] == pytest.approx(tension, rel=1e-13)
    assert readings['length'] == pytest.approx(length, rel=1e-13)
    assert simulation.energy_balance.stored == pytest.approx(
        10.0 * stretch ** 2 - 8.0 / 3.0 * stretch ** 3 + 7.5 * stretch ** 4, rel=1e-12, abs=1e-15)


def test_the_balance_closes_and_the_joints_stay_in_proportion():
    arms = {'x': 0.5, 'y': -2.0}
    simulation = simulated(flyer(), {'tendon': Tendon(arms, (30.0, 5.0, 9.0), (0.2, 0.1))},
                           [0.4, -0.3, 0.0], [0.0, 0.0, 1.0], step_size=1e-4)
    simulation.step(duration=1.0)
    moved = simulation.position[:2] - (0.4, -0.3)
    # By the same impulse along the arms.
    assert moved[0] * 1.5 / 0.5 == pytest.approx(moved[1] * 1.25 / -2.0, rel=1e-9)
    assert simulation.energy_balance.dissipated > 0.1
    assert_balanced(simulation, 1e-10)


def test_a_range_of_rest_is_an_end_stop_at_both_ends():
    for start in (-0.25, 0.0, 0.35):
        one, other = (simulated(block(), {'stop': stop}, [start], integrator='auto') for stop in (
            Tendon({'slide': 1.0}, 1e3, rest=(-0.2, 0.3)), EndStop('slide', 1e3, -0.2, 0.3)))
        assert one.acceleration[0] == pytest.approx(other.acceleration[0], rel=1e-12)
        for simulation in (one, other):
            simulation.step([20.0], 1.0)
        # Steps end where it begins to pull.
        assert one.stepping.run.steps.accepted == other.stepping.run.steps.accepted
        assert one.position[0] == pytest.approx(other.position[0], abs=1e-12)
