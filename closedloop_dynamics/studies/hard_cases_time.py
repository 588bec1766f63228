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

"""Hard cases: runs that last."""

from dataclasses import replace
import math

import numpy as np

from .hard_case import Case
from .hard_machines import ladder, off_the_branch, scene
from ..integration.registry import FIXED, INTEGRATORS
from ..simulation.scene import load_scene
from ..simulation.simulation import Simulation

GROUP = 'Time'
# Working speed of the carpet scraping mechanism, 45 rpm [rad/s].
CRANK_RATE = 4.7124


def _long(name, drive=None):
    """Return the run of a shipped scene for an hour in steps of 1 ms, driven or left alone."""
    def run(method, quick):
        duration = 10.0 if quick else 3600.0
        start = load_scene(name)
        simulation = Simulation(replace(start, method=replace(method, step_size=1e-3)))
        energy, worst = simulation.energy, 0.0
        tau = np.zeros(len(simulation.joint_names))
        # A drive answers every millisecond, as a node does; nobody else needs to be asked.
        portion = 1 if drive else 1000 if INTEGRATORS[method.integrator].kind == FIXED else 100
        looks = 0
        while simulation.time < duration - 1e-6:
            if drive:
                drive(simulation, tau)
            simulation.advance(tau, portion)
            looks += 1
            if looks % (1000 // portion) == 0:
                worst = max(worst, simulation.closure)
                # The energy is bounded, or something is very wrong.
                if not drive and not abs(simulation.energy - energy) < 0.5 * abs(energy) + 1.0:
                    return math.inf
        if drive:
            # The crank's angle counts on; the tool returns with every turn.
            turns = CRANK_RATE * simulation.time
            if not abs(simulation.position[0] - turns) < 1.0:
                return math.inf
        return worst
    return run


def _at_working_speed(simulation, tau):
    """Hold the scraper's crank at its working speed by a proportional-integral torque."""
    behind = CRANK_RATE * simulation.time - simulation.position[0]
    slow = CRANK_RATE - simulation.velocity[0]
    tau[0] = min(400.0, max(-400.0, 100.0 * behind + 20.0 * slow))


def _turning(method, quick):
    """Let a parallelogram turn steadily, twice a turn through its flat positions."""
    duration = 10.0 if quick else 3600.0
    rate = 10.0
    simulation = Simulation(scene(*ladder(1, 0.4, rate), replace(
        method, step_size=1e-3, tolerance=1e-9), {}))
    worst, tau = 0.0, np.zeros(3)
    while simulation.time < duration - 1e-6:
        simulation.advance(tau, 1000)
        phase = abs(simulation.position[0] + 0.4 + rate * simulation.time)
        worst = max(worst, phase / max(1.0, rate * simulation.time),
                    off_the_branch(simulation.position))
        if not worst < 1.0:
            return math.inf
    return worst


def _fine(name):
    def run(method, quick):
        steps = 20_000 if quick else 10_000_000
        start = load_scene(name)
        simulation = Simulation(replace(start, method=replace(method, step_size=5e-6)))
        tau, worst = np.zeros(len(simulation.joint_names)), 0.0
        for _ in range(steps // 10_000):
            simulation.advance(tau, 10_000)
            worst = max(worst, simulation.closure, simulation.health.closure)
        return worst
    return run


CASES = (
    Case('3-RRR for long', GROUP,
         'The 3-RRR falling free, chaotic, 1 ms: loops closed and energy bounded (an hour for the '
         'default method, 10 s for the others).',
         'closure error [m]', 1e-10, 1e-4, _long('three_rrr'),
         '1 h / 10 s'),
    Case('scraper for long', GROUP,
         'The carpet scraping mechanism at its working speed, its drive asked every millisecond: '
         'loops closed, the crank counts on.',
         'closure error [m]', 1e-10, 1e-4, _long('carpet_scraper', _at_working_speed),
         '1 h / 10 s'),
    Case('turning for long', GROUP,
         'A parallelogram turns at 10 rad/s for as long, twice a turn through flat positions, and '
         'keeps phase and branch.',
         'error of the phase, relative, or angle off the branch [rad]', 1e-9, 1e-4, _turning,
         '1 h / 10 s'),
    Case('1e7 steps, 3-RRR', GROUP,
         'The 3-RRR in steps of 5 us, ten million of them (20,000 but for the default method): '
         'none fails.',
         'closure error [m]', 1e-9, 1e-4, _fine('three_rrr'),
         '1e7 steps / 2e4'),
    Case('1e7 steps, scraper', GROUP,
         'The same for the carpet scraping mechanism.',
         'closure error [m]', 1e-9, 1e-4, _fine('carpet_scraper'),
         '1e7 steps / 2e4'),
)
