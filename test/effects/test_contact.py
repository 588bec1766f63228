# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Contact of a point with a line."""

from closedloop_dynamics.effects.registry import Contact, Gravity
import numpy as np
import pytest

from .machines import assert_balanced, flyer, simulated

EARTH = Gravity((0.0, -9.81))
# Masses of the flyer that move along x and along y [kg].
ALONG_X, ALONG_Y = 1.5, 1.25


def test_a_body_at_rest_lies_as_deep_as_its_weight_asks():
    ground = Contact('ball', (0.0, -0.5), 2e3, exponent=1.5)
    depth = (ALONG_Y * 9.81 / 2e3) ** (2.0 / 3.0)
    simulation = simulated(
        flyer(), {'gravity': EARTH, 'ground': ground}, [0.0, -0.5 - depth, 0.0])
    assert np.allclose(simulation.acceleration, 0.0, atol=1e-12)
    readings = simulation.effect_readings('ground')
    assert readings['normal_force'] == pytest.approx(ALONG_Y * 9.81)
    assert readings['stored_energy'] == pytest.approx(2e3 * depth ** 2.5 / 2.5)


@pytest.mark.parametrize('angle', [0.0, 0.7, -2.0])
def test_a_turned_line_pushes_along_its_normal(angle):
    normal = np.array([-np.sin(angle), np.cos(angle)])
    ground = Contact('ball', tuple(0.2 * normal), 1e3, angle=angle)
    simulation = simulated(flyer(), {'ground': ground}, [0.0, 0.0, 0.0])
    force = simulation.acceleration[:2] * [ALONG_X, ALONG_Y]
    assert np.allclose(force, 200.0 * normal, atol=1e-10)


def test_bouncing_with_damping_loses_energy_and_never_pulls():
    ground = Contact('ball', (0.0, 0.0), 1e5, exponent=1.5, damping=0.5, friction=0.3)
    simulation = simulated(flyer(), {'gravity': EARTH, 'ground': ground}, [0.0, 0.2, 0.0],
                           [0.5, 0.0, 1.0], step_size=1e-4)
    forces, before = [], 0.0
    for _ in range(100):
        simulation.step(duration=0.01)
        forces.append(simulation.effect_readings('ground')['normal_force'])
        dissipated = simulation.energy_balance.dissipated
        assert dissipated >= before
        before = dissipated
    assert min(forces) == 0.0 and max(forces) > 0.0
    assert before > 1.0
    assert_balanced(simulation, 2e-6)


def test_friction_and_scraping_slow_the_slide():
    ground = Contact('ball', (0.0, 0.0), 1e3, friction=0.4, scraping=50.0, slip_velocity=1e-3)
    depth = ALONG_Y * 9.81 / 1e3
    simulation = simulated(
        flyer(), {'gravity': EARTH, 'ground': ground}, [0.0, -depth, 0.0], [2.0, 0.0, 0.0])
    force = 0.4 * ALONG_Y * 9.81 + 50.0 * depth
    assert simulation.acceleration[0] * ALONG_X == pytest.approx(-force, rel=1e-6)
    readings = simulation.effect_readings('ground')
    assert readings['scraping_force'] == pytest.approx(-50.0 * depth, rel=1e-6)
    simulation.step(duration=0.1)
    assert simulation.energy_balance.dissipated == pytest.approx(
        force * simulation.position[0], rel=1e-5)
    assert_balanced(simulation, 1e-9)


def test_a_point_beside_the_centre_turns_the_body():
    ground = Contact('rim', (0.0, 0.0), 1e3, friction=0.5, slip_velocity=1e-3)
    simulation = simulated(flyer(), {'ground': ground}, [0.0, 0.19, 0.0], [1.0, 0.0, 0.0])
    # 10 N up through the centre, 5 N against the slide 0.2 m below it.
    assert simulation.acceleration[2] == pytest.approx(-5.0 * 0.2 / 0.5, rel=1e-5)


def test_a_free_point_feels_nothing():
    simulation = simulated(flyer(), {'ground': Contact('ball', (0.0, -0.1), 1e3)}, [0, 0, 0])
    assert not simulation.acceleration.any()
