# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What is measured instead of what is."""

from closedloop_dynamics.effects.registry import Gravity, Sensor
import numpy as np
import pytest

from .machines import block, simulated


def test_without_sensors_the_truth_is_measured():
    simulation = simulated(block(), {}, [0.2], [1.0])
    simulation.step(duration=0.1)
    position, velocity = simulation.measured()
    assert position[0] == simulation.position[0]
    assert velocity[0] == simulation.velocity[0]


def test_noise_is_normal_seeded_and_leaves_the_truth_alone():
    sensor = Sensor(position_noise=0.01, velocity_bias=0.5, seed=7)
    runs = []
    for _ in range(2):
        simulation = simulated(block(), {'encoder': sensor}, [0.2], [1.0])
        errors = []
        for _ in range(2000):
            simulation.step()
            position, velocity = simulation.measured()
            errors.append(position[0] - simulation.position[0])
            assert velocity[0] == pytest.approx(simulation.velocity[0] + 0.5)
        runs.append(errors)
        assert simulation.position[0] == pytest.approx(2.2, rel=1e-12)
    assert runs[0] == runs[1]
    assert np.std(runs[0]) == pytest.approx(0.01, rel=0.1)
    assert abs(np.mean(runs[0])) < 0.001


def test_asking_twice_measures_once():
    simulation = simulated(block(), {'encoder': Sensor(position_noise=1.0)}, [0.0])
    assert np.array_equal(simulation.measured()[0], simulation.measured()[0])


def test_a_reset_repeats_the_noise():
    simulation = simulated(block(), {'encoder': Sensor(position_noise=1.0)}, [0.0])
    first = simulation.measured()[0]
    simulation.reset()
    assert np.array_equal(simulation.measured()[0], first)


def test_quantisation_rounds_to_the_resolution():
    simulation = simulated(block(), {'encoder': Sensor(position_resolution=0.05)}, [0.17])
    assert simulation.measured()[0][0] == pytest.approx(0.15)


@pytest.mark.parametrize('chunk', [1e-3, 0.1])
def test_a_delay_shows_the_past(chunk):
    simulation = simulated(
        block(), {'encoder': Sensor(delay=0.0255), 'gravity': Gravity((1.0, 0.0))}, [0.0])
    for _ in range(round(0.2 / chunk)):
        simulation.step(duration=chunk)
    assert simulation.measured()[1][0] == pytest.approx(0.2 - 0.0255, rel=1e-9)
    assert simulation.measured()[0][0] == pytest.approx(0.5 * (0.2 - 0.0255) ** 2, abs=1e-6)


def test_changes_of_other_effects_do_not_make_a_sensor_forget():
    runs = []
    for switched in (False, True):
        simulation = simulated(block(), {
            'encoder': Sensor(delay=0.02, position_noise=0.1), 'gravity': Gravity((1.0, 0.0))},
            [0.0])
        simulation.step(duration=0.05)
        if switched:
            simulation.set_effect('gravity', acceleration=(1.0, 0.5))
        simulation.step(duration=0.01)
        runs.append(simulation.measured()[0][0])
    assert runs[0] == runs[1]
