# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Attack: loops that close by joints that repeat one another, at rest and in motion.

Degrees of freedom, accelerations at the start and after a while, closure and energy are compared
with a twin of dense matrices that knows of no tree. Where anything differs and nothing is said,
the mechanism is a silent one.
"""

from collections import Counter
from pathlib import Path
import warnings

from closedloop_dynamics import codegen, MechanismError, SimulationError
from closedloop_dynamics.mechanism.reader import mechanism_of
from closedloop_dynamics.scene.tree_choice import cheapest
import numpy as np
import pytest

from ..reference import repeated_joints as twin
from ..reference.scenes import simulated

DURATION = 0.2
# Second differences of places over this time [s] have errors of 1e-8 m/s^2 by rounding, and by
# the rate of accelerations.
BETWEEN = 1e-4
# Of the largest acceleration, at least 1 m/s^2 or rad/s^2.
ACCELERATION = 1e-4
# Of what moved; the accuracy of runs is 1e-6 rad or m within a second.
ENERGY, OPEN = 1e-3, 1e-7
# A guess is so far from home [rad, m], and so fast.
AWAY, RATE = 0.2, 0.5
# Share of guesses at home, and at rest.
STILL = 0.3
UNROLLED = codegen.MOST_UNROLLED_OPERATIONS


def frames(machine, simulation, q):
    """Return the poses of the bodies as the twin has them, from named points."""
    found = {'ground': twin.Pose(np.eye(3), np.zeros(3))}
    for name in machine.names:
        places = [simulation.data.place(f'{name}_{n}', q)
                  for n in range(3 if machine.planar else 4)]
        if machine.planar:
            places = [np.append(place, 0.0) for place in places]
            places.append(places[0] + twin.Z)
        found[name] = twin.Pose(np.array([place - places[0] for place in places[1:]]).T, places[0])
    return found


def motion(machine, simulation, qdd):
    """Return poses, twists and their rates, by differences along the coordinates' own motion."""
    q, qd = simulation.position, simulation.velocity
    moved, h = simulation.coordinates.moved, BETWEEN
    now = frames(machine, simulation, q)
    ahead, behind = (frames(machine, simulation, moved(
        q, sign * h * qd + 0.5 * h * h * qdd)) for sign in (1.0, -1.0))
    twists, rates = [], []
    for name in machine.names:
        axes, one, other = now[name].axes, ahead[name], behind[name]
        spin = _vector((one.axes - other.axes) @ axes.T / (2.0 * h))
        rate = _vector((one.axes - 2.0 * axes + other.axes) @ axes.T / h ** 2)
        twists += [*spin, *((one.origin - other.origin) / (2.0 * h))]
        rates += [*rate, *((one.origin - 2.0 * now[name].origin + other.origin) / h ** 2)]
    return now, np.array(twists), np.array(rates)


def _vector(skew):
    """Return the vector of the skew part of a matrix."""
    part = 0.5 * (skew - skew.T)
    return np.array([part[2, 1], part[0, 2], part[1, 0]])


def apart(machine, simulation):
    """Return how accelerations differ from the twin's, relatively, and poses and twists."""
    poses, twists, rates = motion(machine, simulation, simulation.acceleration)
    expected = twin.accelerations(machine, poses, twists)
    scale = max(1.0, np.abs(expected).max(), np.abs(twists).max() ** 2)
    return np.abs(rates - expected).max() / scale, poses, twists


def attack(rng):
    """Run one mechanism; return what became of it, and more about it."""
    machine = twin.draw(rng)
    try:
        mechanism = cheapest(mechanism_of(machine.data, Path('.')))
        coordinates, still = mechanism.coordinates, rng.random() < STILL
        change, velocity = (
            size * (not still) * rng.uniform(-1.0, 1.0, coordinates.nv) for size in (AWAY, RATE))
        simulation = simulated(
            mechanism, coordinates.moved(coordinates.start(), change), velocity,
            gravity=twin.GRAVITY[:2 if machine.planar else 3])
    except (MechanismError, SimulationError) as error:
        return _refused(machine, twin.home(machine), str(error))
    poses = frames(machine, simulation, simulation.position)
    values, _ = twin.equations(machine, poses)
    if np.abs(values).max() > OPEN:
        return 'silent', f'{machine.text}: open by {np.abs(values).max():.2g} at the start'
    mobility = twin.mobility(machine, poses)
    if not mobility.real:
        return 'first order', machine.text
    found = simulation.data.degrees_of_freedom()
    if found != mobility.freedoms:
        return 'silent', (f'{machine.text}: {found} degrees of freedom, '
                          f'{mobility.freedoms} are right')
    difference, poses, twists = apart(machine, simulation)
    if not difference <= ACCELERATION:
        return 'silent', f'{machine.text}: accelerations at the start off by {difference:.2g}'
    before = sum(twin.energy(machine, poses, twists))
    try:
        simulation.step(None, DURATION)
    except SimulationError as error:
        return _refused(machine, poses, str(error))
    difference, poses, twists = apart(machine, simulation)
    values, _ = twin.equations(machine, poses)
    kinetic, stored = twin.energy(machine, poses, twists)
    lost = abs(kinetic + stored - before) / max(1e-3, kinetic)
    if simulation.report().findings:
        return 'warned', machine.text
    if not (difference <= ACCELERATION and np.abs(values).max() <= OPEN and lost <= ENERGY):
        return 'silent', (f'{machine.text}: after a while off by {difference:.2g}, open by '
                          f'{np.abs(values).max():.2g}, energy {lost:.2g}')
    return 'right', machine.text


def _refused(machine, poses, reason):
    """Return that a mechanism was refused, unless it cannot move as its first order has it."""
    if not twin.mobility(machine, poses).real:
        return 'first order', machine.text
    return 'refused', f'{machine.text}: {reason}'


@pytest.mark.parametrize('count', [60, pytest.param(1000, marks=[
    pytest.mark.slow, pytest.mark.timeout(7200)])])
def test_no_joint_that_repeats_another_locks_or_frees_in_silence(count, monkeypatch):
    found = []
    for number in range(count):
        # Most by loops over bodies, which are compiled once for all topologies.
        most = UNROLLED if number % 4 == 0 else 0
        monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', most)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            found.append(attack(np.random.default_rng([47, number])))
    counts = Counter(kind for kind, _ in found)
    print(f'tried {count}:', dict(counts))
    assert [text for kind, text in found if kind in ('silent', 'refused', 'warned')] == []
    # Those that move to first order only are not part of this.
    assert counts['right'] >= 0.95 * count
