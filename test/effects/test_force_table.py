# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Springs whose force over the stroke is a table."""

from closedloop_dynamics.effects.registry import ForceTable, Gravity, JointSpring, PointSpring
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from .machines import assert_balanced, block, flyer, simulated

EARTH = Gravity((0.0, -9.81))


def test_a_straight_table_is_a_linear_spring():
    motions = []
    for spring in (JointSpring('slide', 40.0, 0.1), ForceTable(
            (0.0, 0.1, 0.15), (4.0, 0.0, -2.0), joint='slide')):
        simulation = simulated(block(), {'spring': spring}, [0.3], [-1.0])
        simulation.step(duration=0.5)
        motions.append(simulation.position)
        assert_balanced(simulation, 1e-9)
    assert np.allclose(*motions, rtol=0.0, atol=1e-12)


def test_a_constant_force_spring_gives_constant_acceleration():
    simulation = simulated(block(2.0), {'spring': ForceTable(
        (0.0, 1.0), (-5.0, -5.0), joint='slide')}, [3.0])
    simulation.step(duration=1.0)
    assert simulation.position[0] == pytest.approx(3.0 - 0.5 * 2.5, abs=1e-12)
    assert simulation.effect_readings('spring')['stored_energy'] == pytest.approx(
        5.0 * simulation.position[0], abs=1e-11)


def test_a_cubic_table_has_the_force_and_energy_of_its_spline():
    strokes, forces = np.array([-0.2, 0.0, 0.1, 0.3]), np.array([1.0, 0.0, -2.0, 0.5])
    spline = CubicSpline(strokes, forces)
    for q in (-0.15, 0.05, 0.1, 0.22):
        simulation = simulated(block(1.0), {'spring': ForceTable(
            tuple(strokes), tuple(forces), joint='slide', interpolation='cubic')}, [q])
        assert simulation.acceleration[0] == pytest.approx(spline(q), abs=1e-13)
        assert simulation.effect_readings('spring')['stored_energy'] == pytest.approx(
            -spline.integrate(-0.2, q), abs=1e-13)


@pytest.mark.parametrize('place', [(1.5, 0.0), (-0.6, 0.4)])
def test_between_points_a_straight_table_is_a_point_spring(place):
    found = []
    for spring in (
            PointSpring('rim', anchor=place, stiffness=30.0, damping=2.0, free_length=0.3),
            ForceTable((0.3, 0.5), (0.0, 6.0), point_a='rim', anchor=place, damping=2.0)):
        simulation = simulated(flyer(), {'gravity': EARTH, 'spring': spring}, [0.0, 0.1, 0.2],
                               [0.3, 0.0, 1.0])
        simulation.step(duration=0.3)
        found.append(np.concatenate((simulation.position, simulation.velocity)))
        assert_balanced(simulation, 1e-8)
    assert np.allclose(*found, rtol=0.0, atol=1e-12)


def test_beyond_its_ends_a_table_goes_on_straight():
    table = ForceTable((0.0, 0.1, 0.2), (0.0, -1.0, -4.0), joint='slide')
    for q, force in ((-0.1, 1.0), (0.05, -0.5), (0.15, -2.5), (0.4, -10.0)):
        assert simulated(block(), {'spring': table}, [q]).acceleration[0] == pytest.approx(force)
