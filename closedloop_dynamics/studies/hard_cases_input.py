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

"""Hard cases: input that contradicts itself."""

from dataclasses import replace
import math

import numpy as np

from .hard_case import Case
from .hard_cases_singular import watch_ladder
from .hard_machines import ladder, ladder_energy, scene
from ..simulation.scene import load_scene
from ..simulation.simulation import Simulation

GROUP = 'Inconsistent input'


def _velocities(method, quick):
    """Start with random rates: they are made to fit, and stay so."""
    start, worst = load_scene('three_rrr'), 0.0
    rng = np.random.default_rng(1)
    for _ in range(3 if quick else 20):
        simulation = Simulation(replace(start, method=replace(method, step_size=1e-3)))
        simulation.set_state(simulation.position, rng.normal(size=7))
        for _ in range(20):
            simulation.step()
        worst = max(worst, simulation.closure)
    return worst


def _by_hand(method, quick):
    """Shake all coordinates by a hundredth of a radian: the nearest closed state is taken."""
    start, worst = load_scene('carpet_scraper'), 0.0
    rng = np.random.default_rng(2)
    simulation = Simulation(replace(start, method=replace(method, step_size=1e-3)))
    position = simulation.position
    for _ in range(5 if quick else 40):
        simulation.set_state(position + rng.uniform(-1e-2, 1e-2, len(position)))
        moved = np.abs(simulation.position - position).max()
        worst = max(worst, simulation.closure, 0.0 if moved < 0.1 else moved)
        simulation.step()
    return worst


def _large_steps(method, quick):
    return max(watch_ladder(2, replace(method, step_size=size), 3.0)
               for size in (0.01, 0.02, 0.05))


def _changed_step(method, quick):
    simulation = Simulation(scene(*ladder(2), replace(method, tolerance=1e-8)))
    start, worst = simulation.energy, 0.0
    for size in (1e-3, 4e-3, 2e-4, 7e-3, 1e-3) * (1 if quick else 4):
        simulation.set_step_size(size)
        simulation.step(duration=0.5)
        worst = max(worst, abs(simulation.energy - start) / ladder_energy(2))
    return worst


def _broken(method, quick):
    start = load_scene('four_bar')
    cut = start.mechanism.cut_joints[0]
    broken = replace(start.mechanism, cut_joints=(
        replace(cut, point_a=tuple(0.01 * value for value in cut.point_a)),))
    Simulation(replace(start, mechanism=broken, method=method))
    return math.inf


CASES = (
    Case('velocities that part', GROUP,
         'The 3-RRR started with random joint rates: the nearest ones that the loops allow.',
         'closure error [m]', 1e-9, 1e-4, _velocities,
         '20 starts / 3'),
    Case('states by hand', GROUP,
         'All joints of the scraper moved by up to 0.01 rad: the nearest closed state, on its '
         'branch.',
         'closure error [m]', 1e-12, 1e-4, _by_hand,
         '40 states / 5'),
    Case('10, 20, 50 ms steps', GROUP,
         'The two-loop ladder with steps far too large: still on its branch, or refused.',
         'energy error, or 10 x angle off the branch [rad], relative', 1e-5, 0.1, _large_steps),
    Case('step size changed', GROUP,
         'The two-loop ladder with its step changed while it runs, 0.2 to 7 ms.',
         'energy error, relative', 1e-5, 1e-2, _changed_step,
         '10 s / 2.5 s'),
    Case('cannot be assembled', GROUP,
         'A four-bar whose coupler is a hundred times too short: there is nothing but to refuse.',
         'none: to be refused', 0.0, 0.0, _broken),
)
