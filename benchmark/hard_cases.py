# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The hard cases of the stability atlas, which hard_cases.yaml lists, and how each is judged.

What a case runs takes the method, whether it is to be quick, and keywords of the list; it returns
the worst figure, or raises SimulationError where it is refused.
"""

from dataclasses import dataclass, replace
from functools import partial
import math
from operator import attrgetter
from pathlib import Path
from typing import Callable

from closedloop_dynamics.effects.contact import Contact
from closedloop_dynamics.effects.external_force import ExternalForce
from closedloop_dynamics.effects.joint_friction import JointFriction
from closedloop_dynamics.effects.joint_spring import JointSpring
from closedloop_dynamics.effects.point_spring import PointSpring
from closedloop_dynamics.engine.status import SHARE
from closedloop_dynamics.mechanism.errors import SimulationError, StiffnessError
from closedloop_dynamics.mechanism.mechanism import (
    Body, CutJoint, Joint, Mechanism, Point, PRISMATIC, REVOLUTE)
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.scene.records import Initial, Method, Scene
from closedloop_dynamics.simulation.simulation import Simulation
import hard_cases_at_contacts
import hard_cases_in_space
from hard_machines import (
    bar, change_point_linkage, doubled, effect_of, energy_error, fixed, G, gravity,
    gravity_in_space, hinge, in_space, ladder, ladder_energy, off_the_branch, own_step, pantograph,
    pantograph_motion, scene, started, stepped, three_rockers, TIGHT, tight, welded_twice,
    with_masses, worst_of)
import numpy as np
import yaml

ACCURATE, DEGRADED, REFUSED, UNSTABLE, SKIPPED = (
    'accurate', 'degraded but stable', 'refused with reason', 'unstable', 'not run')


@dataclass(frozen=True)
class Case:
    """One hard case."""

    name: str
    group: str  # Heading that it belongs to
    text: str  # The difficulty and the criterion: two lines at most
    figure: str  # What its number is, with its unit
    # Up to which figure a result counts as accurate, and as degraded but stable.
    accurate: float
    stable: float
    run: Callable  # Of a method, and whether it is to be quick
    # How much is run, in full and with ``quick``, parted by a slash; empty where it is the
    # same.
    lengths: str = ''


@dataclass(frozen=True)
class Outcome:
    """Result of one case with one method."""

    status: str  # ``ACCURATE``, ``DEGRADED``, ``REFUSED``, ``UNSTABLE`` or ``SKIPPED``
    figure: float  # The worst one; NaN where refused or not run
    note: str = ''  # The reason where refused


def judge(case, method, quick):
    """Run one case with one method."""
    try:
        figure = float(case.run(method, quick))
    except SimulationError as error:
        return Outcome(REFUSED, math.nan, f'{type(error).__name__}: {error}')
    # Every comparison with NaN is false: such a figure is unstable.
    if figure <= case.accurate:
        return Outcome(ACCURATE, figure)
    if figure <= case.stable:
        return Outcome(DEGRADED, figure)
    return Outcome(UNSTABLE, figure, 'the figure is out of bounds, and nothing was said')


# Singular configurations.

LOOKS = 100
# Of error-controlled methods, which would not notice another output grid.
TRIAL_TOLERANCE = 1e-8


def trials(method, count):
    """
    Return methods, and starts, that meet the hard place differently.

    Step sizes of 2 to 12 ms for steps of fixed size, a tenth of that for a method of order 1,
    whose error would hide the singularity's; other starts for error control.
    """
    drawn = own_step(method, np.random.default_rng(0).uniform(2e-3, 12e-3, count))
    if fixed(method):
        return [(replace(method, step_size=float(size)), 0.0) for size in drawn]
    method = replace(method, tolerance=TRIAL_TOLERANCE, step_size=1e-2)
    return [(method, float(size)) for size in drawn]


def watch_ladder(loops, method, duration, tilt=0.0, rate=1.0):
    """Return the worst of energy error and ten times the angle off the branch, relative."""
    simulation = Simulation(scene(*ladder(loops, tilt, rate), method))
    return worst_of(simulation, LOOKS, duration / LOOKS,
                    energy_error(simulation, ladder_energy(loops)),
                    lambda one: 10.0 * off_the_branch(one), bound=1.0)


def passing(method, quick, loops, duration, quick_duration):
    """Drop a ladder through its flat position."""
    count = 40 if not quick else 6 if loops < 10 else 2
    worst = max(watch_ladder(loops, variant, quick_duration if quick else duration, tilt)
                for variant, tilt in trials(method, count))
    if fixed(method) and not (quick and loops > 10):
        worst = max(worst, watch_ladder(loops, replace(method, step_size=1e-4), quick_duration))
    return worst


def on_flat(method, quick):
    """Start a ladder exactly on its flat position."""
    return max(watch_ladder(loops, variant, 1.0 if quick else 3.0, 0.5 * math.pi, rate)
               for loops in (1, 2) for rate in (1.0, 5.0)
               for variant, _ in trials(method, 2 if quick else 6))


def near_flat(method, quick):
    """Start a ladder so many powers of ten from its flat position."""
    powers = (1, 3, 4, 5, 6, 8, 10, 12) if quick else range(1, 14)
    return max(watch_ladder(loops, variant, 1.0, 0.5 * math.pi + sign * 10.0 ** -power)
               for loops in (1, 2) for power in powers for sign in (1.0, -1.0)
               for variant, _ in trials(method, 1))


def change_point(method, quick):
    """Turn a linkage through the position in which it folds onto one line."""
    worst = 0.0
    for variant, offset in trials(method, 6 if quick else 40):
        mechanism, q, qd = change_point_linkage()
        qd[0] += offset
        # A tenth of the Earth's gravity, so that a step is no more of a turn than above.
        simulation = Simulation(scene(mechanism, q, qd, variant, gravity(strength=0.1 * G)))
        worst = max(worst, worst_of(simulation, LOOKS, (10.0 if quick else 20.0) / LOOKS,
                                    energy_error(simulation, 0.6 * G)))
    return worst


def folding(method, quick):
    """Swing a pantograph through its folded position; start on it and beside it."""
    worst, duration = 0.0, 1.0 if quick else 3.0
    times = np.arange(1, LOOKS + 1) * duration / LOOKS
    for variant, offset in trials(method, 2 if quick else 10):
        # It swings faster than the ladders fall.
        variant = replace(variant, step_size=0.4 * variant.step_size)
        for fold in (0.6, 0.0, 1e-9, -1e-5, -1e-2):
            start = (-1.9, -1.9 + fold, 1.0 + offset, -3.0)
            exact = iter(pantograph_motion(*start, times))
            worst = max(worst, worst_of(
                Simulation(scene(*pantograph(*start), variant)), LOOKS, duration / LOOKS,
                lambda one, exact=exact: np.abs(one.position - next(exact)).max()))
    return worst


def type_2(method, quick, torques):
    """Drive the 3-RRR through poses where locked drives would leave the platform loose."""
    worst, crossings = 0.0, 0
    for torque in torques[:2 if quick else None]:
        simulation = started('three_rrr', method, tolerance=TRIAL_TOLERANCE)
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


# Redundant constraints.

def redundant(simulation, figure):
    """Return the worst figure along a motion; infinite where forces are reported as unique."""
    worst = worst_of(simulation, 6, stepped(50), figure)
    return math.inf if simulation.health.unique_forces else worst


def loops_twice(method, quick, name):
    """Compare a scene whose loops are closed twice with one whose loops are closed once."""
    start = load_scene(name)
    start = replace(start, method=replace(method, step_size=1e-3))
    twice = Simulation(replace(start, mechanism=doubled(start.mechanism)))
    once = Simulation(start)

    def apart(one):
        acceleration, _ = once.forward_dynamics(one.position, one.velocity)
        return np.abs(one.acceleration - acceleration).max() / np.abs(acceleration).max()

    worst = redundant(twice, apart)
    forces = twice.constraint_forces
    half = len(forces) // 2
    _, together = Simulation(start).forward_dynamics(twice.position, twice.velocity)
    if twice.health.rank != len(together):
        return math.inf
    share = twice.multipliers.reshape(2, -1)
    # The least forces share the load evenly, and make up the whole of it.
    return max(worst, np.abs(forces[:half] - forces[half:]).max() / np.abs(forces).max(),
               np.abs(share.sum(axis=0) - together).max() / np.abs(together).max())


def on_three_rockers(method, quick):
    """Drop a parallelogram on three rockers."""
    # Three legs of 1 kg about their ends, one coupler that does not turn; of its tilt.
    exact = G * (3 / 2 + 1) / (3 / 3 + 1)
    return redundant(
        Simulation(scene(*three_rockers(), replace(method, step_size=2e-3))),
        lambda one: abs(one.acceleration[0] + exact * math.sin(-one.position[0])) / G)


def welded(method, quick):
    """Swing two hinged bodies that are welded twice."""
    mechanism, q, qd = welded_twice()
    method = replace(method, step_size=2e-3)
    once = replace(mechanism, cut_joints=mechanism.cut_joints[:1])
    # One weld in a hinged pair is two equations too many, too: compare with one body.
    inertia = 1.0 / 3.0 + 2.0 * 0.25 / 12.0 + 2.0 * 1.25 ** 2

    def apart(one):
        angle = one.position[0]
        x, y = one.scene.effects['gravity'].acceleration
        moment = (0.5 + 2.0 * 1.25) * (math.cos(angle) * y - math.sin(angle) * x)
        return abs(one.acceleration[0] - moment / inertia) / G

    worst = redundant(Simulation(scene(mechanism, q, qd, method)), apart)
    return math.inf if Simulation(scene(once, q, qd, method)).health.unique_forces else worst


# Scale.

def exact_acceleration(mechanism, tilt, size, strength):
    """Return the angular acceleration of the parallel branch of any ladder."""
    inertia, weight = 0.0, 0.0
    for body in mechanism.bodies:
        leg = body.name.startswith('leg')
        inertia += body.mass * size * size * (1.0 / 3.0 if leg else 1.0)
        weight += body.mass * size * strength * (0.5 if leg else 1.0)
    return weight / inertia * math.sin(tilt)


def fall(mechanism, q, qd, method, steps, size=1.0, strength=G, effects=None):
    """Return the worst error of acceleration along the parallel branch, relative."""
    def error(one):
        return abs(one.acceleration[0] + exact_acceleration(
            mechanism, -one.position[0], size, strength)) * size / strength

    return worst_of(
        Simulation(scene(mechanism, q, qd, method, effects or gravity(strength=strength))),
        10, stepped(steps // 10), error, off_the_branch)


def masses(method, quick, factors, space=False):
    """Drop a ladder with some links so many times as heavy as the others."""
    placed, effects = (in_space, gravity_in_space()) if space else (lambda flat: flat, None)
    mechanism, q, qd = ladder(2, 0.4)
    return max(fall(placed(with_masses(mechanism, dict.fromkeys(light, factor))), q, qd,
                    replace(method, step_size=2e-3), 100, effects=effects)
               for light in (('leg_1',), ('coupler_0',), ('leg_0', 'coupler_1'))
               for factor in factors)


def small_to_large(method, quick, sizes):
    """Drop ladders with links of some lengths [m]."""
    return max(fall(*ladder(2, 0.4, 1.0 / math.sqrt(size), size=size),
                    replace(method, step_size=2e-3 * math.sqrt(size)), 200, size)
               for size in sizes)


def strengths(method, quick):
    """Drop a ladder under much gravity, and turn it without."""
    strong = fall(*ladder(2, 0.4, 0.0), replace(method, step_size=2e-5), 1000, strength=1e4)
    # Without gravity the rate stays.
    simulation = Simulation(scene(*ladder(2, 0.4), replace(method, step_size=2e-3),
                                  gravity(strength=0.0)))
    simulation.step(duration=1.0)
    return max(strong, abs(simulation.velocity[0] + 1.0))


def spin_error(rate, relative=False):
    """Return a figure: how far a ladder that turned by 0.4 rad, and turns, is from its phase."""
    def error(one):
        phase = abs(one.position[0] + 0.4 + rate * one.time)
        return phase / max(1.0, rate * one.time) if relative else phase
    return error


def spinning(method, quick, rate, step_size, steps, quick_steps):
    """Spin a parallelogram, at 1000 rad/s 318 times a second flat."""
    simulation = Simulation(scene(*ladder(1, 0.4, rate), replace(
        method, step_size=step_size, tolerance=1e-9), {}))
    return worst_of(simulation, 1, quick_steps if quick else steps, spin_error(rate),
                    off_the_branch)


def light_cart(mass=1e-6):
    """Return a cart of a mass [kg] on a rail, and a pendulum of 1 kg on 1 m, nearly upright."""
    bodies = (Body('cart', mass, (0.0, 0.0), 0.0), Body('pendulum', 1.0, (1.0, 0.0), 0.0))
    joints = (Joint('rail', PRISMATIC, 'ground', 'cart', (0.0, 0.0), 0.0),
              hinge('pivot', 'cart', 'pendulum'))
    return (Mechanism('cart', bodies, joints), np.array([0.0, 1.0]), np.zeros(2))


def on_light_cart(method, quick):
    """
    Drop a pendulum from a light cart: nothing holds it aside, and it bounces as from a wall.

    The turn at the bottom takes 1e-7 s, at thousands of radians a second.
    """
    simulation = Simulation(scene(*light_cart(), replace(
        method, step_size=1e-3, tolerance=1e-9), gravity(0.0)))
    return worst_of(simulation, 100, 0.05 if quick else 0.2, energy_error(simulation, G))


def overload(method, quick):
    """Push the 3-RRR by a million N m for a step."""
    simulation = started('three_rrr', method, step_size=1e-3)
    simulation.step((1e6, 0.0, 0.0))
    simulation.step(duration=0.01)
    if not (np.isfinite(simulation.position).all() and np.isfinite(simulation.velocity).all()):
        return math.nan
    return simulation.closure


def many_loops(method, quick, loops, quick_loops):
    """Drop a ladder of many loops."""
    return fall(*ladder(quick_loops if quick else loops, 0.4), replace(method, step_size=1e-3), 20)


# Inconsistent input.

CLOSURE = attrgetter('closure')


def inconsistent_velocities(method, quick):
    """Start with random rates: they are made to fit, and stay so."""
    worst, rng = 0.0, np.random.default_rng(1)
    for _ in range(3 if quick else 20):
        simulation = started('three_rrr', method, step_size=1e-3)
        simulation.set_state(simulation.position, rng.normal(size=7))
        worst = max(worst, worst_of(simulation, 1, stepped(20), CLOSURE))
    return worst


def states_by_hand(method, quick):
    """Shake all coordinates by a hundredth of a radian: the nearest closed state is taken."""
    worst, rng = 0.0, np.random.default_rng(2)
    simulation = started('carpet_scraper', method, step_size=1e-3)
    position = simulation.position
    for _ in range(5 if quick else 40):
        simulation.set_state(position + rng.uniform(-1e-2, 1e-2, len(position)))
        moved = np.abs(simulation.position - position).max()
        worst = max(worst, simulation.closure, 0.0 if moved < 0.1 else moved)
        simulation.step()
    return worst


def large_steps(method, quick, sizes):
    """Drop a ladder in steps that are too large [s]."""
    return max(watch_ladder(2, replace(method, step_size=size), 3.0) for size in sizes)


def step_size_changed(method, quick, sizes):
    """Change the size of the steps while a ladder falls [s]."""
    simulation, worst = Simulation(scene(*ladder(2), replace(method, tolerance=1e-8))), 0.0
    error = energy_error(simulation, ladder_energy(2))
    for size in sizes * (1 if quick else 4):
        simulation.stepping.prepare_method(step_size=size)()
        worst = max(worst, worst_of(simulation, 1, 0.5, error))
    return worst


def not_assembled(method, quick):
    """Build a four-bar whose coupler is a hundred times too short."""
    start = load_scene('four_bar')
    cut = start.mechanism.cut_joints[0]
    broken = replace(start.mechanism, cut_joints=(
        replace(cut, point_a=tuple(0.01 * value for value in cut.point_a)),))
    Simulation(replace(start, mechanism=broken, method=method))
    return math.inf


# Stiffness.

STIFF_STEP = 1e-3
# Energy that may appear, relative.
BOUNDED = 1e-2


def at_rest(bodies, joints, method, effects, points=()):
    """Return a simulation of bodies on revolute joints, hanging sideways at rest."""
    mechanism = Mechanism('pendulum', bodies, joints, points=points)
    start = (0.0,) * len(joints)
    return Simulation(Scene('pendulum', None, '', mechanism, Initial(start, start),
                            {**gravity(0.0), **effects}, method))


def nearly_rigid(method, quick, effect):
    """Swing two bars, held together by a very stiff effect, like one for a second."""
    upper, lower = bar('upper', 1.0, 1.0), bar('lower', 2.0, 0.5)
    pivot = hinge('pivot', 'ground', 'upper')
    both = at_rest(
        (upper, lower), (pivot, hinge('knee', 'upper', 'lower', 1.0)),
        replace(method, step_size=STIFF_STEP, tolerance=1e-5), {'stiff': effect_of(effect)})
    center = (0.5 + 2.0 * 1.25) / 3.0
    inertia = (upper.inertia + (0.5 - center) ** 2
               + lower.inertia + 2.0 * (1.25 - center) ** 2)
    single = at_rest((Body('upper', 3.0, (center, 0.0), inertia),), (pivot,),
                     Method(step_size=STIFF_STEP), {})

    def apart(one):
        single.step(duration=0.02)
        return abs(one.position[0] - single.position[0])

    return worst_of(both, 50, 0.02, apart)


def bounded(method, quick, radians):
    """
    Swing a bar on springs with steps of 0.1 to 100 radians: no energy may appear.

    Refused where any of them is: the worst of the others must be no more than stable then.
    """
    worst, refusal = 0.0, None
    for each in radians:
        # The bar's inertia about its end is 1/3 kg m^2.
        spring = JointSpring('pivot', (each / STIFF_STEP) ** 2 / 3.0, 1e-3)
        try:
            simulation = at_rest(
                (bar('bar', 1.0, 1.0),), (hinge('pivot', 'ground', 'bar'),),
                replace(method, step_size=STIFF_STEP, tolerance=1e-5), {'spring': spring})
        except StiffnessError as error:
            refusal = error
            continue
        worst = max(worst, worst_of(simulation, 50, 0.02, energy_error(
            simulation, G + spring.stiffness * 1e-6, gained=True)))
    if refusal is not None and worst <= BOUNDED:
        raise refusal
    return worst


def touch_down(method, quick):
    """Drop a bar on a hard floor, on which it comes to rest."""
    simulation = at_rest(
        (bar('bar', 1.0, 1.0),), (hinge('pivot', 'ground', 'bar'),),
        replace(method, step_size=STIFF_STEP, tolerance=1e-5),
        {'floor': Contact('tip', (0.0, -0.5), 1e9, damping=2.0)},
        (Point('tip', 'bar', (1.0, 0.0)),))
    simulation.step(duration=3.0)
    return abs(simulation.position[0] + math.pi / 6.0)


# Time.

# Working speed of the carpet scraping mechanism, 45 rpm [rad/s].
CRANK_RATE = 4.7124


def seconds(quick):
    """Return how long cases of an hour take [s]."""
    return 10 if quick else 3600


def free_for_long(method, quick, name):
    """Let a shipped scene fall free for an hour in steps of 1 ms."""
    simulation = started(name, method, step_size=1e-3)
    energy, tau = simulation.energy, np.zeros(len(simulation.torque_names))

    def second(one):
        # Error control is looked at more often.
        for _ in range(1 if fixed(method) else 10):
            one.advance(tau, 1000 if fixed(method) else 100)

    def unbounded(one):
        # The energy is bounded, or something is very wrong.
        return 0.0 if abs(one.energy - energy) < 0.5 * abs(energy) + 1.0 else math.inf

    return worst_of(simulation, seconds(quick), second, CLOSURE, unbounded)


def driven_for_long(method, quick, name):
    """Hold a scene's crank at its working speed for an hour, asked every millisecond."""
    simulation = started(name, method, step_size=1e-3)
    tau = np.zeros(len(simulation.torque_names))

    def second(one):
        for _ in range(1000):
            # A proportional-integral torque.
            behind = CRANK_RATE * one.time - one.position[0]
            slow = CRANK_RATE - one.velocity[0]
            tau[0] = min(400.0, max(-400.0, 100.0 * behind + 20.0 * slow))
            one.advance(tau, 1)

    worst = worst_of(simulation, seconds(quick), second, CLOSURE)
    # The crank's angle is not wrapped; the tool returns with every turn.
    turned = abs(simulation.position[0] - CRANK_RATE * simulation.time) < 1.0
    return worst if turned else math.inf


def turning_for_long(method, quick, rate):
    """Turn a parallelogram steadily, twice a turn through its flat positions."""
    simulation = Simulation(scene(*ladder(1, 0.4, rate), replace(
        method, step_size=1e-3, tolerance=1e-9, accuracy=1e-9), {}))
    return worst_of(simulation, seconds(quick), 1000, spin_error(rate, True),
                    off_the_branch, bound=1.0)


def fine_steps(method, quick, name):
    """Make very many steps of a shipped scene."""
    return worst_of(started(name, method, step_size=5e-6), 2 if quick else 1000, 10_000, CLOSURE,
                    lambda one: one.health.closure)


# Known answers.

# Largest gap of the pendulum's loop, and error of its place, that count as accurate [m].
GAP, ACCURATE_PLACE = 1e-10, 1e-3
# [s].
PENDULUM_PERIOD = 2.367841947576


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
    """Return a falling looped pendulum's place at the end, its energies, and its largest gap."""
    simulation = Simulation(scene(*looped_pendulum(), tight(method, 1e-3), gravity(0.0)))
    energies = [simulation.energy]
    gap = worst_of(simulation, looks, duration / looks, CLOSURE,
                   lambda one: energies.append(one.energy) or 0.0)
    return simulation.position[1:], np.array(energies), gap


def pendulum_for_long(method, quick, time, place):
    """Swing the pendulum for nearly half an hour, and compare its place."""
    if quick:
        time, place = 10 * PENDULUM_PERIOD, (1.0, 0.0)
    found, _, gap = watch_pendulum(method, time, 100 if quick else 2000)
    return max(np.abs(found - place).max(), gap * ACCURATE_PLACE / GAP)


def ladders_to_their_end(method, quick, ladders):
    """Drop ladders through many flat positions; compare place and velocity."""
    worst = 0.0
    for loops, duration, place, velocity in ladders[:2 if quick else None]:
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


def energy_slope(method, quick):
    """Swing the pendulum for 2000 s and the two-loop ladder for 100 s, tightly."""
    duration = 20.0 if quick else 2000.0
    _, energies, _ = watch_pendulum(method, duration, 200)
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


def of_slider_crank(method, quick, position, rates):
    """Run the slider-crank for 10 s; crank angle, slide and rod angle, and their rates."""
    simulation = Simulation(scene(
        *slider_crank(), tight(method, 5e-3, 1e-10), SLIDER_CRANK_EFFECTS))
    simulation.step(duration=10.0)
    return max(np.abs(np.subtract((crank, slide, crank + rod), exact)).max()
               for (crank, rod, slide), exact in (
                   (simulation.position, position), (simulation.velocity, rates)))


def impulse(method, quick, waits):
    """Hit an upright parallelogram, between two steps, with 1 N m s in 0.1 ms."""
    worst = 0.0
    for wait in waits:
        mechanism, q, qd = ladder(1, 0.0, 0.0)
        simulation = Simulation(scene(mechanism, q, qd, replace(
            method, tolerance=1e-9, step_size=1e-3), {}))
        simulation.step(duration=wait)
        simulation.step((1e4,), 1e-4)
        worst = max(worst, abs(simulation.velocity[0] - 0.6), worst_of(
            simulation, 1, 0.05, lambda one: abs(one.velocity[0] - 0.6)))
    return worst


FRICTION = {
    'spring': JointSpring('slide', 100.0, 0.0), 'friction': JointFriction('slide', 1.0)}


def stuck_mass(method):
    """Return a mass of 1 kg on a spring, with dry friction of 1 N, pulled out by 0.105 m."""
    mechanism = Mechanism('mass', (Body('mass', 1.0, (0.0, 0.0), 0.0),), (
        Joint('slide', PRISMATIC, 'ground', 'mass', (0.0, 0.0), 0.0),))
    return Simulation(Scene('mass', None, '', mechanism, Initial((0.105,), (0.0,)), FRICTION,
                            method))


def sticking(method, quick):
    """Slide a mass to rest after five half swings, and hold it there."""
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


# What a case runs, by its name in the list.
RUNS = {**vars(hard_cases_at_contacts), **vars(hard_cases_in_space), **globals()}
LISTED = yaml.safe_load(Path(__file__).with_suffix('.yaml').read_text(encoding='utf-8'))
CASES = tuple(
    Case(name, group, keys['text'], keys['figure'], keys['accurate'], keys['stable'],
         partial(RUNS[keys['run']], **keys.get('with', {})), keys.get('lengths', ''))
    for group, cases in LISTED.items() for name, keys in cases.items())
