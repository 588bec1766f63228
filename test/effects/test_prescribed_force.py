# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Torques and forces over time: known motions, corners met by every method, work."""

import math

from closedloop_dynamics import load_scene, SceneError
from closedloop_dynamics.effects.registry import Gravity, JointSpring, PrescribedForce
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from .machines import assert_balanced, block, flyer, pendulum, simulated

EARTH = Gravity((0.0, -9.81))
PULSE = PrescribedForce('trapezoid', 'slide', amplitude=3.0, start=0.1234, rise=0.0, hold=0.5111)
# Corners everywhere but on the output grid.
CORNERS = PrescribedForce('table', 'slide', times=(0.05, 0.11, 0.333, 0.3339, 0.7777),
                          values=(1.0, -2.0, 5.0, -5.0, 0.5))


def position_under(force, mass, end):
    """Return where a block is that a piecewise linear force has pushed from rest."""
    times = np.unique(np.concatenate(([0.0, end], [t for t in force.times if t < end])))
    x, v = 0.0, 0.0
    for start, stop in zip(times, times[1:]):
        one, other = np.interp([start, stop], force.times, force.values) / mass
        h = stop - start
        x, v = x + v * h + h * h * (2.0 * one + other) / 6.0, v + h * (one + other) / 2.0
    return x


def test_a_jump_within_a_step_leaves_no_error():
    simulation = simulated(block(2.0), {'push': PULSE}, [0.0], step_size=0.01)
    simulation.step(duration=1.0)
    rate = 1.5 * 0.5111
    assert simulation.velocity[0] == pytest.approx(rate, abs=1e-13)
    assert simulation.position[0] == pytest.approx(
        0.5 * rate * 0.5111 + rate * (1.0 - 0.1234 - 0.5111), abs=1e-13)
    assert_balanced(simulation, 1e-12)


@pytest.mark.parametrize('method', [
    {'integrator': 'rk4', 'step_size': 0.01}, {'integrator': 'auto', 'step_size': 0.01},
    # Its Jacobian by differences has an error that a smaller tolerance makes count for less.
    pytest.param({'integrator': 'rodas4', 'step_size': 0.3, 'tolerance': 1e-9},
                 marks=pytest.mark.slow),
    pytest.param({'integrator': 'dopri5', 'step_size': 0.3}, marks=pytest.mark.slow),
    pytest.param({'integrator': 'rodas4_fixed', 'step_size': 0.01}, marks=pytest.mark.slow)])
def test_corners_are_met_by_every_method(method):
    # The position is a cubic between corners: every method of order 3 is exact.
    simulation = simulated(block(2.0), {'push': CORNERS}, [0.0], **method)
    simulation.step(duration=0.9)
    assert simulation.position[0] == pytest.approx(position_under(CORNERS, 2.0, 0.9), abs=1e-13)
    assert_balanced(simulation, 1e-12)


def test_a_run_in_portions_is_the_same_to_the_last_bit():
    whole, parts = (simulated(block(2.0), {'push': CORNERS}, [0.0], step_size=0.01,
                              integrator='auto') for _ in range(2))
    whole.step(duration=0.9)
    for _ in range(90):
        parts.step()
    assert np.array_equal(whole.position, parts.position)


def test_a_sine_in_a_joint_moves_a_block_on_a_spring():
    frequency, phase, k, m = 3.0, 0.4, 50.0, 2.0
    w = 2.0 * math.pi * frequency
    simulation = simulated(
        block(m), {'spring': JointSpring('slide', k), 'shaker': PrescribedForce(
            'sine', 'slide', amplitude=4.0, frequency=frequency, phase=phase, offset=1.0)},
        [0.0])
    simulation.step(duration=0.7)
    own = math.sqrt(k / m)
    high = 4.0 / (k - m * w * w)

    def steady(t):
        return 1.0 / k + high * math.sin(w * t + phase)

    at_start, rate = -steady(0.0), -high * w * math.cos(phase)
    t = 0.7
    assert simulation.position[0] == pytest.approx(
        steady(t) + at_start * math.cos(own * t) + rate / own * math.sin(own * t), abs=1e-9)
    assert_balanced(simulation, 1e-9)
    reading = simulation.effect_readings('shaker')
    assert reading['force'] == pytest.approx(1.0 + 4.0 * math.sin(w * t + phase), abs=1e-11)
    assert reading['power'] == pytest.approx(reading['force'] * simulation.velocity[0])


def test_a_cycloid_rises_and_falls_by_its_closed_form():
    force = PrescribedForce('cycloid', 'slide', amplitude=2.0, offset=1.0, start=0.1, rise=0.3,
                            hold=0.2, fall=0.1)
    simulation = simulated(block(1e3), {'push': force}, [0.0])

    def reading():
        return simulation.effect_readings('push')['force']

    for time in np.arange(1, 90) / 100.0:
        simulation.step(duration=0.01)
        up, down = np.clip([(time - 0.1) / 0.3, (time - 0.6) / 0.1], 0.0, 1.0)
        share = sum(sign * (s - math.sin(2.0 * math.pi * s) / (2.0 * math.pi))
                    for sign, s in ((1.0, up), (-1.0, down)))
        assert reading() == pytest.approx(1.0 + 2.0 * share, abs=1e-12)


def test_a_period_begins_again_and_work_is_reported():
    force = PrescribedForce('table', 'slide', times=(0.0, 0.1, 0.25), values=(1.0, -1.0, 4.0),
                            period=0.25, interpolation='step')
    simulation = simulated(block(1.0), {'push': force}, [0.0], step_size=0.02)
    simulation.step(duration=3.0)
    # Each period: 0.1 s of 1 N and 0.15 s of -1 N.
    assert simulation.velocity[0] == pytest.approx(12 * (0.1 - 0.15), abs=1e-12)
    assert simulation.energy_balance.work == pytest.approx(0.5 * 0.6 ** 2, abs=1e-12)


def test_a_cubic_table_is_a_spline():
    times, values = (0.0, 0.1, 0.25, 0.3, 0.6), (0.0, 1.0, -1.0, 2.0, 2.5)
    simulation = simulated(block(1.0), {'push': PrescribedForce(
        'table', 'slide', times=times, values=values, interpolation='cubic')}, [0.0],
        integrator='auto')
    simulation.step(duration=0.5)
    twice = CubicSpline(times, values).antiderivative(2)
    assert simulation.position[0] == pytest.approx(twice(0.5), abs=1e-12)


@pytest.mark.parametrize('axes', ['world', 'body'])
def test_a_force_at_a_point_turns_and_moves_the_body(axes):
    force = PrescribedForce('constant', point='rim', direction=(3.0, 0.0), axes=axes,
                            amplitude=2.0)
    simulation = simulated(flyer(), {'push': force}, [0.0, 0.0, 0.5], [0.0, 0.0, 1.0])
    x, y = (2.0, 0.0) if axes == 'world' else (2.0 * math.cos(0.5), 2.0 * math.sin(0.5))
    arm = 0.2 * math.sin(0.5), -0.2 * math.cos(0.5)
    assert np.allclose(simulation.acceleration, [
        x / 1.5, y / 1.25, (arm[0] * y - arm[1] * x) / 0.5], atol=1e-13)
    simulation.step(duration=0.5)
    assert_balanced(simulation, 1e-9)


def test_the_time_goes_on_over_new_states_and_changes():
    simulation = simulated(block(1.0), {'push': CORNERS}, [0.0], step_size=0.01)
    simulation.step(duration=0.2)
    simulation.set_state([0.0])
    expected = np.interp(0.2, CORNERS.times, CORNERS.values)
    assert simulation.effect_readings('push')['force'] == pytest.approx(expected, abs=1e-12)
    simulation.set_effect('push', times=(0.0, 1.0), values=(0.0, 1.0))
    simulation.step(duration=0.1)
    assert simulation.effect_readings('push')['force'] == pytest.approx(0.3, abs=1e-12)
    simulation.reset()
    assert simulation.effect_readings('push')['force'] == 0.0
    with pytest.raises(FieldError, match='no more segments'):
        simulation.set_effect('push', times=tuple(range(20)), values=(0.0,) * 20)


def test_inverse_dynamics_knows_the_time():
    simulation = simulated(pendulum(), {'gravity': EARTH, 'push': PrescribedForce(
        'trapezoid', 'hinge', amplitude=2.0, rise=1.0)}, [0.3], [0.0])
    simulation.step(duration=0.25)
    state = simulation.position, simulation.velocity
    torque, _ = simulation.inverse_dynamics(*state, simulation.acceleration)
    assert torque[0] == pytest.approx(0.0, abs=1e-12)


def scene(directory, effect):
    """Write a scene of a slider-crank with an effect; return its path."""
    path = directory / 'scene.yaml'
    path.write_text('mechanism: four_bar\ninitial:\n  position: {crank_joint: 1.0, '
                    'coupler_joint: 0.0, rocker_joint: 1.0}\neffects:\n  push:\n'
                    '    type: prescribed_force\n' + effect)
    return path


def test_a_table_is_read_from_a_file(tmp_path):
    (tmp_path / 'force.csv').write_text('time, force\n0, 1\n\n0.5, 2  # so\n1e0, -3\n')
    path = scene(tmp_path, '    shape: table\n    joint: crank_joint\n    file: force.csv\n')
    push = load_scene(path).effects['push']
    assert push.times == (0.0, 0.5, 1.0) and push.values == (1.0, 2.0, -3.0)


@pytest.mark.parametrize('text, message', [
    ('0, 1\n0.5\n', r'push\.file: expected 2 numbers in a line, got 1 in .*force\.csv:2'),
    ('0, 1\nx, 1\n', r'push\.file: expected 2 numbers, got .*force\.csv:2'),
    ('time, force\n', r'push\.file: expected a file with lines of 2 numbers'),
    (None, r'push\.file: expected a CSV file that can be read')])
def test_files_that_are_no_table_are_refused(tmp_path, text, message):
    if text is not None:
        (tmp_path / 'force.csv').write_text(text)
    path = scene(tmp_path, '    shape: table\n    joint: crank_joint\n    file: force.csv\n')
    with pytest.raises(SceneError, match=message):
        load_scene(path)


@pytest.mark.parametrize('text, law', [
    ('2*sin(3*t) - t**2/4', lambda t: 2.0 * math.sin(3.0 * t) - t ** 2 / 4.0),
    ('-max(abs(t - 0.3), min(t, 0.1))*exp(-t)', lambda t: -max(
        abs(t - 0.3), min(t, 0.1)) * math.exp(-t)),
    ('atan2(t, 1 + cos(2*pi*t)) + hypot(t, 3) - sqrt(t + 1)*log(t + 2)', lambda t: (
        math.atan2(t, 1.0 + math.cos(2.0 * math.pi * t)) + math.hypot(t, 3.0)
        - math.sqrt(t + 1.0) * math.log(t + 2.0))),
    ('tan(t/2) + asin(t/4) - acos(t/4) + atan(t) + radians(t) + degrees(t)', lambda t: (
        math.tan(t / 2.0) + math.asin(t / 4.0) - math.acos(t / 4.0) + math.atan(t)
        + math.radians(t) + math.degrees(t)))])
def test_an_expression_has_the_values_that_it_says(text, law):
    simulation = simulated(block(1e3), {'push': PrescribedForce(
        'expression', 'slide', expression=text)}, [0.0])
    for _ in range(5):
        simulation.step(duration=0.17)
        assert simulation.effect_readings('push')['force'] == pytest.approx(
            law(simulation.time), rel=1e-13, abs=1e-13)
    assert_balanced(simulation, 1e-9)


@pytest.mark.parametrize('text, message', [
    ('2*x', "unknown name 'x'"), ('sine(t)', "did you mean 'sin'"), ('sin(t, t)', 'got the text'),
    ('t.real', 'got the text'), ('__import__("os")', 'got the text'), ('t if t else 1', 'got')])
def test_what_is_no_expression_in_the_time_is_refused(text, message):
    with pytest.raises(FieldError, match=message) as refusal:
        PrescribedForce('expression', 'slide', expression=text)
    assert str(refusal.value).startswith('expression: expected an expression in t')
