# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The shipped machines that are made of elements, against their known answers."""

import math

from closedloop_dynamics import Simulation
import numpy as np
import pytest


def lift(angle):
    """Return where the roller's centre is above the cam's, at an angle of the cam before it."""
    def rise(share):
        share = np.clip(share, 0.0, 1.0)
        return share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi)

    angle = np.mod(angle, 2.0 * np.pi)
    return 0.05 + 0.012 * (rise(1.5 * angle / np.pi) - rise(1.5 * (angle - np.pi) / np.pi))


def test_the_cam_lifts_its_follower_as_it_is_cut():
    simulation = Simulation.from_scene('cam_follower')
    highest = 0.0
    for _ in range(50):
        simulation.step(duration=0.01)
        turn, height = simulation.position
        readings = simulation.effect_readings('outline')
        # The roller is pressed in by no more than the depth, and the spline is that near.
        assert readings['normal_force'] > 0.0
        assert height == pytest.approx(lift(0.5 * math.pi - turn), abs=1.3 * readings['depth'])
        assert readings['depth'] < 1e-4
        highest = max(highest, height)
    assert highest == pytest.approx(0.062, abs=1e-4)
    assert abs(simulation.energy_balance.residual) < 1e-7


def test_the_hoist_moves_as_newton_says():
    simulation = Simulation.from_scene('rope_hoist')
    up = 9.81 * (2.0 * 2.0 - 6.0) / (6.0 + 4.0 * 2.0)
    for _ in range(5):
        simulation.step(duration=0.1)
        t = simulation.time
        assert np.allclose(simulation.position, [0.5 * up * t * t, -up * t * t], atol=1e-8)
        assert simulation.effect_readings('rope')['tension'] == pytest.approx(
            2.0 * (9.81 - 2.0 * up), rel=1e-4)
    assert abs(simulation.energy_balance.residual) < 1e-8


def test_the_toggle_rests_on_either_side_and_is_pushed_across():
    simulation = Simulation.from_scene('bistable_toggle')
    simulation.step(duration=0.1)
    # Where it rests nothing moves.
    assert simulation.position[0] == pytest.approx(0.5, abs=1e-9)
    simulation.step(duration=0.9)
    assert simulation.position[0] == pytest.approx(-0.5, abs=2e-4)
    assert simulation.energy_balance.work > 0.5 * 1500.0 * 0.2 ** 2 * (1.0 - math.cos(0.5)) ** 2
    simulation.step(duration=1.0)
    assert simulation.position[0] == pytest.approx(0.5, abs=2e-4)
    assert abs(simulation.energy_balance.residual) < 1e-8


def test_the_geneva_drive_turns_its_wheel_by_its_closed_form():
    simulation = Simulation.from_scene('geneva_drive')
    ratio = math.sin(0.25 * math.pi)
    for _ in range(34):
        simulation.step(duration=0.01)
        driver, wheel = simulation.position
        if abs(driver) < 0.25 * math.pi:
            closed_form = -math.atan2(ratio * math.sin(driver), 1.0 - ratio * math.cos(driver))
            # The pin's play in a slot, 0.02 mm, and what it is pressed in, at 29 mm or more from
            # the wheel's axle.
            depth = simulation.effect_readings('outline')['depth']
            assert depth < 1e-5
            assert wheel == pytest.approx(closed_form, abs=(2e-5 + depth) / 0.029)
    resting = simulation.position[1]
    assert resting == pytest.approx(-0.25 * math.pi, abs=5e-4)
    simulation.step(duration=0.1)
    # The bearing's friction holds it, to the last bit.
    assert simulation.position[1] == resting and simulation.velocity[1] == 0.0
    assert abs(simulation.energy_balance.residual) < 1e-8
