# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Linear spring in a joint."""

from closedloop_dynamics import Body, Joint, Mechanism
from closedloop_dynamics.effects.registry import Gravity, JointSpring
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest

from .machines import assert_balanced, block, simulated


def test_oscillation_about_the_rest_position():
    simulation = simulated(
        block(2.0), {'spring': JointSpring('slide', 50.0, 0.1)}, [0.3], step_size=1e-3)
    assert simulation.energy_balance.stored == pytest.approx(1.0)
    assert simulation.effect_readings('spring')['torque'] == pytest.approx(-10.0)
    simulation.step(duration=1.0)
    assert simulation.position[0] == pytest.approx(0.1 + 0.2 * np.cos(5.0), abs=1e-11)
    assert_balanced(simulation, 1e-11)


def ball(center=(0.0, 0.0, 0.0), inertia=(0.5, 0.5, 0.5)):
    """Return a body in a ball on another one, both free to turn, their frames askew."""
    return Mechanism(
        'ball', (Body('arm', 1.0, (0.1, 0.0, 0.0), (0.1, 0.2, 0.2)),
                 Body('top', 2.0, center, inertia)),
        (Joint('hinge', 'revolute', 'ground', 'arm', (0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0)),
         Joint('socket', 'spherical', 'arm', 'top', (0.0, 0.0, 0.0),
               orientation=(0.5, 0.5, 0.5, 0.5))), ())


def about(axis, angle):
    """Return the quaternion of a turn about an axis of unit length, x y z w."""
    return (*(np.sin(0.5 * angle) * np.array(axis)), np.cos(0.5 * angle))


def test_a_ball_swings_about_the_axis_that_it_is_turned_by():
    axis = np.array((0.6, 0.0, 0.8))
    still = Mechanism('ball', (Body('top', 2.0, (0.0, 0.0, 0.0), (0.5, 0.5, 0.5)),),
                      (Joint('socket', 'spherical', 'ground', 'top', (0.0, 0.0, 0.0),
                             orientation=(0.5, 0.5, 0.5, 0.5)),), ())
    simulation = simulated(still, {'spring': JointSpring('socket', 8.0)}, about(axis, 2.5),
                           3 * [0.0], step_size=1e-3)
    assert simulation.energy_balance.stored == pytest.approx(0.5 * 8.0 * 2.5 ** 2, rel=1e-14)
    assert simulation.effect_readings('spring')['torque'] == pytest.approx(20.0, rel=1e-14)
    simulation.step(duration=1.0)
    found = simulation.position * np.sign(simulation.position[3])
    turned = about(axis, 2.5 * np.cos(4.0))
    np.testing.assert_allclose(found, turned, atol=1e-10)
    assert_balanced(simulation, 1e-9)


def test_a_ball_on_what_turns_keeps_the_energy():
    simulation = simulated(
        ball((0.1, 0.2, 0.0), (0.5, 0.7, 0.9, 0.01, 0.02, 0.03)),
        {'gravity': Gravity((1.0, 2.0, -9.81)), 'spring': JointSpring('socket', 30.0)},
        (0.3, *about((0.0, 0.6, 0.8), 1.5)), (0.5, 1.0, -2.0, 1.5),
        integrator='dop853', tolerance=1e-11)
    simulation.step(duration=0.5)
    assert abs(simulation.velocity[0] - 0.5) > 0.1
    assert_balanced(simulation, 1e-8)


def test_a_ball_is_turned_back_about_the_axis_of_its_turn():
    """By a moment in proportion to the angle, from none to half a turn."""
    spring = {'spring': JointSpring('socket', 8.0)}
    for angle in (0.0, 1e-12, 1e-7, 1e-4, 1.0, 1.6, 3.0, np.pi - 1e-7):
        axis = np.array((0.36, 0.48, 0.8))
        simulation = simulated(ball(), spring, (0.0, *about(axis, angle)), 4 * [0.0])
        # The inertia of the ball, which does not carry the arm's turn, is that of a sphere.
        moment = -8.0 * angle * axis
        hinge, *turns = simulation.acceleration
        top = 0.5 * (np.array(turns) + hinge * axes_of_top(simulation.position[1:])[2])
        np.testing.assert_allclose(top, moment, rtol=1e-12, atol=1e-25)


def axes_of_top(quaternion):
    """Return the world's axes as rows in those of the top, while the hinge is at 0."""
    def matrix(x, y, z, w):
        return np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    return matrix(0.5, 0.5, 0.5, 0.5) @ matrix(*quaternion)


def test_a_ball_is_at_rest_where_it_is_not_turned():
    with pytest.raises(FieldError, match='0 in a joint with an orientation'):
        JointSpring('socket', 1.0, 0.1).fit(ball())


def test_several_springs_add_up():
    one, two = (simulated(block(), effects, [0.3]) for effects in (
        {'spring': JointSpring('slide', 50.0)},
        {'left': JointSpring('slide', 20.0), 'right': JointSpring('slide', 30.0)}))
    assert two.acceleration[0] == pytest.approx(one.acceleration[0], rel=1e-15)
    assert two.energy == pytest.approx(one.energy, rel=1e-15)
