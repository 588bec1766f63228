# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Magnetic springs: closed forms, balance of energy, equal and opposite forces."""

import math

from closedloop_dynamics.effects.magnetic_spring import MagneticSpring
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, pair, simulated
from .test_space import assert_moves, drawn


def test_a_pole_far_away_pulls_with_the_inverse_square():
    magnet = MagneticSpring('ball', 50.0, 1e-3, anchor=(3.0, 4.0))
    simulation = simulated(flyer(), {'magnet': magnet}, [0.0, 0.0, 0.0])
    # 50 / 5^2 = 2 N along (0.6, 0.8); the rails weigh 0.25 kg each. The poles' size changes
    # forces by a share of 1.5 (1e-3 / 5)^2 = 6e-8.
    assert np.allclose(simulation.acceleration, [1.2 / 1.5, 1.6 / 1.25, 0.0], rtol=1e-7)
    assert simulation.effect_readings('magnet') == {
        'stored_energy': pytest.approx(-10.0, rel=1e-7), 'force': pytest.approx(2.0, rel=1e-7),
        'length': pytest.approx(5.0)}


@pytest.mark.parametrize('strength', [0.3, -0.3])
def test_a_block_passes_a_pole_at_the_speed_that_energy_tells(strength):
    magnet, start = MagneticSpring('center', strength, 0.05, anchor=(0.0, 0.02)), 0.2
    simulation = simulated(block(), {'magnet': magnet}, [-start], [2.0], integrator='dop853',
                           tolerance=1e-12)
    mass, before = 1.0, math.hypot(start, 0.02, 0.05)
    while simulation.position[0] < 0.0 and simulation.time < 1.0:
        simulation.step(duration=0.002)
    away = math.hypot(simulation.position[0], 0.02, 0.05)
    gained = strength * (1.0 / away - 1.0 / before)
    assert 0.5 * mass * (simulation.velocity[0] ** 2 - 4.0) == pytest.approx(gained, rel=1e-9)
    assert_balanced(simulation, 1e-10)


def test_poles_that_meet_feel_no_force():
    magnet = MagneticSpring('center', 10.0, 0.1, anchor=(0.0, 0.0))
    simulation = simulated(block(), {'magnet': magnet}, [0.0])
    assert simulation.acceleration[0] == 0.0


def test_two_bodies_are_pulled_alike():
    simulation = simulated(pair(), {'magnet': MagneticSpring('front', 2.0, 0.1, 'rear')},
                           [0.1, 0.2, 0.3, 1.1, -0.4, 0.6])
    simulation.step(duration=0.2)
    # Of 1 kg each.
    moves, others = np.split(simulation.velocity, 2)
    assert np.abs(moves[:2]).max() > 0.1
    assert np.allclose(moves[:2], -others[:2], rtol=1e-9)
    assert_balanced(simulation, 1e-9)


@pytest.mark.parametrize('seed', range(3))
def test_poles_in_space_pull_as_in_maximal_coordinates(seed):
    _, mechanism, q, qd, bodies, points, _ = drawn(seed)
    (arm_a, a, _), (arm_b, b, _), _ = points
    apart = b - a
    square = apart @ apart + 0.3 ** 2
    force = 7.0 * apart / square ** 1.5
    table = assert_moves(
        mechanism, q, qd, {'magnet': MagneticSpring('p0', 7.0, 0.3, 'p1')},
        [(bodies[0], arm_a, force, 0.0), (bodies[1], arm_b, -force, 0.0)])
    assert table.output[0, 0] == pytest.approx(-7.0 / math.sqrt(square), rel=1e-12)
