# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The shipped machines that are made of elements, against their known answers."""

from dataclasses import replace
import math

from closedloop_dynamics import CutJoint, load_scene, Simulation
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ..reference.compare import assert_agree


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


def test_the_planetary_gear_obeys_willis_and_newton():
    simulation = Simulation.from_scene('planetary_gear', accuracy=1e-9)
    for _ in range(4):
        sun, ring, carrier, planet = simulation.velocity[:4]
        assert (sun - carrier) * 0.03 == pytest.approx(-(ring - carrier) * 0.09, abs=1e-9)
        assert planet == pytest.approx(carrier - sun, abs=1e-9)
        alpha, (*teeth, at_ring) = simulation.acceleration, simulation.tooth_forces
        # Three planets share the force; each wheel alone, about its axis.
        assert teeth == pytest.approx(3 * [teeth[0]], rel=1e-9)
        assert 1e-4 * alpha[0] == pytest.approx(1.0 + 0.03 * sum(teeth), abs=1e-10)
        assert 9e-3 * alpha[1] == pytest.approx(0.09 * at_ring - 2.0 * ring, abs=1e-9)
        # A planet turns with its carrier, and by its own joint.
        assert 1e-4 * (alpha[2] + alpha[3]) == pytest.approx(
            0.03 * teeth[0] - 0.01 * at_ring, abs=1e-10)
        arm = 2e-3 + 3.0 * (1e-4 + 0.22 * 0.06 ** 2)
        assert arm * alpha[2] + 3e-4 * alpha[3] == pytest.approx(
            -0.03 * sum(teeth) - 0.09 * at_ring - 0.2 * carrier, abs=1e-9)
        simulation.step(duration=0.25)
    assert simulation.velocity[0] > 20.0
    assert abs(simulation.energy_balance.residual) < 1e-9
    assert simulation.health.rank_revealing_count == 0


def test_elliptic_gears_are_a_rod_between_their_other_foci():
    scene = load_scene('elliptic_gear_press')
    simulation = Simulation.from_scene(scene, accuracy=1e-10)
    rod = CutJoint('foci', 'distance', 'driver', 'crank', (-0.07, 0.0), (0.07, 0.0), length=0.2)
    with pytest.warns(RuntimeWarning, match='change point'):
        other = Simulation.from_scene(replace(scene, mechanism=replace(
            scene.mechanism, couplings=(), cut_joints=(*scene.mechanism.cut_joints, rod),
            source=None)))
    ratios = []
    for _ in range(20):
        simulation.step(duration=0.1)
        q, qd = simulation.position, simulation.velocity
        other.set_state(q, qd)
        other.advance(other.joint_torques([0.0]), 0)
        # Where the rod is in line with both of them it holds nothing.
        assert_agree(simulation.acceleration, other.acceleration, 1e-8)
        ratios.append(-qd[1] / qd[0])
        e, angle = 0.35, q[0]
        assert ratios[-1] == pytest.approx(
            (1.0 - e * e) / (1.0 + e * e + 2.0 * e * math.cos(angle)), rel=1e-10)
    assert min(ratios) < 0.5 and max(ratios) > 1.9
    assert abs(simulation.energy_balance.residual) < 1e-8


def test_the_press_multiplies_the_pull():
    simulation = Simulation.from_scene('rack_press', accuracy=1e-9)
    for _ in range(10):
        simulation.step(duration=0.15)
        turn, place = simulation.position
        assert place == pytest.approx(0.02 * turn, abs=1e-12)
        teeth, = simulation.coupling_forces
        ram = simulation.acceleration[1]
        pressed = 1e5 * max(0.0, place - 0.014)
        assert 4.0 * ram == pytest.approx(
            4.0 * 9.81 + teeth - pressed - 5000.0 * simulation.velocity[1], abs=1e-8)
        # The lever lies to the left, and its weight pulls, too.
        lever = 0.02 + 1.5 * 0.2 ** 2
        pull = simulation.effect_readings('pull')['force']
        weight = 1.5 * 9.81 * 0.2 * math.cos(turn)
        assert lever * ram / 0.02 == pytest.approx(pull + weight - 0.02 * teeth, abs=1e-9)
    # At the end nothing moves, and the pull comes through fifty-fold.
    assert pressed == pytest.approx((15.0 + weight) / 0.02 + 4.0 * 9.81, rel=1e-3)
    assert abs(simulation.energy_balance.residual) < 1e-9


def test_the_differential_splits_the_torque_whatever_the_speeds():
    simulation = Simulation.from_scene('differential', accuracy=1e-9)
    # Wheels' rates w: the pinion turns at 3 (l + r) / 2, the spider at 1.5 (l - r) / 2.
    mean, apart = np.full(2, 0.5), np.array([0.75, -0.75])
    carried = 0.03 + 5e-5 + 0.3 * 0.03 ** 2 + 9.0 * 0.0008
    inertia = (0.8 * np.eye(2) + carried * np.outer(mean, mean)
               + 1e-4 * np.outer(apart, apart))
    damping = np.diag([0.2, 5.0])
    matrix = np.linalg.solve(inertia, np.column_stack([-damping, 3.0 * 20.0 * mean]))
    for _ in range(3):
        simulation.step(duration=0.3)
        moved = expm(simulation.time * np.vstack([matrix, np.zeros(3)])) @ [0.0, 0.0, 1.0]
        pinion, carrier, spider, left, right = simulation.velocity
        assert [left, right] == pytest.approx(moved[:2], abs=1e-8)
        assert pinion == pytest.approx(3.0 * carrier, abs=1e-10)
        assert 2.0 * carrier == pytest.approx(left + right, abs=1e-10)
        # Only what speeds the small spider up distinguishes the two sides.
        _, one, other = simulation.tooth_forces
        assert 0.02 * (other - one) == pytest.approx(
            1e-4 * simulation.acceleration[2], abs=1e-9)
        assert one == pytest.approx(other, rel=1e-3)
    assert left > 5.0 * right
    assert abs(simulation.energy_balance.residual) < 1e-9


def test_the_scissor_lift_moves_as_one_freedom_does():
    simulation = Simulation.from_scene('scissor_lift', accuracy=1e-9)
    length, stages = 0.6, np.arange(6) + 0.5

    def energies(angle, rate):
        # Both bars of a stage have their centres above one another's feet.
        centre = length * np.array([0.5 * math.cos(angle), math.sin(angle)])
        speed = (0.5 * length * math.sin(angle) * rate) ** 2 + (
            stages * length * math.cos(angle) * rate) ** 2
        top = 6.0 * length * math.cos(angle) * rate
        kinetic = np.sum(speed) + 6.0 * 0.03 * rate ** 2 + 5.0 * top ** 2
        height = 2.0 * np.sum(stages) * centre[1] + 10.0 * 6.0 * centre[1]
        return kinetic, 9.81 * height + 750.0 * (angle - 1.0) ** 2

    def motion(_, state):
        angle, rate = state
        mass = 2.0 * energies(angle, 1.0)[0]
        step = 1e-6
        slope = (energies(angle + step, 1.0)[0] - energies(angle - step, 1.0)[0]) / step
        push = (energies(angle + step, 0.0)[1] - energies(angle - step, 0.0)[1]) / (2.0 * step)
        return [rate, -(0.5 * slope * rate ** 2 + push) / mass]

    known = solve_ivp(motion, (0.0, 1.2), [0.4, 0.0], rtol=1e-10, atol=1e-12,
                      t_eval=[0.3, 0.6, 0.9, 1.2]).y
    start, highest = sum(energies(0.4, 0.0)), 0.0
    for angle, rate in known.T:
        simulation.step(duration=0.3)
        found = simulation.position[0], simulation.velocity[0]
        # The numerical derivatives of the reference are good to 1e-8.
        assert found == pytest.approx((angle, rate), abs=1e-6)
        assert sum(energies(*found)) == pytest.approx(start, rel=1e-9)
        load = simulation.point('load')
        assert load == pytest.approx([0.3, 3.6 * math.sin(found[0])], abs=1e-9)
        # A pin in a slot pushes across it only.
        assert simulation.constraint_forces[[0, -1], 1] == pytest.approx([0.0, 0.0], abs=1e-9)
        highest = max(highest, found[0])
    assert highest > 0.9
    assert abs(simulation.energy_balance.residual) < 1e-9


def test_the_geared_five_bar_draws_its_closed_form():
    simulation = Simulation.from_scene('geared_five_bar', accuracy=1e-9)
    for _ in range(5):
        simulation.step(duration=0.2)
        one, other = simulation.position[:2]
        assert other == pytest.approx(0.5 * one + 1.0, abs=1e-12)
        first = 0.1 * np.array([math.cos(one), math.sin(one)])
        second = [0.4, 0.0] + 0.08 * np.array([math.cos(other), math.sin(other)])
        middle, across = 0.5 * (first + second), second - first
        up = math.sqrt(0.3 ** 2 - 0.25 * across @ across) / math.hypot(*across)
        pen = middle + up * np.array([-across[1], across[0]])
        assert simulation.point('pen') == pytest.approx(pen, abs=1e-10)
    balance = simulation.energy_balance
    assert balance.work == pytest.approx(0.05 * simulation.position[0], rel=1e-9)
    assert abs(balance.residual) < 1e-9
