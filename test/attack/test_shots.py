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

"""
Attack: shots at solids of all shapes, from a millimetre to a metre, at 0.1 to 100 m/s.

A run that ends elsewhere than the reference, by more than the start's own uncertainty explains,
and says nothing, is a silent one.

"""

import collections
import warnings

from closedloop_dynamics.simulation.errors import SimulationError
from closedloop_dynamics.simulation.scene_records import Initial, Method, Scene
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
import pytest

from ..reference.shots import draw, KINDS

# Of each method its setting, what of the way and the speed it may miss, and to what it is good.
METHODS = {
    'auto': ({}, 2e-3, 1e-5), 'auto, coarse': ({'accuracy': 1e-3}, 1e-2, 1e-3),
    'auto, fine': ({'accuracy': 1e-9}, 2e-3, 1e-8),
    'dop853': ({'tolerance': 1e-7}, 2e-3, 1e-5), 'rodas4': ({'tolerance': 1e-7}, 2e-3, 1e-5)}


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


def outcome(number):
    """Return what became of a shot."""
    shot, name = draw(number), list(METHODS)[number // len(KINDS) % len(METHODS)]
    if shot.distance(shot.place)[0] <= shot.radius:
        return 'none'
    setting, share, uncertain = METHODS[name]
    size = len(shot.mass)
    still = (0.0, 0.0, 0.0) if size == 3 else ()
    end = shot.end()
    try:
        simulation = Simulation(Scene(
            'shot', None, '', shot.mechanism,
            Initial((*shot.place, *still, *((1.0,) if still else ())), (*shot.velocity, *still)),
            {'solid': shot.effect},
            Method(integrator=name.split(',')[0], step_size=shot.duration / (1 + number % 11),
                   **setting)))
        simulation.step(duration=shot.duration)
        simulation.judge()
    except SimulationError:
        return 'stopped'
    place, velocity = simulation.position[:size], simulation.velocity[:size]
    start = shot.energy(shot.place, shot.velocity)
    missed = max(np.abs(place - end[0]).max() / (shot.duration * shot.speed),
                 np.abs(velocity - end[1]).max() / shot.speed,
                 abs(shot.energy(place, velocity) - start) / start)
    if missed <= share or missed <= allowed(shot, end, share, uncertain):
        return 'right'
    return 'warned' if simulation.report().findings else 'silent'


@pytest.mark.parametrize('first, count', [
    (0, 50), pytest.param(0, 3000, marks=[pytest.mark.slow, pytest.mark.timeout(7200)])])
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
