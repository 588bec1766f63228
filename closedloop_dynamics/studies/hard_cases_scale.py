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

"""Hard cases: very light, heavy, small, large, fast, many."""

from dataclasses import replace
import math

import numpy as np

from .hard_case import Case
from .hard_machines import G, gravity, hinge, ladder, off_the_branch, scene, with_masses
from ..mechanism.mechanism import Body, Joint, Mechanism, PRISMATIC
from ..simulation.scene import load_scene
from ..simulation.simulation import Simulation

GROUP = 'Scale'


def exact_acceleration(mechanism, tilt, size, strength):
    """Return the angular acceleration of the parallel branch of any ladder."""
    inertia, weight = 0.0, 0.0
    for body in mechanism.bodies:
        leg = body.name.startswith('leg')
        inertia += body.mass * size * size * (1.0 / 3.0 if leg else 1.0)
        weight += body.mass * size * strength * (0.5 if leg else 1.0)
    return weight / inertia * math.sin(tilt)


def fall(mechanism, q, qd, method, steps, size=1.0, strength=G):
    """Return the worst error of acceleration along the parallel branch, relative."""
    simulation = Simulation(
        scene(mechanism, q, qd, method, gravity(strength=strength)))
    worst = 0.0
    for _ in range(10):
        for _ in range(steps // 10):
            simulation.step()
        error = simulation.acceleration[0] + exact_acceleration(
            mechanism, -simulation.position[0], size, strength)
        worst = max(worst, abs(error) * size / strength, off_the_branch(simulation.position))
    return worst


def _masses(factors):
    def run(method, quick):
        return max(fall(with_masses(mechanism, dict.fromkeys(light, factor)), q, qd,
                        replace(method, step_size=2e-3), 100)
                   for mechanism, q, qd in (ladder(2, 0.4),)
                   for light in (('leg_1',), ('coupler_0',), ('leg_0', 'coupler_1'))
                   for factor in factors)
    return run


def _sizes(method, quick):
    return max(fall(*ladder(2, 0.4, 1.0 / math.sqrt(size), size=size),
                    replace(method, step_size=2e-3 * math.sqrt(size)), 200, size)
               for size in (1e-4, 1e-2, 1.0, 1e3))


def _gravity(method, quick):
    strong = fall(*ladder(2, 0.4, 0.0), replace(method, step_size=2e-5), 1000, strength=1e4)
    # Without gravity the rate stays.
    simulation = Simulation(scene(*ladder(2, 0.4), replace(method, step_size=2e-3),
                                  gravity(strength=0.0)))
    simulation.step(duration=1.0)
    return max(strong, abs(simulation.velocity[0] + 1.0))


def _spin(method, quick):
    rate, steps = 1e4, 2000 if quick else 10000
    simulation = Simulation(scene(*ladder(1, 0.4, rate), replace(
        method, step_size=1e-6, tolerance=1e-9), {}))
    simulation.advance(np.zeros(3), steps)
    phase = simulation.position[0] + 0.4 + rate * simulation.time
    return max(abs(phase), off_the_branch(simulation.position))


def _fast(method, quick):
    """Spin at 1000 rad/s for a second, 318 times through flat positions."""
    rate = 1e3
    simulation = Simulation(scene(*ladder(1, 0.4, rate), replace(
        method, step_size=1e-5, tolerance=1e-9), {}))
    simulation.advance(np.zeros(3), 10_000 if quick else 100_000)
    phase = simulation.position[0] + 0.4 + rate * simulation.time
    return max(abs(phase), off_the_branch(simulation.position))


def light_cart(mass=1e-6):
    """
    Return a light cart on a rail, and a pendulum of 1 kg on 1 m, nearly upright.

    Parameters
    ----------
    mass : float
        Of the cart [kg].

    Returns
    -------
    tuple
        Mechanism, coordinates, rates.

    """
    bodies = (Body('cart', mass, (0.0, 0.0), 0.0), Body('pendulum', 1.0, (1.0, 0.0), 0.0))
    joints = (Joint('rail', PRISMATIC, 'ground', 'cart', (0.0, 0.0), 0.0),
              hinge('pivot', 'cart', 'pendulum'))
    return (Mechanism('cart', bodies, joints), np.array([0.0, 1.0]), np.zeros(2))


def _light_cart(method, quick):
    """
    Let the pendulum fall: nothing holds it aside, so that it bounces as if it hit a wall.

    The turn at the bottom takes 1e-7 s, at thousands of radians a second.

    """
    simulation = Simulation(scene(*light_cart(), replace(
        method, step_size=1e-3, tolerance=1e-9), gravity(0.0)))
    start, worst = simulation.energy, 0.0
    for _ in range(100):
        simulation.step(duration=0.05 if quick else 0.2)
        worst = max(worst, abs(simulation.energy - start) / G)
    return worst


def _impulse(method, quick):
    start = load_scene('three_rrr')
    simulation = Simulation(replace(start, method=replace(method, step_size=1e-3)))
    simulation.step((1e6, 0.0, 0.0))
    simulation.step(duration=0.01)
    if not (np.isfinite(simulation.position).all() and np.isfinite(simulation.velocity).all()):
        return math.nan
    return simulation.closure


def _many(method, quick):
    return fall(*ladder(60 if quick else 1000, 0.4), replace(method, step_size=1e-3), 20)


_FIGURE = 'error of acceleration, relative, or angle off the branch'
CASES = (
    Case('mass ratio 1e8', GROUP,
         'Links of a two-loop ladder 1e-8 to 1e8 times as heavy as the others; acceleration '
         'against the closed form.',
         _FIGURE, 1e-8, 1e-3, _masses((1e-8, 1e-6, 1e-3, 1e3, 1e6, 1e8))),
    Case('massless links', GROUP,
         'Some links without any mass: the inertia matrix of their subsystem is singular, the '
         'mechanism is not.',
         _FIGURE, 1e-8, 1e-3, _masses((0.0,))),
    Case('0.1 mm to 1 km', GROUP,
         'The ladder with links of 1e-4, 1e-2, 1 and 1e3 m.',
         _FIGURE, 1e-8, 1e-3, _sizes),
    Case('gravity 0 to 1e4', GROUP,
         'The ladder without gravity, and at a thousand times that of the Earth.',
         _FIGURE, 1e-8, 1e-3, _gravity),
    Case('10,000 rad/s', GROUP,
         'A parallelogram that spins at 10,000 rad/s, without gravity: steady, through all its '
         'flat positions.',
         'error of the phase, or angle off the branch [rad]', 1e-6, 1e-2, _spin,
         '10 ms / 2 ms'),
    Case('1000 rad/s for 1 s', GROUP,
         'The same at 1000 rad/s for a second (else 0.1 s), in steps of 10 us or with a tolerance '
         'of 1e-9.',
         'error of the phase, or angle off the branch [rad]', 1e-6, 1e-2, _fast,
         '1 s / 0.1 s'),
    Case('cart of 1 mg', GROUP,
         'A pendulum of 1 kg on a cart of 1e-6 kg for 20 s (else 5 s): it turns at the bottom '
         'within 1e-7 s, as if it bounced. Steps of 1 ms, or a tolerance of 1e-9.',
         'energy error, relative', 1e-5, 1e-2, _light_cart,
         '20 s / 5 s'),
    Case('1e6 N m in a step', GROUP,
         'A torque of 1e6 N m on the 3-RRR for one step of 1 ms: closed and finite, or refused.',
         'closure error [m]', 1e-9, 1e-5, _impulse),
    Case('1000 loops', GROUP,
         'A ladder of 1000 loops (60 with --quick).',
         _FIGURE, 1e-8, 1e-3, _many,
         '1000 loops / 60'),
)
