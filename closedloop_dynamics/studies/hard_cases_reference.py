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


"""Hard cases whose answers are known: published benchmarks and closed forms."""

from dataclasses import replace
import math

import numpy as np

from .hard_case import Case
from .hard_machines import G, gravity, hinge, ladder, ladder_energy, scene
from ..effects.external_force import ExternalForce
from ..effects.joint_friction import JointFriction
from ..effects.joint_spring import JointSpring
from ..effects.point_spring import PointSpring
from ..integration.switching import SHARE
from ..mechanism.mechanism import (
    Body, CutJoint, Joint, Mechanism, Point, PRISMATIC, REVOLUTE)
from ..simulation.scene_records import Initial, Scene
from ..simulation.simulation import Simulation

GROUP = 'Known answers'
# Of error-controlled methods: rounding, almost.
TIGHT = 1e-11
# Largest gap of the pendulum's loop, and error of its place, that count as accurate [m].
GAP, ACCURATE = 1e-10, 1e-3

# Place of the pendulum (A01) at 2000 s, from rest at (1, 0) [m].
PENDULUM = (2000.0, (-0.8146030686, -0.5800188278))
# [s].
PERIOD = 2.367841947576
# Loops, time [s], place [m] and velocity [m/s] of the first leg's tip of the ladder (A02).
LADDERS = (
    (1, 10.0, (0.4783850578, 0.8781501788), (1.727264076, -0.940952179)),
    (2, 10.0, (0.3284581115, 0.9445185382), (1.423051470, -0.494868845)),
    (2, 20.0, (0.8397465743, 0.5429785364), (1.838222644, -2.842913789)),
    (40, 20.0, (0.4109011537, 0.9116799010), (1.566785372, -0.706162236)))
# Crank angle, slide and rod angle of the slider-crank at 10 s, and their rates.
SLIDER_CRANK = (
    (1.275675848650, 1.023578558980, -0.498813049182),
    (-0.239914997196, 0.133778283216, 0.039731495991))


def tight(method, step_size, tolerance=TIGHT):
    """
    Return a method with a step and a tolerance.

    A tenth of that step for a method of order 1, as at singular configurations.

    """
    coarse = method.integrator == 'semi_implicit_euler'
    return replace(method, step_size=0.1 * step_size if coarse else step_size,
                   tolerance=tolerance, accuracy=tolerance / SHARE)


def looped_pendulum():
    """
    Return a pendulum (A01: 1 kg on 1 m, from rest at +x) as a loop.

    Half of the mass sits on the rod, the other half on two slides; a cut joint holds them
    together, so that there is a gap to watch.

    """
    bodies = (Body('rod', 0.5, (1.0, 0.0), 0.0), Body('slider', 0.0, (0.0, 0.0), 0.0, True),
              Body('half', 0.5, (0.0, 0.0), 0.0))
    joints = (hinge('pivot', 'ground', 'rod', actuated=True),
              Joint('x', PRISMATIC, 'ground', 'slider', (0.0, 0.0), 0.0),
              Joint('y', PRISMATIC, 'slider', 'half', (0.0, 0.0), 0.5 * math.pi))
    cuts = (CutJoint('pin', REVOLUTE, 'rod', 'half', (1.0, 0.0), (0.0, 0.0)),)
    return (Mechanism('looped_pendulum', bodies, joints, cuts), np.array([0.0, 1.0, 0.0]),
            np.zeros(3))


def watch_pendulum(method, duration, looks):
    """Return a falling looped pendulum's place at the end, its energy at looks, and worst gap."""
    simulation = Simulation(scene(*looped_pendulum(), method, gravity(0.0)))
    energies, gap = [simulation.energy], 0.0
    for _ in range(looks):
        simulation.step(duration=duration / looks)
        energies.append(simulation.energy)
        gap = max(gap, simulation.closure)
    return simulation.position[1:], np.array(energies), gap


def _pendulum(method, quick):
    """Let the pendulum swing, half an hour nearly, and compare its place."""
    if quick:
        place, _, gap = watch_pendulum(tight(method, 1e-3), 10 * PERIOD, 100)
        error = np.abs(place - (1.0, 0.0)).max()
    else:
        time, exact = PENDULUM
        place, _, gap = watch_pendulum(tight(method, 1e-3), time, 2000)
        error = np.abs(place - exact).max()
    return max(error, gap * ACCURATE / GAP)


def _ladders(method, quick):
    """Let ladders fall and turn through many flat positions, and compare place and velocity."""
    worst = 0.0
    for loops, duration, place, velocity in LADDERS[:2] if quick else LADDERS:
        simulation = Simulation(scene(
            *ladder(loops, direction=0.0), tight(method, 1e-3, 1e-9), gravity(0.0)))
        simulation.step(duration=duration)
        # From the leg's direction, clockwise from upright.
        angle, rate = -simulation.position[0], -simulation.velocity[0]
        tip = (math.sin(angle), math.cos(angle))
        worst = max(worst, np.abs(np.subtract(tip, place)).max(),
                    np.abs(rate * np.array([tip[1], -tip[0]]) - velocity).max())
    return worst


def slope(energies, duration, scale):
    """Return the slope of the line through energies at even intervals [1/s]."""
    times = np.linspace(0.0, duration, len(energies))
    return abs(np.polyfit(times, energies, 1)[0]) / scale


def _energy_slope(method, quick):
    """Let the pendulum swing for 2000 s and the two-loop ladder for 100 s, tightly."""
    duration = 20.0 if quick else 2000.0
    _, energies, _ = watch_pendulum(tight(method, 1e-3), duration, 200)
    worst = slope(energies, duration, G)
    duration = 10.0 if quick else 100.0
    # Half the step: the energy of classical RK4 falls by the fifth power of it.
    simulation = Simulation(scene(*ladder(2), tight(method, 5e-4)))
    energies = [simulation.energy]
    for _ in range(200):
        simulation.step(duration=duration / 200)
        energies.append(simulation.energy)
    return max(worst, slope(np.array(energies), duration, ladder_energy(2)))


def slider_crank():
    """Return the slider-crank of SUNDIALS' idasSlCrank: its slider has no mass."""
    rod_angle = math.asin(-0.5)
    bodies = (Body('crank', 1.0, (0.0, 0.0), 1.0), Body('rod', 1.0, (1.0, 0.0), 2.0),
              Body('slider', 0.0, (0.0, 0.0), 0.0, True))
    joints = (hinge('crank_joint', 'ground', 'crank', actuated=True),
              hinge('rod_joint', 'crank', 'rod', 0.5),
              Joint('slide', PRISMATIC, 'ground', 'slider', (0.0, 0.0), 0.0))
    cuts = (CutJoint('pin', REVOLUTE, 'rod', 'slider', (1.0, 0.0), (0.0, 0.0)),)
    points = (Point('middle_of_crank', 'crank', (0.25, 0.0)),
              Point('middle_of_rod', 'rod', (0.5, 0.0)), Point('end_of_rod', 'rod', (2.0, 0.0)))
    crank_angle = 0.5 * math.pi
    return (Mechanism('slider_crank', bodies, joints, cuts, points),
            np.array([crank_angle, rod_angle - crank_angle, math.cos(rod_angle)]), np.zeros(3))


SLIDER_CRANK_EFFECTS = {
    'spring': PointSpring('middle_of_crank', 'middle_of_rod', stiffness=1.0, damping=1.0,
                          free_length=1.0),
    'push': ExternalForce('end_of_rod', (1.0, 0.0))}


def _slider_crank(method, quick):
    mechanism, q, qd = slider_crank()
    simulation = Simulation(scene(
        mechanism, q, qd, tight(method, 5e-3, 1e-10), SLIDER_CRANK_EFFECTS))
    simulation.step(duration=10.0)
    worst = 0.0
    for (crank, rod, slide), exact in zip(
            (simulation.position, simulation.velocity), SLIDER_CRANK):
        worst = max(worst, np.abs(np.subtract((crank, slide, crank + rod), exact)).max())
    return worst


def _impulse(method, quick):
    """Hit an upright parallelogram, between two steps, with 1 N m s in 0.1 ms."""
    worst = 0.0
    for wait in (0.0, 0.0123, 0.0337, 0.00049):
        mechanism, q, qd = ladder(1, 0.0, 0.0)
        simulation = Simulation(scene(mechanism, q, qd, replace(
            method, tolerance=1e-9, step_size=1e-3), {}))
        simulation.step(duration=wait)
        simulation.step((1e4,), 1e-4)
        worst = max(worst, abs(simulation.velocity[0] - 0.6))
        simulation.step(duration=0.05)
        worst = max(worst, abs(simulation.velocity[0] - 0.6))
    return worst


FRICTION = {
    'spring': JointSpring('slide', 100.0, 0.0), 'friction': JointFriction('slide', 1.0)}


def stuck_mass(method):
    """Return a mass of 1 kg on a spring, with dry friction of 1 N, pulled out by 0.105 m."""
    mechanism = Mechanism('mass', (Body('mass', 1.0, (0.0, 0.0), 0.0),), (
        Joint('slide', PRISMATIC, 'ground', 'mass', (0.0, 0.0), 0.0),))
    return Simulation(Scene('mass', None, '', mechanism, Initial((0.105,), (0.0,)), FRICTION,
                            method))


def _stick(method, quick):
    """Let the mass slide to rest after five half swings, and hold it there."""
    size = 1e-6 if method.integrator == 'semi_implicit_euler' else method.step_size
    simulation = stuck_mass(replace(
        method, step_size=size, tolerance=TIGHT, accuracy=TIGHT / SHARE))
    simulation.step(duration=2.0)
    rest = simulation.position[0]
    worst = abs(rest + 0.005)
    simulation.step(duration=2.0 if quick else 100.0)
    if not simulation.position[0] == rest:
        # Any creep would go on.
        worst = max(worst, 1e3 * abs(simulation.position[0] - rest))
    return worst


CASES = (
    Case('pendulum, 2000 s', GROUP,
         'A pendulum (A01), half of its mass in a loop: its place after 2000 s against the '
         'printed reference (else after ten periods), its gap always below 1e-10 m.',
         'error of its place, or 1e7 x the gap [m]', ACCURATE, 1e-1, _pendulum,
         '2000 s / 24 s'),
    Case('slope of the energy', GROUP,
         'The same pendulum over 2000 s (else 20 s), and the two-loop ladder over 100 s (else 10 '
         's) with steps of 0.5 ms or a tolerance of 1e-11: no trend.',
         'slope of the energy, relative [1/s]', 1e-9, 1e-3, _energy_slope,
         '2000 and 100 s / 20 and 10 s'),
    Case('A02 to its end', GROUP,
         'Ladders of 1, 2 and 40 loops (else 1 and 2) after 10 to 20 s and up to twenty flat '
         'passes: place and velocity against the exact ones.',
         "error of a tip's place and velocity [m, m/s]", 1e-3, 1e-1, _ladders,
         'N to 40, 20 s / N to 2, 10 s'),
    Case('slider-crank', GROUP,
         'That of SUNDIALS with its massless slider, spring, damper and force, after 10 s, in '
         'steps of 5 ms: against two derivations that agree to 1e-13.',
         'error of angles, slide and rates [rad, m; /s]', 1e-6, 1e-3, _slider_crank),
    Case('1 N m s in 0.1 ms', GROUP,
         'An impulse between two steps on an upright parallelogram: its rate changes by 0.6 '
         'rad/s, no step misses it.',
         'error of the rate [rad/s]', 1e-6, 1e-3, _impulse),
    Case('stick and slip', GROUP,
         'A mass on a spring comes to rest by dry friction at -0.005 m, and does not creep in '
         '100 s (else 2 s).',
         'error of its place, or 1000 x its creep [m]', 1e-9, 1e-5, _stick,
         '100 s / 2 s'),
)
