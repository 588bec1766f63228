# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The hard cases of the stability atlas, and how each is judged."""

from dataclasses import dataclass, replace
import math
from typing import Callable

from closedloop_dynamics.effects.contact import Contact
from closedloop_dynamics.effects.external_force import ExternalForce
from closedloop_dynamics.effects.joint_damping import JointDamping
from closedloop_dynamics.effects.joint_friction import JointFriction
from closedloop_dynamics.effects.joint_spring import JointSpring
from closedloop_dynamics.effects.point_spring import PointSpring
from closedloop_dynamics.integration.control import SHARE
from closedloop_dynamics.integration.registry import FIXED, INTEGRATORS
from closedloop_dynamics.mechanism.mechanism import (
    Body, CutJoint, Joint, Mechanism, Point, PRISMATIC, REVOLUTE)
from closedloop_dynamics.simulation.errors import SimulationError, StiffnessError
from closedloop_dynamics.simulation.scene import load_scene
from closedloop_dynamics.simulation.scene_records import Initial, Method, Scene
from closedloop_dynamics.simulation.simulation import Simulation
from hard_cases_at_contacts import AT_CONTACTS
from hard_cases_in_space import IN_SPACE
from hard_machines import (
    bar, change_point_linkage, doubled, G, gravity, gravity_in_space, hinge, in_space, ladder,
    ladder_energy, off_the_branch, pantograph, pantograph_motion, scene, started, three_rockers,
    welded_twice, with_masses)
import numpy as np

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
    # Takes (method, quick); returns the worst figure. May raise SimulationError: refused.
    run: Callable
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
    drawn = np.random.default_rng(0).uniform(2e-3, 12e-3, count)
    if method.integrator == 'semi_implicit_euler':
        drawn *= 0.1
    if INTEGRATORS[method.integrator].kind == FIXED:
        return [(replace(method, step_size=float(size)), 0.0) for size in drawn]
    method = replace(method, tolerance=TRIAL_TOLERANCE, step_size=1e-2)
    return [(method, float(size)) for size in drawn]


def watch_ladder(loops, method, duration, tilt=0.0, rate=1.0):
    """Return the worst of energy error and ten times the angle off the branch, relative."""
    simulation = Simulation(scene(*ladder(loops, tilt, rate), method))
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
    """Swing a pantograph through its folded position; start on it and beside it."""
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
    worst, crossings = 0.0, 0
    for torque in ((5.0, -3.0, 2.0), (-4.0, 6.0, 3.0)) if quick else (
            (5.0, -3.0, 2.0), (-4.0, 6.0, 3.0), (8.0, 8.0, -8.0), (0.0, -9.0, 6.0)):
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


ENERGY_OR_BRANCH = 'energy error, or 10 x angle off the branch [rad], relative'


# Redundant constraints.

STEPS_BETWEEN, FEW_LOOKS = 50, 6


def compare(redundant, single):
    """Return the worst relative difference of accelerations along a motion."""
    worst = 0.0
    for _ in range(FEW_LOOKS):
        for _ in range(STEPS_BETWEEN):
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
    for _ in range(FEW_LOOKS):
        for _ in range(STEPS_BETWEEN):
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
    for _ in range(FEW_LOOKS):
        for _ in range(STEPS_BETWEEN):
            simulation.step()
        angle = simulation.position[0]
        x, y = simulation.scene.effects['gravity'].acceleration
        moment = (0.5 + 2.0 * 1.25) * (math.cos(angle) * y - math.sin(angle) * x)
        worst = max(worst, abs(simulation.acceleration[0] - moment / inertia) / G)
    once_unique = Simulation(scene(once, q, qd, method)).health.unique_forces
    return math.inf if simulation.health.unique_forces or once_unique else worst


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
    simulation = Simulation(
        scene(mechanism, q, qd, method, effects or gravity(strength=strength)))
    worst = 0.0
    for _ in range(10):
        for _ in range(steps // 10):
            simulation.step()
        error = simulation.acceleration[0] + exact_acceleration(
            mechanism, -simulation.position[0], size, strength)
        worst = max(worst, abs(error) * size / strength, off_the_branch(simulation.position))
    return worst


def _masses(factors, placed=lambda mechanism: mechanism, effects=None):
    def run(method, quick):
        return max(fall(placed(with_masses(mechanism, dict.fromkeys(light, factor))), q, qd,
                        replace(method, step_size=2e-3), 100, effects=effects)
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


def _spinning(rate, step_size, steps, quick_steps):
    """Return the run of a parallelogram that spins, at 1000 rad/s 318 times a second flat."""
    def run(method, quick):
        simulation = Simulation(scene(*ladder(1, 0.4, rate), replace(
            method, step_size=step_size, tolerance=1e-9), {}))
        simulation.advance(np.zeros(3), quick_steps if quick else steps)
        phase = simulation.position[0] + 0.4 + rate * simulation.time
        return max(abs(phase), off_the_branch(simulation.position))

    return run


def light_cart(mass=1e-6):
    """Return a cart of a mass [kg] on a rail, and a pendulum of 1 kg on 1 m, nearly upright."""
    bodies = (Body('cart', mass, (0.0, 0.0), 0.0), Body('pendulum', 1.0, (1.0, 0.0), 0.0))
    joints = (Joint('rail', PRISMATIC, 'ground', 'cart', (0.0, 0.0), 0.0),
              hinge('pivot', 'cart', 'pendulum'))
    return (Mechanism('cart', bodies, joints), np.array([0.0, 1.0]), np.zeros(2))


def _light_cart(method, quick):
    """
    Drop a pendulum from a light cart: nothing holds it aside, and it bounces as from a wall.

    The turn at the bottom takes 1e-7 s, at thousands of radians a second.
    """
    simulation = Simulation(scene(*light_cart(), replace(
        method, step_size=1e-3, tolerance=1e-9), gravity(0.0)))
    start, worst = simulation.energy, 0.0
    for _ in range(100):
        simulation.step(duration=0.05 if quick else 0.2)
        worst = max(worst, abs(simulation.energy - start) / G)
    return worst


def _overload(method, quick):
    simulation = started('three_rrr', method, step_size=1e-3)
    simulation.step((1e6, 0.0, 0.0))
    simulation.step(duration=0.01)
    if not (np.isfinite(simulation.position).all() and np.isfinite(simulation.velocity).all()):
        return math.nan
    return simulation.closure


def _many(method, quick):
    return fall(*ladder(60 if quick else 1000, 0.4), replace(method, step_size=1e-3), 20)


ACCELERATION_OR_BRANCH = 'error of acceleration, relative, or angle off the branch'


# Inconsistent input.

def _velocities(method, quick):
    """Start with random rates: they are made to fit, and stay so."""
    worst, rng = 0.0, np.random.default_rng(1)
    for _ in range(3 if quick else 20):
        simulation = started('three_rrr', method, step_size=1e-3)
        simulation.set_state(simulation.position, rng.normal(size=7))
        for _ in range(20):
            simulation.step()
        worst = max(worst, simulation.closure)
    return worst


def _by_hand(method, quick):
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


def _large_steps(method, quick):
    return max(watch_ladder(2, replace(method, step_size=size), 3.0)
               for size in (0.01, 0.02, 0.05))


def _changed_step(method, quick):
    simulation = Simulation(scene(*ladder(2), replace(method, tolerance=1e-8)))
    start, worst = simulation.energy, 0.0
    for size in (1e-3, 4e-3, 2e-4, 7e-3, 1e-3) * (1 if quick else 4):
        simulation.stepping.set_step_size(size)
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


# Stiffness.

STIFF_STEP = 1e-3
# Energy that may appear, relative.
BOUNDED = 1e-2


def _pendulum_scene(bodies, joints, method, effects, points=()):
    mechanism = Mechanism('pendulum', bodies, joints, points=points)
    at_rest = (0.0,) * len(joints)
    return Simulation(Scene('pendulum', None, '', mechanism, Initial(at_rest, at_rest),
                            {**gravity(0.0), **effects}, method))


def _nearly_rigid(effect):
    """Swing two bars, held together by a very stiff effect, like one for a second."""
    def run(method, quick):
        upper, lower = bar('upper', 1.0, 1.0), bar('lower', 2.0, 0.5)
        pivot = hinge('pivot', 'ground', 'upper')
        both = _pendulum_scene(
            (upper, lower), (pivot, hinge('knee', 'upper', 'lower', 1.0)),
            replace(method, step_size=STIFF_STEP, tolerance=1e-5), {'stiff': effect})
        center = (0.5 + 2.0 * 1.25) / 3.0
        inertia = (upper.inertia + (0.5 - center) ** 2
                   + lower.inertia + 2.0 * (1.25 - center) ** 2)
        one = _pendulum_scene((Body('upper', 3.0, (center, 0.0), inertia),), (pivot,),
                              Method(step_size=STIFF_STEP), {})
        worst = 0.0
        for _ in range(50):
            both.step(duration=0.02)
            one.step(duration=0.02)
            worst = max(worst, abs(both.position[0] - one.position[0]))
        return worst
    return run


def _bounded(method, quick):
    """
    Swing a bar on springs with steps of 0.1 to 100 radians: no energy may appear.

    Refused where any of them is: the worst of the others must be no more than stable then.
    """
    worst, refusal = 0.0, None
    for radians in (0.1, 1.0, 10.0, 100.0):
        # The bar's inertia about its end is 1/3 kg m^2.
        spring = JointSpring('pivot', (radians / STIFF_STEP) ** 2 / 3.0, 1e-3)
        try:
            simulation = _pendulum_scene(
                (bar('bar', 1.0, 1.0),), (hinge('pivot', 'ground', 'bar'),),
                replace(method, step_size=STIFF_STEP, tolerance=1e-5), {'spring': spring})
        except StiffnessError as error:
            refusal = error
            continue
        start = simulation.energy
        for _ in range(50):
            simulation.step(duration=0.02)
            worst = max(worst, (simulation.energy - start) / (G + spring.stiffness * 1e-6))
    if refusal is not None and worst <= BOUNDED:
        raise refusal
    return worst


def _touch_down(method, quick):
    """Drop a bar on a hard floor, on which it comes to rest."""
    simulation = _pendulum_scene(
        (bar('bar', 1.0, 1.0),), (hinge('pivot', 'ground', 'bar'),),
        replace(method, step_size=STIFF_STEP, tolerance=1e-5),
        {'floor': Contact('tip', (0.0, -0.5), 1e9, damping=2.0)},
        (Point('tip', 'bar', (1.0, 0.0)),))
    simulation.step(duration=3.0)
    return abs(simulation.position[0] + math.pi / 6.0)


# Time.

# Working speed of the carpet scraping mechanism, 45 rpm [rad/s].
CRANK_RATE = 4.7124


def _long(name, drive=None):
    """Return the run of a shipped scene for an hour in steps of 1 ms, driven or left alone."""
    def run(method, quick):
        duration = 10.0 if quick else 3600.0
        simulation = started(name, method, step_size=1e-3)
        energy, worst = simulation.energy, 0.0
        tau = np.zeros(len(simulation.joint_names))
        # A drive answers every millisecond, as a node does; without one, longer portions do.
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
            # The crank's angle is not wrapped; the tool returns with every turn.
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
    """Turn a parallelogram steadily, twice a turn through its flat positions."""
    duration = 10.0 if quick else 3600.0
    rate = 10.0
    simulation = Simulation(scene(*ladder(1, 0.4, rate), replace(
        method, step_size=1e-3, tolerance=1e-9, accuracy=1e-9), {}))
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
        simulation = started(name, method, step_size=5e-6)
        tau, worst = np.zeros(len(simulation.joint_names)), 0.0
        for _ in range(steps // 10_000):
            simulation.advance(tau, 10_000)
            worst = max(worst, simulation.closure, simulation.health.closure)
        return worst
    return run


# Known answers.

# Of error-controlled methods: rounding, almost.
TIGHT = 1e-11
# Largest gap of the pendulum's loop, and error of its place, that count as accurate [m].
GAP, ACCURATE_PLACE = 1e-10, 1e-3

# Place of the pendulum (A01) at 2000 s, from rest at (1, 0) [m].
PENDULUM = (2000.0, (-0.8146030686, -0.5800188278))
# [s].
PENDULUM_PERIOD = 2.367841947576
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
    """Return a falling looped pendulum's place at the end, its energies, and its largest gap."""
    simulation = Simulation(scene(*looped_pendulum(), method, gravity(0.0)))
    energies, gap = [simulation.energy], 0.0
    for _ in range(looks):
        simulation.step(duration=duration / looks)
        energies.append(simulation.energy)
        gap = max(gap, simulation.closure)
    return simulation.position[1:], np.array(energies), gap


def _pendulum(method, quick):
    """Swing the pendulum for nearly half an hour, and compare its place."""
    if quick:
        place, _, gap = watch_pendulum(tight(method, 1e-3), 10 * PENDULUM_PERIOD, 100)
        error = np.abs(place - (1.0, 0.0)).max()
    else:
        time, exact = PENDULUM
        place, _, gap = watch_pendulum(tight(method, 1e-3), time, 2000)
        error = np.abs(place - exact).max()
    return max(error, gap * ACCURATE_PLACE / GAP)


def _ladders(method, quick):
    """Drop ladders through many flat positions; compare place and velocity."""
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
    """Swing the pendulum for 2000 s and the two-loop ladder for 100 s, tightly."""
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


# Group -> name, text, figure, accurate, stable, run and lengths of its cases.
CASES = tuple(Case(name, group, *rest) for group, cases in {
    'Singular configurations': (
        ('flat, 1 loop',
         'Change-point four-bar (A02, N = 1) through its flat position, 40 step sizes of 2 to '
         '12 ms and 0.1 ms: stays on the parallel branch.', ENERGY_OR_BRANCH, 1e-5, 1e-2,
         _passing(1, 2.5, 10.0), '41 steps, 10 s / 7 steps, 2.5 s'),
        ('flat, 2 loops',
         'The same with two loops: two closure equations vanish at once.', ENERGY_OR_BRANCH, 1e-5,
         1e-2, _passing(2, 2.5, 10.0), '41 steps, 10 s / 7 steps, 2.5 s'),
        ('flat, 40 loops',
         'The same with 40 loops: one degree of freedom becomes 41 for an instant.',
         ENERGY_OR_BRANCH, 1e-5,
         1e-2, _passing(40, 0.9, 2.5), '41 steps, 2.5 s / 2 steps, 0.9 s'),
        ('start flat',
         'N = 1 and 2, starting exactly on the flat position: goes on along its velocity.',
         ENERGY_OR_BRANCH, 1e-5, 1e-2, _on_flat, '6 steps, 3 s / 2 steps, 1 s'),
        ('start near flat',
         'N = 1 and 2, starting 1e-1 to 1e-13 rad before and behind the flat position.',
         ENERGY_OR_BRANCH, 1e-5, 1e-2, _near_flat, '13 distances / 8'),
        ('change point',
         'Four-bar of 4, 1, 3, 2 m, which folds onto one line without any symmetry: keeps its '
         'energy.', 'energy error, relative', 1e-5, 1e-2, _change_point,
         '40 steps, 20 s / 6 steps, 10 s'),
        ('folded pantograph',
         "The scraper's pantograph alone swings through its folded position, and starts on it "
         'and beside it: against a double pendulum, which it equals.', 'error of the angles [rad]',
         1e-5, 0.1, _folding, '10 steps, 3 s / 2 steps, 1 s'),
        ('type-2 pose',
         '3-RRR driven by torques through parallel-singular poses, each reported: energy equals '
         'work.', 'energy without source, relative', 1e-6, 1e-2, _type_2, '4 torques / 2'),
    ),
    'Redundant constraints': (
        ('3-RRR, loops twice',
         'Every cut joint of the 3-RRR twice: the same motion to 1e-9, each pair shares the '
         'force of one, its rank is reported, and that the forces are not unique.',
         'difference, relative', 1e-9, 1e-3, _doubled('three_rrr')),
        ('scraper, loops twice',
         'The same for the carpet scraping mechanism.', 'difference, relative', 1e-9, 1e-3,
         _doubled('carpet_scraper')),
        ('three rockers',
         'Parallelogram on three equal rockers: moves only because the lengths agree; '
         'acceleration against the closed form.', 'difference, relative', 1e-9, 1e-3,
         _three_rockers),
        ('welded twice',
         'Two hinged bodies welded by two fixed cut joints, six equations for one degree of '
         'freedom.',
         'difference, relative', 1e-9, 1e-3, _welded),
    ),
    'Scale': (
        ('mass ratio 1e8',
         'Links of a two-loop ladder 1e-8 to 1e8 times as heavy as the others; acceleration '
         'against the closed form.', ACCELERATION_OR_BRANCH, 1e-8, 1e-3,
         _masses((1e-8, 1e-6, 1e-3, 1e3, 1e6, 1e8))),
        ('massless links',
         'Some links without any mass: the inertia matrix of their subsystem is singular, the '
         'mechanism is not.', ACCELERATION_OR_BRANCH, 1e-8, 1e-3, _masses((0.0,))),
        ('0.1 mm to 1 km',
         'The ladder with links of 1e-4, 1e-2, 1 and 1e3 m.', ACCELERATION_OR_BRANCH, 1e-8, 1e-3,
         _sizes),
        ('gravity 0 to 1e4',
         'The ladder without gravity, and at a thousand times that of the Earth.',
         ACCELERATION_OR_BRANCH, 1e-8, 1e-3, _gravity),
        ('10,000 rad/s',
         'A parallelogram that spins at 10,000 rad/s, without gravity: steady, through all its '
         'flat positions.', 'error of the phase, or angle off the branch [rad]', 1e-6, 1e-2,
         _spinning(1e4, 1e-6, 10_000, 2000), '10 ms / 2 ms'),
        ('1000 rad/s for 1 s',
         'The same at 1000 rad/s for a second (else 0.1 s), in steps of 10 us or with a '
         'tolerance of 1e-9.', 'error of the phase, or angle off the branch [rad]', 1e-6, 1e-2,
         _spinning(1e3, 1e-5, 100_000, 10_000), '1 s / 0.1 s'),
        ('cart of 1 mg',
         'A pendulum of 1 kg on a cart of 1e-6 kg for 20 s (else 5 s): it turns at the bottom '
         'within 1e-7 s, as if it bounced. Steps of 1 ms, or a tolerance of 1e-9.',
         'energy error, relative', 1e-5, 1e-2, _light_cart, '20 s / 5 s'),
        ('1e6 N m in a step',
         'A torque of 1e6 N m on the 3-RRR for one step of 1 ms: closed and finite, or refused.',
         'closure error [m]', 1e-9, 1e-5, _overload),
        ('1000 loops',
         'A ladder of 1000 loops (60 with --quick).', ACCELERATION_OR_BRANCH, 1e-8, 1e-3, _many,
         '1000 loops / 60'),
    ),
    'Inconsistent input': (
        ('inconsistent velocities',
         'The 3-RRR started with random joint rates: the nearest ones that the loops allow.',
         'closure error [m]', 1e-9, 1e-4, _velocities, '20 starts / 3'),
        ('states by hand',
         'All joints of the scraper moved by up to 0.01 rad: the nearest closed state, on its '
         'branch.', 'closure error [m]', 1e-12, 1e-4, _by_hand, '40 states / 5'),
        ('10, 20, 50 ms steps',
         'The two-loop ladder with steps far too large: still on its branch, or refused.',
         'energy error, or 10 x angle off the branch [rad], relative', 1e-5, 0.1, _large_steps),
        ('step size changed',
         'The two-loop ladder with its step changed while it runs, 0.2 to 7 ms.',
         'energy error, relative', 1e-5, 1e-2, _changed_step, '10 s / 2.5 s'),
        ('cannot be assembled',
         'A four-bar whose coupler is a hundred times too short: there is nothing but to refuse.',
         'none: to be refused', 0.0, 0.0, _broken),
    ),
    'Stiffness': (
        ('spring 1e9 N m/rad',
         'Two bars joined by a spring of 1e9 N m/rad swing like one, within 1 %, in steps of 1 '
         'ms.', 'error of the slow motion [rad]', 1e-2, 0.1,
         _nearly_rigid(JointSpring('knee', 1e9, 0.0))),
        ('damper 1e6 N m s/rad',
         'The same with a damper of 1e6 N m s/rad.', 'error of the slow motion [rad]', 1e-2, 0.1,
         _nearly_rigid(JointDamping('knee', 1e6))),
        ('contact 1e9 N/m',
         'A bar falls on a floor of 1e9 N/m and comes to rest on it, steps of 1 ms.',
         'error of the angle at rest [rad]', 1e-2, 0.1, _touch_down),
        ('step of 0.1 to 100 rad',
         'A bar on springs so stiff that a step of 1 ms is 0.1, 1, 10 and 100 radians of its '
         'swing: no energy appears.', 'energy that appeared, relative', 1e-3, BOUNDED, _bounded),
    ),
    'Time': (
        ('3-RRR for long',
         'The 3-RRR falling free, chaotic, 1 ms: loops closed and energy bounded (an hour for '
         'the default method, 10 s for the others).', 'closure error [m]', 1e-10, 1e-4,
         _long('three_rrr'), '1 h / 10 s'),
        ('scraper for long',
         'The carpet scraping mechanism at its working speed, its drive asked every '
         'millisecond: loops closed, crank angle unwrapped.', 'closure error [m]', 1e-10, 1e-4,
         _long('carpet_scraper', _at_working_speed), '1 h / 10 s'),
        ('turning for long',
         'A parallelogram turns at 10 rad/s for as long, twice a turn through flat positions, '
         'and keeps phase and branch.',
         'error of the phase, relative, or angle off the branch [rad]', 1e-9, 1e-4, _turning,
         '1 h / 10 s'),
        ('1e7 steps, 3-RRR',
         'The 3-RRR in steps of 5 us, ten million of them (20,000 but for the default method): '
         'none fails.', 'closure error [m]', 1e-9, 1e-4, _fine('three_rrr'), '1e7 steps / 2e4'),
        ('1e7 steps, scraper',
         'The same for the carpet scraping mechanism.', 'closure error [m]', 1e-9, 1e-4,
         _fine('carpet_scraper'), '1e7 steps / 2e4'),
    ),
    'Known answers': (
        ('pendulum, 2000 s',
         'A pendulum (A01), half of its mass in a loop: its place after 2000 s against the '
         'printed reference (else after ten periods), its gap always below 1e-10 m.',
         'error of its place, or 1e7 x the gap [m]', ACCURATE_PLACE, 1e-1, _pendulum,
         '2000 s / 24 s'),
        ('slope of the energy',
         'The same pendulum over 2000 s (else 20 s), and the two-loop ladder over 100 s (else '
         '10 s) with steps of 0.5 ms or a tolerance of 1e-11: no trend.',
         'slope of the energy, relative [1/s]', 1e-9, 1e-3, _energy_slope,
         '2000 and 100 s / 20 and 10 s'),
        ('A02 to its end',
         'Ladders of 1, 2 and 40 loops (else 1 and 2) after 10 to 20 s and up to twenty flat '
         'passes: place and velocity against the exact ones.',
         "error of a tip's place and velocity [m, m/s]", 1e-3, 1e-1, _ladders,
         'N to 40, 20 s / N to 2, 10 s'),
        ('slider-crank',
         'That of SUNDIALS with its massless slider, spring, damper and force, after 10 s, in '
         'steps of 5 ms: against two derivations that agree to 1e-13.',
         'error of angles, slide and rates [rad, m; /s]', 1e-6, 1e-3, _slider_crank),
        ('1 N m s in 0.1 ms',
         'An impulse between two steps on an upright parallelogram: its rate changes by 0.6 '
         'rad/s, no step misses it.', 'error of the rate [rad/s]', 1e-6, 1e-3, _impulse),
        ('stick and slip',
         'A mass on a spring comes to rest by dry friction at -0.005 m, and does not creep in '
         '100 s (else 2 s).', 'error of its place, or 1000 x its creep [m]', 1e-9, 1e-5, _stick,
         '100 s / 2 s'),
    ),
    'Grazing and tunnelling': AT_CONTACTS,
    'Machines in space': (
        *IN_SPACE,
        ('mass ratio 1e8 in space',
         'The ladder of two loops with pins of five equations each, three too many, in a plane '
         'along no axis; links 1e-8 to 1e8 times as heavy as the others.', ACCELERATION_OR_BRANCH,
         1e-8, 1e-3, _masses((1e-8, 1e-4, 1e4, 1e8), in_space, gravity_in_space())),
    ),
}.items() for name, *rest in cases)
