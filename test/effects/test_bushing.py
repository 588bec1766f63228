# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Bushings: forces by hand, momentum, energy."""

import math

from closedloop_dynamics.effects.bushing import Bushing
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.mechanism import Body, Joint, Mechanism, Point
import numpy as np
import pytest

from .machines import assert_balanced, flyer, simulated


def pair():
    """Return two bodies that move freely in the plane, of 1 kg and 0.5 kg m^2 each."""
    bodies, joints = [], []
    for side in 'ab':
        bodies += [Body(f'rail_{side}', 0.0, (0, 0), 0.0, True),
                   Body(f'lift_{side}', 0.0, (0, 0), 0.0, True),
                   Body(f'hull_{side}', 1.0, (0, 0), 0.5)]
        joints += [
            Joint(f'x_{side}', 'prismatic', 'ground', f'rail_{side}', (0, 0)),
            Joint(f'y_{side}', 'prismatic', f'rail_{side}', f'lift_{side}', (0, 0), math.pi / 2),
            Joint(f'turn_{side}', 'revolute', f'lift_{side}', f'hull_{side}', (0, 0),
                  -math.pi / 2)]
    return Mechanism('pair', tuple(bodies), tuple(joints), (), (
        Point('front', 'hull_a', (0.3, 0.0)), Point('rear', 'hull_b', (-0.2, 0.0))))


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

    def momenta():
        x, v = simulation.position, simulation.velocity
        spin = sum(x[k] * v[k + 1] - x[k + 1] * v[k] + 0.5 * v[k + 2] for k in (0, 3))
        return np.array([v[0] + v[3], v[1] + v[4], spin])

    before = momenta()
    simulation.step(duration=1.0)
    assert np.allclose(momenta(), before, atol=1e-9)
    assert simulation.energy_balance.dissipated > 0.1
    assert_balanced(simulation, 1e-7)


@pytest.mark.parametrize('values, key', [
    ({}, 'point_b'), ({'point_b': 'rear', 'anchor': (0, 0)}, 'point_b'),
    ({'point_b': 'rear', 'stiffness': (1.0,)}, 'stiffness'),
    ({'point_b': 'rear', 'stiffness': (1.0, -1.0)}, 'stiffness[1]'),
    ({'point_b': 'rear', 'turning_damping': -1.0}, 'turning_damping')])
def test_impossible_bushings_are_refused(values, key):
    with pytest.raises(FieldError) as refusal:
        Bushing('front', **values)
    assert str(refusal.value).startswith(key + ': expected'), refusal.value
