# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Bushings: forces by hand, momentum, energy."""

import math

from closedloop_dynamics.effects.bushing import Bushing
import numpy as np

from .machines import assert_balanced, flyer, momenta, pair, simulated


def test_forces_and_moment_are_those_of_the_springs():
    mount = Bushing('ball', anchor=(0.3, 0.1), stiffness=(100.0, 20.0), turning_stiffness=5.0,
                    angle=0.4, rest_angle=0.1)
    simulation = simulated(flyer(), {'mount': mount}, [0.0, 0.0, 0.2])
    axis = np.array([math.cos(0.6), math.sin(0.6)])
    across = np.array([-axis[1], axis[0]])
    offset = np.array([0.3, 0.1])
    force = 100.0 * (offset @ axis) * axis + 20.0 * (offset @ across) * across
    # The spring's force on body a acts where point b is.
    moment = offset[0] * force[1] - offset[1] * force[0] + 5.0 * (-0.2 - 0.1)
    assert np.allclose(simulation.acceleration, [
        force[0] / 1.5, force[1] / 1.25, moment / 0.5], atol=1e-12)


def test_two_bodies_keep_their_momentum_and_the_balance_closes():
    mount = Bushing('front', 'rear', stiffness=(200.0, 50.0), damping=(1.0, 2.0),
                    turning_stiffness=8.0, turning_damping=0.2, angle=0.3, rest_angle=-0.1)
    q = np.array([0.0, 0.0, 0.1, 0.6, 0.1, -0.2])
    qd = np.array([0.5, -0.2, 2.0, 0.0, 0.3, -1.0])
    simulation = simulated(pair(), {'mount': mount}, q, qd)
    before = momenta(simulation)
    simulation.step(duration=1.0)
    assert np.allclose(momenta(simulation), before, atol=1e-9)
    assert simulation.energy_balance.dissipated > 0.1
    assert_balanced(simulation, 1e-7)
