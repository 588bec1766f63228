# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Limits, lag and delay of a drive."""

from closedloop_dynamics.effects.registry import Actuator, JointDamping
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated, slider_crank, spatial_block


def test_the_torque_is_limited_both_ways():
    simulation = simulated(block(), {'motor': Actuator('slide', max_torque=2.0)}, [0.0])
    for command, expected in ((5.0, 2.0), (1.0, 1.0), (-9.0, -2.0)):
        simulation.reset()
        simulation.step([command], 0.1)
        assert simulation.acceleration[0] == expected
        assert simulation.effort[0] == expected
        assert simulation.velocity[0] == pytest.approx(0.1 * expected, rel=1e-12)
        assert simulation.energy_balance.work == pytest.approx(
            0.5 * (0.1 * expected) ** 2, rel=1e-12)
        assert_balanced(simulation, 1e-14)


def test_the_drive_fades_at_its_speed_limit_and_still_brakes():
    effects = {'motor': Actuator('slide', max_speed=2.0), 'oil': JointDamping('slide', 0.1)}
    simulation = simulated(block(), effects, [0.0])
    simulation.step([10.0], 5.0)
    # Where 10 (1 - v / 2) / 0.1 = 0.1 v.
    assert simulation.velocity[0] == pytest.approx(100.0 / 50.1, rel=1e-9)
    simulation.step([-10.0])
    assert simulation.acceleration[0] == pytest.approx(-10.0 - 0.1 * simulation.velocity[0])
    assert_balanced(simulation, 1e-8)


def test_the_lag_answers_a_step_exponentially():
    simulation = simulated(block(), {'motor': Actuator('slide', lag=0.05)}, [0.0])
    simulation.step([3.0], 0.1)
    assert simulation.effort[0] == pytest.approx(3.0 * (1.0 - np.exp(-2.0)), rel=1e-7)
    expected = 3.0 * (0.1 - 0.05 * (1.0 - np.exp(-2.0)))
    assert simulation.velocity[0] == pytest.approx(expected, rel=1e-7)
    assert_balanced(simulation, 1e-9)


def test_the_delay_is_exact():
    simulation = simulated(block(), {'motor': Actuator('slide', delay=0.02)}, [0.0])
    simulation.step([4.0], 0.005)
    simulation.step([-2.0], 0.03)
    # 4 N from 0.020 to 0.025 s, then -2 N to 0.035 s.
    assert simulation.velocity[0] == pytest.approx(4.0 * 0.005 - 2.0 * 0.01, abs=1e-15)
    assert simulation.time == pytest.approx(0.035)
    simulation.step([0.0], 0.1)
    assert simulation.acceleration[0] == 0.0
    assert_balanced(simulation, 1e-13)


def test_one_step_at_a_time_is_the_same_as_many_with_a_delay():
    one, many = (simulated(block(), {'motor': Actuator('slide', delay=0.0155)}, [0.0])
                 for _ in range(2))
    for _ in range(40):
        one.step([1.0])
    many.step([1.0], 0.04)
    assert one.velocity[0] == pytest.approx(many.velocity[0], abs=1e-15)
    assert one.velocity[0] == pytest.approx(0.0245, abs=1e-12)


DELAY, STEP = 0.013, 0.004
# What is commanded from when on, as multiples of STEP, and how long it all lasts.
COMMANDS, LENGTH = ((0, 3.0), (2, -5.0), (3, 7.5), (11, 0.5)), 20


def delayed(time):
    """Return velocity and position of 1 kg at rest under the delayed commands."""
    velocity = position = 0.0
    starts = [DELAY + STEP * count for count, _ in COMMANDS]
    for (_, force), begin, end in zip(COMMANDS, starts, [*starts[1:], np.inf]):
        length = min(max(time - begin, 0.0), end - begin)
        position += velocity * length + 0.5 * force * length ** 2
        velocity += force * length
    return velocity, position


def cut_by_commands(simulation):
    for (count, force), end in zip(COMMANDS, [count for count, _ in COMMANDS[1:]] + [LENGTH]):
        simulation.advance(np.array([force]), end - count)


def cut_into_steps(simulation):
    for count in range(LENGTH):
        simulation.advance(np.array([[f for n, f in COMMANDS if n <= count][-1]]), 1)


def cut_beside_the_grid(simulation):
    for (count, force), end in zip(COMMANDS, [count for count, _ in COMMANDS[1:]] + [LENGTH]):
        length = STEP * (end - count)
        simulation.step([force], 0.37 * length)
        simulation.step([force], 0.63 * length)


@pytest.mark.parametrize('cut', [cut_by_commands, cut_into_steps, cut_beside_the_grid])
@pytest.mark.parametrize('integrator', ['rk4', 'auto', 'dop853', 'rodas4'])
@pytest.mark.parametrize('machine', [block, spatial_block])
def test_delayed_commands_act_when_they_are_due(machine, integrator, cut):
    simulation = simulated(machine(), {'motor': Actuator('slide', delay=DELAY)}, [0.0],
                           integrator=integrator, step_size=STEP)
    cut(simulation)
    assert simulation.time == pytest.approx(LENGTH * STEP, abs=1e-15)
    velocity, position = delayed(LENGTH * STEP)
    # Constant forces: no method makes an error but rounding.
    assert simulation.velocity[0] == pytest.approx(velocity, abs=1e-14)
    assert simulation.position[0] == pytest.approx(position, abs=1e-15)
    # The Jacobian of rodas4, which the work depends on, is one of finite differences.
    assert_balanced(simulation, 1e-12)


def test_steps_cut_by_a_delayed_command_are_counted_as_whole_ones():
    simulation = simulated(block(), {'motor': Actuator('slide', delay=DELAY)}, [0.0],
                           step_size=STEP)
    for _ in range(1000):
        simulation.step([float(simulation.time > 1.0)])
    assert simulation.time == 1000 * STEP


def test_joints_with_delays_of_their_own_change_within_one_step():
    effects = {'early': Actuator('x', delay=0.001), 'late': Actuator('y', delay=0.0035)}
    simulation = simulated(flyer(), effects, [0.0, 0.0, 0.0], step_size=STEP)
    simulation.advance(np.array([6.0, 3.0, 0.0]), 1)
    assert simulation.velocity[0] == pytest.approx(6.0 * 0.003 / 1.5, abs=1e-15)
    assert simulation.velocity[1] == pytest.approx(3.0 * 0.0005 / 1.25, abs=1e-15)


def test_work_of_a_constant_torque_is_exact():
    simulation = simulated(block(), {}, [0.0])
    simulation.step([2.0], 0.5)
    simulation.step([-1.0], 0.5)
    first = 0.5 * 2.0 * 0.25
    second = simulation.position[0] - first
    assert simulation.energy_balance.work == pytest.approx(2.0 * first - second, rel=1e-14)
    assert simulation.data.system.applied is simulation.data.system.tau


def test_a_joint_that_is_not_driven_is_refused():
    with pytest.raises(FieldError, match='motor.joint'):
        simulated(slider_crank(), {'motor': Actuator('rod')}, [np.pi / 2.0, 0.866, -0.5236])
