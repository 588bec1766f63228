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

"""Hard cases: configurations where the loops lose a closure equation for an instant."""

from dataclasses import replace
import math

import numpy as np

from .hard_case import Case
from .hard_machines import (
    change_point_linkage, G, gravity, ladder, ladder_energy, off_the_branch, pantograph,
    pantograph_motion, scene)
from ..integration.registry import FIXED, INTEGRATORS
from ..simulation.scene import load_scene
from ..simulation.simulation import Simulation

GROUP = 'Singular configurations'
LOOKS = 100
# Of error-controlled methods, which would not notice another raster.
TOLERANCE = 1e-8


def trials(method, count, seed=0):
    """
    Return methods, and starts, that meet the hard place differently.

    Step sizes of 2 to 12 ms for steps of fixed size, a tenth of that for a method of order 1,
    whose error would hide the singularity's; other starts for error control.

    Returns
    -------
    list of (Method, float)

    """
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(2e-3, 12e-3, count)
    if method.integrator == 'semi_implicit_euler':
        drawn *= 0.1
    if INTEGRATORS[method.integrator].kind == FIXED:
        return [(replace(method, step_size=float(size)), 0.0) for size in drawn]
    method = replace(method, tolerance=TOLERANCE, step_size=1e-2)
    return [(method, float(size)) for size in drawn]


def watch_ladder(loops, method, duration, tilt=0.0, rate=1.0, effects=None):
    """Return the worst of energy error and ten times the angle off the branch, relative."""
    simulation = Simulation(scene(*ladder(loops, tilt, rate), method, effects))
    scale = ladder_energy(loops)
    start, worst = simulation.energy, 0.0
    for _ in range(LOOKS):
        simulation.step(duration=duration / LOOKS)
        worst = max(worst, abs(simulation.energy - start) / scale,
                    10.0 * off_the_branch(simulation.position))
        if not worst < 1.0:
            return math.inf
    return worst


def _passing(loops, quick_duration, duration):
    def run(method, quick):
        count = 40 if not quick else 6 if loops < 10 else 2
        worst = max(watch_ladder(loops, variant, quick_duration if quick else duration, tilt)
                    for variant, tilt in trials(method, count))
        if INTEGRATORS[method.integrator].kind == FIXED and not (quick and loops > 10):
            fine = replace(method, step_size=1e-4)
            worst = max(worst, watch_ladder(loops, fine, quick_duration))
        return worst
    return run


def _on_flat(method, quick):
    return max(watch_ladder(loops, variant, 1.0 if quick else 3.0, 0.5 * math.pi, rate)
               for loops in (1, 2) for rate in (1.0, 5.0)
               for variant, _ in trials(method, 2 if quick else 6))


def _near_flat(method, quick):
    powers = (1, 3, 4, 5, 6, 8, 10, 12) if quick else range(1, 14)
    return max(watch_ladder(loops, variant, 1.0, 0.5 * math.pi + sign * 10.0 ** -power)
               for loops in (1, 2) for power in powers for sign in (1.0, -1.0)
               for variant, _ in trials(method, 1))


def _change_point(method, quick):
    worst = 0.0
    for variant, offset in trials(method, 6 if quick else 40):
        mechanism, q, qd = change_point_linkage()
        qd[0] += offset
        # A tenth of the Earth's gravity, so that a step is no more of a turn than above.
        simulation = Simulation(scene(mechanism, q, qd, variant, gravity(strength=0.1 * G)))
        start, scale = simulation.energy, 0.6 * G
        for _ in range(LOOKS):
            simulation.step(duration=(10.0 if quick else 20.0) / LOOKS)
            worst = max(worst, abs(simulation.energy - start) / scale)
    return worst


def _folding(method, quick):
    """Let the pantograph swing through its folded position, and start on it and beside it."""
    worst, duration = 0.0, 1.0 if quick else 3.0
    times = np.arange(1, LOOKS + 1) * duration / LOOKS
    for variant, offset in trials(method, 2 if quick else 10):
        # It swings faster than the ladders fall.
        variant = replace(variant, step_size=0.4 * variant.step_size)
        for fold in (0.6, 0.0, 1e-9, -1e-5, -1e-2):
            start = (-1.9, -1.9 + fold, 1.0 + offset, -3.0)
            simulation = Simulation(scene(*pantograph(*start), variant))
            for exact in pantograph_motion(*start, times):
                simulation.step(duration=duration / LOOKS)
                worst = max(worst, np.abs(simulation.position - exact).max())
    return worst


def _type_2(method, quick):
    """Drive the 3-RRR through poses where locked drives would leave the platform loose."""
    start = load_scene('three_rrr')
    worst, crossings = 0.0, 0
    for torque in ((5.0, -3.0, 2.0), (-4.0, 6.0, 3.0)) if quick else (
            (5.0, -3.0, 2.0), (-4.0, 6.0, 3.0), (8.0, 8.0, -8.0), (0.0, -9.0, 6.0)):
        simulation = Simulation(replace(start, method=replace(method, tolerance=TOLERANCE)))
        sign, scale = 0.0, 1.0
        for _ in range(LOOKS):
            simulation.step(torque, 2.0 / LOOKS)
            balance = simulation.energy_balance
            scale = max(scale, balance.kinetic)
            worst = max(worst, abs(balance.residual) / scale)
            # The event, as it is reported: the sine changes its sign.
            now = math.copysign(1.0, simulation.health.drive_sine)
            crossings += now * sign < 0.0
            sign = now
    return worst if crossings else math.nan


_FIGURE = 'energy error, or 10 x angle off the branch [rad], relative'
CASES = (
    Case('flat, 1 loop', GROUP,
         'Change-point four-bar (A02, N = 1) through its flat position, 40 step sizes of 2 to 12 '
         'ms and 0.1 ms: stays on the parallel branch.',
         _FIGURE, 1e-5, 1e-2, _passing(1, 2.5, 10.0),
         '41 steps, 10 s / 7 steps, 2.5 s'),
    Case('flat, 2 loops', GROUP,
         'The same with two loops: two closure equations vanish at once.',
         _FIGURE, 1e-5, 1e-2, _passing(2, 2.5, 10.0),
         '41 steps, 10 s / 7 steps, 2.5 s'),
    Case('flat, 40 loops', GROUP,
         'The same with 40 loops: one freedom becomes 41 for an instant.',
         _FIGURE, 1e-5, 1e-2, _passing(40, 0.9, 2.5),
         '41 steps, 2.5 s / 2 steps, 0.9 s'),
    Case('start flat', GROUP,
         'N = 1 and 2, starting exactly on the flat position: goes on along its velocity.',
         _FIGURE, 1e-5, 1e-2, _on_flat,
         '6 steps, 3 s / 2 steps, 1 s'),
    Case('start near flat', GROUP,
         'N = 1 and 2, starting 1e-1 to 1e-13 rad before and behind the flat position.',
         _FIGURE, 1e-5, 1e-2, _near_flat,
         '13 distances / 8'),
    Case('change point', GROUP,
         'Four-bar of 4, 1, 3, 2 m, which folds onto one line without any symmetry: keeps its '
         'energy.',
         'energy error, relative', 1e-5, 1e-2, _change_point,
         '40 steps, 20 s / 6 steps, 10 s'),
    Case('folded pantograph', GROUP,
         "The scraper's pantograph alone swings through its folded position, and starts on it and "
         'beside it: against a double pendulum, which it equals.',
         'error of the angles [rad]', 1e-5, 0.1, _folding,
         '10 steps, 3 s / 2 steps, 1 s'),
    Case('type-2 pose', GROUP,
         '3-RRR driven by torques through parallel-singular poses, each reported: energy equals '
         'work.',
         'energy without source, relative', 1e-6, 1e-2, _type_2,
         '4 torques / 2'),
)
