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

"""Hard cases: closure equations that repeat one another."""

from dataclasses import replace
import math

import numpy as np

from .hard_case import Case
from .hard_machines import doubled, G, scene, three_rockers, welded_twice
from ..simulation.scene import load_scene
from ..simulation.simulation import Simulation

GROUP = 'Redundant constraints'
STEPS, LOOKS = 50, 6


def compare(redundant, single):
    """Return the worst relative difference of accelerations along a motion."""
    worst = 0.0
    for _ in range(LOOKS):
        for _ in range(STEPS):
            redundant.step()
        acceleration, _ = single.forward_dynamics(redundant.position, redundant.velocity)
        scale = np.abs(acceleration).max()
        worst = max(worst, np.abs(redundant.acceleration - acceleration).max() / scale)
    if redundant.health.unique_forces:
        return math.inf
    return worst


def _doubled(name):
    def run(method, quick):
        start = load_scene(name)
        start = replace(start, method=replace(method, step_size=1e-3))
        twice = Simulation(replace(start, mechanism=doubled(start.mechanism)))
        worst = compare(twice, Simulation(start))
        forces = twice.constraint_forces
        half = len(forces) // 2
        _, together = Simulation(start).forward_dynamics(twice.position, twice.velocity)
        if twice.health.rank != len(together):
            return math.inf
        share = twice.multipliers.reshape(2, -1)
        # The least forces share the load evenly, and make up the whole of it.
        return max(worst, np.abs(forces[:half] - forces[half:]).max() / np.abs(forces).max(),
                   np.abs(share.sum(axis=0) - together).max() / np.abs(together).max())
    return run


def _three_rockers(method, quick):
    simulation = Simulation(scene(*three_rockers(), replace(method, step_size=2e-3)))
    worst = 0.0
    for _ in range(LOOKS):
        for _ in range(STEPS):
            simulation.step()
        # Three legs of 1 kg about their ends, one coupler that does not turn.
        tilt = -simulation.position[0]
        exact = G * (3 / 2 + 1) / (3 / 3 + 1) * math.sin(tilt)
        worst = max(worst, abs(simulation.acceleration[0] + exact) / G)
    return math.inf if simulation.health.unique_forces else worst


def _welded(method, quick):
    mechanism, q, qd = welded_twice()
    method = replace(method, step_size=2e-3)
    once = replace(mechanism, cut_joints=mechanism.cut_joints[:1])
    # One weld in a hinged pair is two equations too many, too: compare with one body.
    simulation = Simulation(scene(mechanism, q, qd, method))
    inertia = 1.0 / 3.0 + 2.0 * 0.25 / 12.0 + 2.0 * 1.25 ** 2
    worst = 0.0
    for _ in range(LOOKS):
        for _ in range(STEPS):
            simulation.step()
        angle = simulation.position[0]
        x, y = simulation.scene.effects['gravity'].acceleration
        moment = (0.5 + 2.0 * 1.25) * (math.cos(angle) * y - math.sin(angle) * x)
        worst = max(worst, abs(simulation.acceleration[0] - moment / inertia) / G)
    lonely = Simulation(scene(once, q, qd, method)).health.unique_forces
    return math.inf if simulation.health.unique_forces or lonely else worst


CASES = (
    Case('3-RRR, loops twice', GROUP,
         'Every cut joint of the 3-RRR twice: the same motion to 1e-9, each pair shares the force '
         'of one, its rank is told, and that the forces are not unique.',
         'difference, relative', 1e-9, 1e-3, _doubled('three_rrr')),
    Case('scraper, loops twice', GROUP,
         'The same for the carpet scraping mechanism.',
         'difference, relative', 1e-9, 1e-3, _doubled('carpet_scraper')),
    Case('three rockers', GROUP,
         'Parallelogram on three equal rockers: moves only because the lengths agree; '
         'acceleration against the closed form.',
         'difference, relative', 1e-9, 1e-3, _three_rockers),
    Case('welded twice', GROUP,
         'Two hinged bodies welded by two fixed cut joints, six equations for one freedom.',
         'difference, relative', 1e-9, 1e-3, _welded),
)
