# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Linear spring in a joint."""

from closedloop_dynamics.effects.joint_spring import JointSpring
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


def test_several_springs_add_up():
    one, two = (simulated(block(), effects, [0.3]) for effects in (
        {'spring': JointSpring('slide', 50.0)},
        {'left': JointSpring('slide', 20.0), 'right': JointSpring('slide', 30.0)}))
    assert two.acceleration[0] == pytest.approx(one.acceleration[0], rel=1e-15)
    assert two.energy == pytest.approx(one.energy, rel=1e-15)


def test_a_negative_stiffness_is_refused():
    with pytest.raises(FieldError, match='stiffness'):
        JointSpring('slide', -1.0)
