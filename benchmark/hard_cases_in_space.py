# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The hard cases of the stability atlas in space."""

from dataclasses import replace
import math

from closedloop_dynamics.mechanism.rotations import of_quaternion
from hard_machines import started
import numpy as np
from spinning_bodies import (
    ACROSS, ALONG, free_body, LEVER, MOMENTS, norm_error, nutation, one_body, SPIN, top, TOP_MASS,
    TURNS)

# Of the corner of Bricard's linkage after a second: two independent solvers agree on it [m].
BRICARD_CORNER = (0.5105014612, -1.6491675994, 0.1401231146)


def _bricard(method, quick):
    """Drop Bricard's linkage: its place after a second, then its energy and loops."""
    simulation = started('bricard', method, step_size=1e-3)
    energy, tau = simulation.energy, np.zeros(len(simulation.joint_names))
    simulation.advance(tau, 1000)
    worst = np.linalg.norm(simulation.point('corner') - BRICARD_CORNER)
    for _ in range(0 if quick else 9):
        simulation.advance(tau, 1000)
        worst = max(worst, abs(simulation.energy / energy - 1.0), simulation.closure)
    return worst


def _idle_spin(method, quick):
    """Spin a rod between two balls about itself: its spin and energy stay constant."""
    simulation = started('rssr_four_bar', method, step_size=1e-4)
    along, spin = np.ones(3) / math.sqrt(3.0), 1000.0
    rates = simulation.velocity
    turn = simulation.coordinates.rates['tip']
    rates[turn] = spin * along
    simulation.set_state(simulation.position, rates)
    energy, tau = simulation.energy, np.zeros(len(rates))
    simulation.advance(tau, 1000 if quick else 10_000)
    # The crank turns, too, about an axis that the rod leans to: the rate relative to it.
    x, y, z, w = simulation.body_poses[2, 3:]
    crank = np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])
    found = (simulation.velocity[turn] + simulation.velocity[0] * crank) @ along
    return max(abs(found / spin - 1.0), abs(simulation.energy / energy - 1.0))


def _turned_hexapod(method, quick):
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


# Machines that are started with an error of 0.1 rad or m in every joint.
SHAKEN = ('stewart_platform', 'delta_robot', 'bricard', 'rssr_four_bar')


def _shaken(method, quick):
    """Start with errors in all joints: loops close, and the motion goes on."""
    worst, rng = 0.0, np.random.default_rng(3)
    for name in SHAKEN:
        simulation = started(name, method, step_size=1e-3)
        q, names = simulation.position, simulation.coordinates
        for _ in range(2 if quick else 20):
            simulation.set_state(names.moved(q, rng.uniform(-0.1, 0.1, names.nv)),
                                 rng.uniform(-1.0, 1.0, names.nv))
            worst = max(worst, simulation.closure)
            for _ in range(5):
                simulation.step()
            worst = max(worst, simulation.closure)
    return worst


def _tight(method, step_size=1e-3):
    if method.integrator == 'semi_implicit_euler':
        step_size *= 0.1
    return replace(method, step_size=step_size, tolerance=1e-11, accuracy=1e-8)


# What an error of the norm of a quaternion counts: 1e-15 is accurate.
NORM = 1e9


def _free_body(method, quick):
    """Flip a body about its middle axis, its origin not at its centre of mass."""
    expected, center = free_body(share=0.9), np.array([0.1, -0.2, 0.05])
    start = expected(0.0)
    simulation = one_body(
        'free', tuple(center), tuple(MOMENTS), _tight(method), {'joint': {
            'velocity': -np.cross(start, center), 'angular_velocity': start}})
    worst = 0.0
    for _ in range(20 if quick else 600):
        simulation.step(duration=0.1 if quick else 1.0)
        error = simulation.velocity[-3:] - expected(simulation.time)
        worst = max(worst, np.abs(error).max() / TURNS, NORM * norm_error(simulation))
    return worst


def _top(method, quick):
    """Nutate a heavy top: its lean, its spin and its energy."""
    simulation, worst = top(_tight(method, 2e-4)), 0.0
    energy = simulation.energy
    for _ in range(10 if quick else 320):
        simulation.step(duration=0.1 if quick else 0.5)
        lean = of_quaternion(simulation.position)[2, 2]
        worst = max(worst, abs(lean - nutation(simulation.time)[0]),
                    abs(simulation.velocity[2] / SPIN - 1.0),
                    abs(simulation.energy / energy - 1.0), NORM * norm_error(simulation))
    return worst


def _many_turns(method, quick):
    """Make very many steps of a tumbling body: angular momentum, energy, norm."""
    start = free_body()(0.0)
    simulation = one_body(
        'spherical', (0.0, 0.0, 0.0), tuple(MOMENTS), replace(method, step_size=1e-4),
        {'joint': {'angular_velocity': start}})
    energy, momentum = simulation.energy, MOMENTS * start
    tau, worst = np.zeros(3), 0.0
    for _ in range(2 if quick else 1000):
        simulation.advance(tau, 10_000)
        now = of_quaternion(simulation.position) @ (MOMENTS * simulation.velocity)
        worst = max(worst, np.abs(now - momentum).max() / np.abs(momentum).max(),
                    abs(simulation.energy / energy - 1.0), NORM * norm_error(simulation))
    return worst


def _orientations(method, quick):
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
            energy = simulation.energy
            simulation.step(duration=0.01)
            worst = max(worst, abs(simulation.energy - energy))
    return worst


# Name, text, figure, accurate, stable, run and lengths of each.
IN_SPACE = (
    ('Bricard',
     "Bricard's linkage falls: one of its five equations repeats the others, its place after "
     '1 s is known, its energy stays for 10 s.',
     "error of a corner's place [m], of the energy, loops open [m]", 1e-4, 1e-1, _bricard,
     '10 s / 1 s'),
    ('idle spin',
     'The rod of an RSSR four-bar spins about itself at 1000 rad/s, between two balls, while '
     'it falls: its spin and the energy stay.', 'relative error of spin and energy', 1e-6,
     1e-2, _idle_spin, '1 s / 0.1 s'),
    ('hexapod turned by 90 degrees',
     'A Stewart platform is turned, level, through 90 degrees, where locked legs would leave it '
     'loose: that is reported, energy equals work.',
     'energy without source, relative, or sine of half its tilt', 1e-6, 1e-2, _turned_hexapod,
     '1.2 s / 0.6 s'),
    ('starts 0.1 off',
     'Stewart platform, Delta robot, Bricard and RSSR with errors of up to 0.1 in every joint: '
     'closed, and they move on.', 'closure error [m]', 1e-9, 1e-4, _shaken,
     '20 starts each / 2'),
    ('free body',
     'A free body, not at its centre of mass, flips about its middle axis for 1000 turns: against '
     'elliptic functions.', 'error of its rates, relative, or 1e9 x that of a norm', 1e-6, 1e-2,
     _free_body, '600 s / 2 s'),
    ('heavy top',
     'A symmetric top on a ball nutates for 1000 turns: against elliptic functions.',
     'error of its lean, spin and energy, or 1e9 x that of a norm', 1e-6, 0.1, _top,
     '160 s / 1 s'),
    ('1e7 steps, tumbling',
     'A body tumbles in steps of 0.1 ms, ten million of them (20,000 but for the default method): '
     'angular momentum and energy stay, the quaternion has norm 1.',
     'error of momentum and energy, relative, or 1e9 x that of a norm', 1e-6, 1e-2, _many_turns,
     '1e7 steps / 2e4'),
    ('every orientation',
     'The top starts from 1000 orientations, of both signs of their quaternions (else 40).',
     "error of acceleration, relative, against Euler's equations; of energy", 1e-9, 1e-3,
     _orientations, '1008 starts / 48'),
)
