# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Attack: shots at solids of all shapes, from a millimetre to a metre, at 0.1 to 100 m/s.

A run that ends elsewhere than the reference, by more than the start's own uncertainty explains,
and says nothing, is a silent one.
"""

import collections
import warnings

from closedloop_dynamics import Method, NumericalError, SimulationError
from closedloop_dynamics.effects.registry import BodyContact
import numpy as np
import pytest

from ..reference.scenes import simulated
from ..reference.shots import draw, IN_PLANE, KINDS, Shot

# Of each method its setting, what of the way and the speed it may miss, and to what it is good.
METHODS = {
    'auto': ({}, 2e-3, 1e-5), 'auto, coarse': ({'accuracy': 1e-3}, 1e-2, 1e-3),
    'auto, fine': ({'accuracy': 1e-9}, 2e-3, 1e-8),
    'dop853': ({'tolerance': 1e-7}, 2e-3, 1e-5), 'rodas4': ({'tolerance': 1e-7}, 2e-3, 1e-5)}
FIXED = ('rk4', 'heun', 'semi_implicit_euler', 'rodas4_fixed')


def allowed(shot, end, share, uncertain):
    """Return the share that a run may miss: more where the end hangs on the last digits."""
    found, worst = np.concatenate((end[0] / shot.duration, end[1])), 0.0
    for sign in (-1.0, 1.0):
        for axis in range(len(shot.mass) + 1):
            place, velocity = shot.place.copy(), shot.velocity
            if axis < len(shot.mass):
                place[axis] += 0.3 * sign * uncertain
            else:
                velocity = velocity * (1.0 + sign * uncertain)
            place, velocity = shot.end(place, velocity, 0.02)
            worst = max(worst, np.abs(np.concatenate((
                place / shot.duration, velocity)) - found).max() / shot.speed)
    return max(share, 3.0 * worst)


def flown(shot, method):
    """Return the simulation of a shot, at its end."""
    still = (0.0, 0.0, 0.0) if len(shot.mass) == 3 else ()
    simulation = simulated(
        shot.mechanism, (*shot.place, *still, *((1.0,) if still else ())),
        (*shot.velocity, *still), {'solid': shot.effect}, method=method)
    simulation.step(duration=shot.duration)
    simulation.judge()
    return simulation


def difference(shot, end, other):
    """Return how far two ends are apart, places and velocities, as shares of way and speed."""
    return max(np.abs(end[0] - other[0]).max() / (shot.duration * shot.speed),
               np.abs(end[1] - other[1]).max() / shot.speed)


def outcome(number):
    """Return what became of a shot."""
    shot, name = draw(number), list(METHODS)[number // len(KINDS) % len(METHODS)]
    if shot.distance(shot.place)[0] <= shot.radius:
        return 'none'
    setting, share, uncertain = METHODS[name]
    size = len(shot.mass)
    end = shot.end()
    try:
        simulation = flown(shot, Method(
            integrator=name.split(',')[0], step_size=shot.duration / (1 + number % 11), **setting))
    except SimulationError:
        return 'stopped'
    place, velocity = simulation.position[:size], simulation.velocity[:size]
    start = shot.energy(shot.place, shot.velocity)
    missed = max(difference(shot, (place, velocity), end),
                 abs(shot.energy(place, velocity) - start) / start)
    if missed <= share or missed <= allowed(shot, end, share, uncertain):
        return 'right'
    return 'warned' if simulation.report().findings else 'silent'


@pytest.mark.parametrize('first, count', [
    (0, 20), pytest.param(0, 3000, marks=[pytest.mark.slow, pytest.mark.timeout(7200)])])
def test_no_shot_passes_a_solid_in_silence(first, count):
    counts, others = collections.Counter(), []
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        for number in range(first, first + count):
            what = outcome(number)
            counts[what] += 1
            if what not in ('right', 'none'):
                others.append((number, what))
    print(f'tried {count}:', dict(counts), others)
    assert counts['silent'] == 0, others
    assert counts['stopped'] + counts['warned'] <= 0.01 * count, others
    assert counts['right'] > 0.9 * count


def outcome_of_fixed_steps(number):
    """Return whether a shot in 2 to 1,600 steps of one size passed its solid as if it were not."""
    shot, name = draw(number), FIXED[number // len(KINDS) % len(FIXED)]
    if shot.distance(shot.place)[0] <= shot.radius:
        return 'none'
    steps = int(10.0 ** np.random.default_rng([28, number]).uniform(0.4, 3.2))
    size, end = len(shot.mass), shot.end()
    free = shot.place + shot.duration * shot.velocity, shot.velocity
    try:
        simulation = flown(shot, Method(integrator=name, step_size=shot.duration / steps))
    except SimulationError as error:
        if 'A contact (solid) was passed within a step' not in str(error):
            return 'stopped'
        return 'refused' if difference(shot, end, free) > 1e-9 else 'refused in free flight'
    found = simulation.position[:size], simulation.velocity[:size]
    if difference(shot, found, end) <= 1e-2:
        return 'right'
    return 'silent' if difference(shot, found, free) < 1e-6 else 'inaccurate'


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_no_fixed_step_passes_a_solid_in_silence():
    count = 2000
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        found = {number: outcome_of_fixed_steps(number) for number in range(count)}
    counts = collections.Counter(found.values())
    print(f'tried {count}:', dict(counts))
    wrong = {number: what for number, what in found.items() if what == 'silent'}
    assert not wrong
    assert counts['refused in free flight'] <= 0.01 * count
    assert counts['refused'] > 0


@pytest.mark.parametrize('method', FIXED)
def test_fixed_steps_pass_beside_a_plate_but_not_through_it(method):
    x, y = (-0.002, 0.002, 0.002, -0.002), (-0.1, -0.1, 0.1, 0.1)
    plate = BodyContact('ball', 'target', 'curve', 1e6, x=x, y=y, interpolation='linear')

    def fly(height):
        # Steps of 100 mm: no stage is in the plate.
        return flown(Shot('plate', plate, None, 0.0, 1e6, np.array(IN_PLANE),
                          np.array([-0.53, height]), np.array([10.0, 0.0]), 0.1),
                     Method(integrator=method, step_size=0.01))

    for height in (0.3, 0.100001):
        assert fly(height).position == pytest.approx([0.47, height], abs=1e-7)
    for height in (0.099, 0.0, -0.05):
        with pytest.raises(NumericalError, match=r'contact \(solid\) was passed.* t = 0.05 s'):
            fly(height)
