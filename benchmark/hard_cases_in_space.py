# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The hard cases of the stability atlas in space."""

from dataclasses import replace
import math

from closedloop_dynamics.mechanism.rotations import of_quaternion
from hard_machines import energy_error, started, stepped, tight, worst_of
import numpy as np
from spinning_bodies import (
    ACROSS, ALONG, free_body, LEVER, MOMENTS, norm_error, nutation, one_body, SPIN, top, TOP_MASS,
    TURNS)


def bricard(method, quick, corner):
    """Drop Bricard's linkage: its corner's place after a second [m], then its energy and loops."""
    simulation = started('bricard', method, step_size=1e-3)
    error = energy_error(simulation)
    simulation.advance(np.zeros(len(simulation.torque_names)), 1000)
    return max(np.linalg.norm(simulation.point('corner') - corner), worst_of(
        simulation, 0 if quick else 9, 1000, error, lambda one: one.closure))


def idle_spin(method, quick):
    """Spin a rod between two balls about itself: its spin and energy stay constant."""
    simulation = started('rssr_four_bar', method, step_size=1e-4)
    along, spin = np.ones(3) / math.sqrt(3.0), 1000.0
    rates = simulation.velocity
    turn = simulation.coordinates.rates['tip']
    rates[turn] = spin * along
    simulation.set_state(simulation.position, rates)
    energy = worst_of(simulation, 1, 1000 if quick else 10_000, energy_error(simulation))
    # The crank turns, too, about an axis that the rod leans to: the rate relative to it.
    x, y, z, w = simulation.body_poses[2, 3:]
    crank = np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])
    found = (simulation.velocity[turn] + simulation.velocity[0] * crank) @ along
    return max(abs(found / spin - 1.0), energy)


def turned_hexapod(method, quick):
    """
    Turn a Stewart platform through 90 degrees, where locked legs would leave it loose.

    Unequal forces in its legs turn it, and it stays level.
    """
    simulation = started('stewart_platform', method, step_size=1e-3, tolerance=1e-8)
    forces = [28.5 * (1.0 + share) for share in 3 * (-0.3, 0.3)]
    platform = [body.name for body in simulation.mechanism.bodies].index('platform')
    before, crossings, worst = None, 0, 0.0
    for _ in range(60 if quick else 120):
        simulation.step(forces, 0.01)
        balance = simulation.energy_balance
        worst = max(worst, abs(balance.residual) / max(1.0, balance.kinetic))
        x, y, z, w = simulation.body_poses[platform, 3:]
        worst = max(worst, math.hypot(x, y))
        # The cosine of its turn and the sine that is given change their signs together.
        now = 1.0 - 2.0 * (y * y + z * z), simulation.health.drive_sine
        if before is not None and simulation.time < 0.6:
            crossed = [one * other < 0.0 for one, other in zip(before, now)]
            crossings += crossed[0]
            if crossed[0] != crossed[1]:
                return math.nan
        before = now
    return worst if crossings == 1 else math.nan


def starts_off(method, quick, names):
    """Start with errors of 0.1 rad or m in all joints: loops close, and the motion goes on."""
    worst, rng = 0.0, np.random.default_rng(3)
    for name in names:
        simulation = started(name, method, step_size=1e-3)
        q, joints = simulation.position, simulation.coordinates
        for _ in range(2 if quick else 20):
            simulation.set_state(joints.moved(q, rng.uniform(-0.1, 0.1, joints.nv)),
                                 rng.uniform(-1.0, 1.0, joints.nv))
            worst = max(worst, simulation.closure, worst_of(
                simulation, 1, stepped(5), lambda one: one.closure))
    return worst


# What an error of the norm of a quaternion counts: 1e-15 is accurate.
NORM = 1e9


def norm(simulation):
    """Return the figure of the norms of quaternions."""
    return NORM * norm_error(simulation)


def flipping_body(method, quick):
    """Flip a body about its middle axis, its origin not at its centre of mass."""
    expected, center = free_body(share=0.9), np.array([0.1, -0.2, 0.05])
    start = expected(0.0)
    simulation = one_body(
        'free', tuple(center), tuple(MOMENTS), replace(tight(method, 1e-3), accuracy=1e-8), {
            'joint': {'velocity': -np.cross(start, center), 'angular_velocity': start}})
    return worst_of(
        simulation, 20 if quick else 600, 0.1 if quick else 1.0, norm,
        lambda one: np.abs(one.velocity[-3:] - expected(one.time)).max() / TURNS)


def heavy_top(method, quick):
    """Nutate a heavy top: its lean, its spin and its energy."""
    simulation = top(replace(tight(method, 2e-4), accuracy=1e-8))
    return worst_of(
        simulation, 10 if quick else 320, 0.1 if quick else 0.5, norm, energy_error(simulation),
        lambda one: abs(of_quaternion(one.position)[2, 2] - nutation(one.time)[0]),
        lambda one: abs(one.velocity[2] / SPIN - 1.0))


def tumbling(method, quick):
    """Make very many steps of a tumbling body: angular momentum, energy, norm."""
    start = free_body()(0.0)
    simulation = one_body(
        'spherical', (0.0, 0.0, 0.0), tuple(MOMENTS), replace(method, step_size=1e-4),
        {'joint': {'angular_velocity': start}})
    momentum = MOMENTS * start

    def turned(one):
        now = of_quaternion(one.position) @ (MOMENTS * one.velocity)
        return np.abs(now - momentum).max() / np.abs(momentum).max()

    return worst_of(simulation, 2 if quick else 1000, 10_000, norm, turned,
                    energy_error(simulation))


def every_orientation(method, quick):
    """Start the top from every orientation, each quaternion of both signs."""
    simulation, rng = top(method), np.random.default_rng(3)
    moments, worst = np.array([ACROSS, ACROSS, ALONG]), 0.0
    turns = [*np.eye(4), *rng.standard_normal((20 if quick else 500, 4))]
    for turn in turns:
        turn = turn / np.linalg.norm(turn)
        for q in (turn, -turn):
            rates = rng.standard_normal(3)
            simulation.set_state(q, rates)
            weight = of_quaternion(q).T @ (0.0, 0.0, -9.81 * TOP_MASS)
            # Euler's equations about the fixed point.
            torque = np.cross((0.0, 0.0, LEVER), weight) - np.cross(rates, moments * rates)
            worst = max(worst, np.abs(simulation.acceleration - torque / moments).max()
                        / np.abs(torque / moments).max())
            worst = max(worst, worst_of(simulation, 1, 0.01, energy_error(simulation, 1.0)))
    return worst
