# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of closedloop_dynamics.control.torque_laws on one joint with a plain inertia."""

from closedloop_dynamics.control.references import Reference, Wave
from closedloop_dynamics.control.torque_laws import ProportionalDerivative
import numpy as np
import pytest

INERTIA = 0.5
PERIOD = 0.005


def array(value):
    return np.array([float(value)])


def wave(amplitude=0.0, frequency=1.0, phase=0.0):
    return Wave(array(amplitude), array(frequency), array(phase))


def law(position=np.nan, velocity=0.0, motion=None, kp=0.0, kd=0.0, ki=0.0,
        feedforward=0.0, limit=np.inf):
    reference = Reference(array(position), array(velocity), motion or wave())
    return ProportionalDerivative(
        reference, array(kp), array(kd), array(ki), array(feedforward), array(limit))


def drive(controller, duration, disturbance=0.0, position=0.0):
    """Return the motion of the inertia under the controller and a constant torque."""
    position, velocity = array(position), array(0.0)
    history = []
    for index in range(round(duration / PERIOD)):
        time = 100.0 + index * PERIOD
        torque = controller.torque(time, position, velocity)
        history.append((position[0], velocity[0], torque[0]))
        velocity = velocity + PERIOD * (torque + disturbance) / INERTIA
        position = position + PERIOD * velocity
    return np.array(history)


def test_wave_rate_is_its_derivative():
    signal = wave(2.0, 0.7, 0.3)
    for time in (0.0, 0.4, 1.9):
        slope = (signal.value(time + 1e-6) - signal.value(time - 1e-6)) / 2e-6
        assert signal.rate(time) == pytest.approx(slope, rel=1e-8)


def test_reference_begins_where_the_joint_is_whatever_the_phase():
    reference = Reference(array(np.nan), array(0.5), wave(2.0, 0.7, 1.0))
    position, velocity = reference.at(0.0, array(4.0))
    assert position == 4.0
    later, _ = reference.at(1e-6, array(4.0))
    assert (later - position) / 1e-6 == pytest.approx(velocity, rel=1e-5)
    assert Reference(array(1.0), array(0.0), wave()).at(0.0, array(4.0))[0] == 1.0


def test_torque_is_the_sum_of_its_terms():
    controller = law(position=1.0, velocity=0.5, kp=10.0, kd=2.0, feedforward=3.0)
    assert controller.torque(7.0, array(0.2), array(-1.0)) == pytest.approx(
        3.0 + 10.0 * 0.8 + 2.0 * 1.5)
    assert controller.torque(9.0, array(0.2), array(-1.0)) == pytest.approx(
        3.0 + 10.0 * (1.0 + 0.5 * 2.0 - 0.2) + 2.0 * 1.5)


def test_integral_removes_the_error_of_a_position():
    held = drive(law(kp=50.0, kd=5.0, ki=100.0), 5.0, disturbance=-4.0)
    assert abs(held[-1, 0]) < 1e-6
    assert held[-1, 2] == pytest.approx(4.0, abs=1e-4)


def test_integral_removes_the_error_of_a_speed_without_kp():
    turning = drive(law(velocity=4.7124, kd=5.0, ki=20.0), 5.0, disturbance=-4.0)
    assert turning[-1, 1] == pytest.approx(4.7124, abs=1e-6)


def test_limit_holds_and_the_integral_does_not_wind_up():
    history = drive(law(position=1.0, kp=50.0, kd=20.0, ki=100.0, limit=2.0), 10.0)
    assert np.abs(history[:, 2]).max() == 2.0
    # Wound up while at the limit, it would overshoot by 0.77.
    assert history[:, 0].max() < 1.25
    assert history[-1, 0] == pytest.approx(1.0, abs=1e-3)


def test_state_from_before_the_last_one_starts_again():
    controller = law(velocity=1.0, kp=10.0, ki=5.0)
    first = controller.torque(50.0, array(2.0), array(0.0))
    controller.torque(60.0, array(2.0), array(0.0))
    assert controller.torque(1.0, array(2.0), array(0.0)) == first == 0.0
