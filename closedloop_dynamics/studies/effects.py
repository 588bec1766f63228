# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Cost and influence of each effect of a scene.

The scene is run as it is, and once more without each type of effect; the differences are what
that type changes. What it costs has two factors: the arithmetic, that is the time of one
evaluation of the accelerations, in the same states with and without the effects; and the motion,
that is the evaluations that a simulated second takes. Times are measured in turn, so that
disturbances of the machine affect all of them, and each is compared with the one of the same
round. The bare scene is measured twice: that shows how far such ratios can be trusted.
"""

from dataclasses import dataclass, replace
import math
from time import process_time
from typing import Dict, Optional, Tuple

import numpy as np

from .reference import in_angles
from ..effects.registry import effect_type
from ..engine.types import EVALUATIONS
from ..mechanism.errors import SimulationError
from ..simulation.simulation import Simulation

# How fast an error of the rate is to decay [1/s].
GAIN = 20.0
# Rates of a mechanism that rests [rad/s, m/s], and when it does no more [s].
AT_REST, SOON = 1e-6, 1e-6


class RateControl:
    """
    Computed torque for constant rates.

    The model is the scene without drives, so that their lags and limits show in the result.
    ``rates``: wanted rate of every actuated joint [rad/s, m/s]. ValueError where a joint is not
    actuated, or an actuated one has no rate.
    """

    def __init__(self, scene, rates):
        effects = {name: effect for name, effect in scene.effects.items()
                   if effect.drive() is None}
        self._model = Simulation(scene_with(scene, effects))
        # At rest dry friction would hold the joints that the torques are to move.
        self._smooth = Simulation(scene_with(scene, (
            name for name, effect in effects.items() if not effect.ENDS_STEPS)))
        names = self._model.actuated_joints
        if set(rates) != set(names):
            raise ValueError(f'rate: expected one for every actuated joint ({", ".join(names)}), '
                             f'got {", ".join(rates) or "none"}')
        if len(self._model.data.actuated_in_tree) < len(names):
            raise ValueError('rate: expected actuated joints of the tree, got one that closes a '
                             'loop: cut another joint of that loop')
        self._joints = [self._model.joint_names.index(name) for name in names]
        self._rates = np.array([rates[name] for name in names])
        self._names = names

    def torque(self, simulation):
        """Return the torques for the present state, by joint; raise SimulationError."""
        q, qd = simulation.position, simulation.velocity
        free, _ = self._smooth.forward_dynamics(q, qd)
        response = np.array([
            self._smooth.forward_dynamics(q, qd, {name: 1.0})[0] - free for name in self._names]).T
        wanted = GAIN * (self._rates - qd[self._joints])
        try:
            torque = np.linalg.solve(response[self._joints], wanted - free[self._joints])
        except np.linalg.LinAlgError:
            raise SimulationError(
                'The driven joints cannot keep these rates here: their torques do not move them '
                'independently. Name fewer rates, or another start.') from None
        acceleration = free + response @ torque
        if np.abs(qd).max(initial=0.0) < AT_REST:
            # Against the friction of the motion that is about to begin.
            qd = qd + SOON * acceleration
        torque, _ = self._model.inverse_dynamics(q, qd, acceleration)
        return dict(zip(self._names, torque.tolist()))


# Rounds of one measurement; the states of the motion in which every round evaluates, and how often
# in each: about a millisecond.
REPEATS, STATES, TURN = 60, 8, 1e-3
# The kind of the finding of several types.
TOGETHER = 'together'


@dataclass(frozen=True)
class Ratio:
    """A ratio of times, with the range that its median has in 95 of 100 such measurements."""

    value: float
    low: float
    high: float

    @property
    def noise(self):
        """Half the width of the range."""
        return 0.5 * (self.high - self.low)


@dataclass(frozen=True)
class RecordedRun:
    """One run."""

    time: np.ndarray  # Shape (n,) [s]
    # Shape (n, nq), (n, nv), (n, nv): of the joints, the effort behind the drives.
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    force: np.ndarray  # Shape (n, number of cuts): magnitudes of the forces at the cut joints [N]
    balance: np.ndarray  # Shape (n, 5): kinetic, stored, dissipated energy, work, residual [J]
    readings: Dict[str, Dict[str, np.ndarray]]  # What each effect says of itself
    points: Dict[str, np.ndarray]  # Shape (n, 2), in space (n, 3): places of the points [m]
    evaluations: float  # Of the accelerations, for a simulated second


@dataclass(frozen=True)
class Finding:
    """Cost and influence of one type of effect; NaN where it could not be found."""

    kind: str  # Type of the effects
    names: Tuple[str, ...]  # Which effects of the scene those are
    failure: str  # Why the scene does not run without them; empty where it does
    alone: Ratio  # Time of an evaluation with these effects alone, over that without any
    without: Ratio  # Time of an evaluation without them, over that of the whole scene
    motion: float  # Evaluations for a simulated second without them, over those of the whole scene
    # Largest differences that leaving them out makes: positions [rad, m], orientations as rotation
    # angles; places of named points [m], efforts [N m, N], forces at the cut joints [N], kinetic
    # and stored energy [J].
    position: float
    place: float
    effort: float
    force: float
    energy: float
    # Names of the joint and of the point that this moves furthest; empty where there is none.
    joint: str
    point: str
    run: Optional[RecordedRun]  # Without them

    @property
    def moved(self):
        """Return the largest change of a position or a place [rad or m]."""
        return float(np.nanmax([self.position, self.place]))

    @property
    def time(self):
        """Return the computing time without them over that of the whole scene."""
        return self.without.value * self.motion


@dataclass(frozen=True)
class Study:
    """The findings on one scene."""

    simulation: Simulation  # Of the scene
    run: RecordedRun  # Of the scene as it is
    findings: Tuple[Finding, ...]  # One for each type of effect, in the scene's order
    bare: float  # Time of an evaluation without any effect [s]
    # Times of an evaluation, over that: without any effect once more, which only noise keeps from
    # 1; with all listed but switched off; of the scene as it is.
    again: Ratio
    off: Ratio
    whole: Ratio
    # Finding on all effects whose change is below the threshold; None unless there are several.
    together: Optional[Finding] = None


def study_effects(scene, duration=2.0, torque=None, rates=None, rows=400, matters=0.0,
                  progress=lambda done, total: None):
    """
    Measure cost and influence of each type of effect.

    Parameters
    ----------
    scene : Scene
        With at least one effect.
    duration : float
        Simulated time [s].
    torque : mapping, optional
        Constant torques of actuated joints.
    rates : mapping, optional
        Constant rates of the actuated joints instead.
    rows : int
        Instants recorded.
    matters : float
        A change of positions or places that matters [rad or m]; types that change less are left
        out together, too.
    progress : callable
        Called with the parts done and all parts.

    Raises
    ------
    SimulationError, ValueError

    """
    scene = replace(scene, method=scene.method.without_budget)
    types = {}
    for name, effect in scene.effects.items():
        types.setdefault(effect_type(effect), []).append(name)
    parts = len(types) + 3
    progress(0, parts)
    simulation = Simulation(scene)
    whole = record(simulation, duration, rows, torque, rates)
    progress(1, parts)
    times = _times(scene, types, whole)
    progress(2, parts)
    findings = []
    for k, (kind, names) in enumerate(types.items()):
        findings.append(_finding(
            scene, kind, tuple(names), whole, times,
            lambda one: record(one, duration, rows, torque, rates)))
        progress(3 + k, parts)
    little = [one for one in findings if one.run is not None and one.moved <= matters]
    together = None
    if len(little) > 1:
        names = tuple(name for one in little for name in one.names)
        together = _finding(
            scene, TOGETHER, names, whole, _times(scene, {TOGETHER: names}, whole),
            lambda one: record(one, duration, rows, torque, rates))
    progress(parts, parts)
    return Study(
        simulation, whole, tuple(findings),
        float(np.median(times['bare'])) if 'bare' in times else math.nan,
        *(_ratio_of(times, key, 'bare') for key in ('again', 'off', 'whole')), together)


def _finding(scene, kind, names, whole, times, run_of):
    """Return cost and influence of the effects of one type."""
    ratios = (_ratio_of(times, ('alone', kind), 'bare'), _ratio_of(
        times, ('without', kind), 'whole'))
    try:
        simulation = Simulation(_without(scene, names))
        run = run_of(simulation)
    except (SimulationError, ValueError) as error:
        return Finding(kind, names, str(error), *ratios, *[math.nan] * 6, '', '', None)
    moved = np.abs(changes_of_position(simulation.coordinates, run, whole)).max(axis=0)
    places = {name: float(np.linalg.norm(run.points[name] - place, axis=1).max())
              for name, place in whole.points.items()}
    return Finding(
        kind, names, '', *ratios, run.evaluations / whole.evaluations,
        float(moved.max(initial=0.0)), max(places.values(), default=math.nan),
        *(float(np.abs(a - b).max(initial=0.0)) for a, b in (
            (run.effort, whole.effort), (run.force, whole.force),
            (run.balance[:, :2].sum(axis=1), whole.balance[:, :2].sum(axis=1)))),
        simulation.joint_names[int(moved.argmax())] if len(moved) else '',
        max(places, key=places.get, default=''), run)


def changes_of_position(coordinates, run, whole):
    """Return how far one run is from another, shape (n, nv), orientations as rotation angles."""
    return np.array([in_angles(coordinates, q, other)
                     for q, other in zip(run.position, whole.position)])


def record(simulation, duration, rows, torque=None, rates=None):
    """Run a simulation from its start and record it."""
    control = RateControl(simulation.scene, rates) if rates else None
    kept, step, evaluations = [], 0, 0.0
    steps = max(1, round(duration / simulation.step_size))
    for row in range(min(rows, steps) + 1):
        until = round(row * steps / min(rows, steps))
        while step < until:
            applied = torque if control is None else control.torque(simulation)
            before = simulation.data.system.work.health[EVALUATIONS]
            if control is None:
                simulation.step(applied, (until - step) * simulation.step_size)
                step = until
            else:
                simulation.step(applied)
                step += 1
            evaluations += simulation.data.system.work.health[EVALUATIONS] - before
        kept.append(_row(simulation))
    columns = list(zip(*kept))
    arrays = [np.array(column) for column in columns[:6]]
    return RecordedRun(
        *arrays,
        readings={name: {key: np.array([values[name][key] for values in columns[6]])
                         for key in columns[6][0][name]} for name in columns[6][0]},
        points={name: np.array([values[name] for values in columns[7]])
                for name in columns[7][0]},
        evaluations=evaluations / simulation.time)


def _row(simulation):
    balance = simulation.energy_balance
    return (
        simulation.time, simulation.position, simulation.velocity, simulation.effort,
        np.linalg.norm(simulation.constraint_forces[:, _forces(simulation)], axis=1),
        (balance.kinetic, balance.stored, balance.dissipated, balance.work, balance.residual),
        {name: simulation.effect_readings(name) for name in simulation.effects},
        {point.name: simulation.point(point.name) for point in simulation.mechanism.points})


def scene_with(scene, names):
    names = set(names)
    # In the scene's order, in which forces are summed up.
    kept = {name: effect for name, effect in scene.effects.items() if name in names}
    return replace(scene, effects=kept,
                   switched_off=tuple(name for name in scene.switched_off if name in names))


def _forces(simulation):
    """Return where the force is in a wrench, behind the moment."""
    return slice(1 if simulation.mechanism.planar else 3, None)


def _without(scene, names):
    return scene_with(scene, (name for name in scene.effects if name not in names))


def _times(scene, types, whole):
    """Return the times of an evaluation of every variant that can be built, one a round [s]."""
    everything = tuple(scene.effects)
    without = {'whole': (), 'off': (), 'bare': everything, 'again': everything}
    for kind, names in types.items():
        without['alone', kind] = [name for name in everything if name not in names]
        without['without', kind] = names
    variants = {}
    for key, names in without.items():
        try:
            variants[key] = _evaluation(Simulation(_without(scene, names)), key == 'off', whole)
        except (SimulationError, ValueError):
            # Its cells stay empty: this cannot be without that.
            continue
    measured = {key: [] for key in variants}
    keys, shuffle = list(variants), np.random.default_rng(0)
    for _ in range(REPEATS):
        for k in shuffle.permutation(len(keys)):
            measured[keys[k]].append(variants[keys[k]]())
    return {key: np.array(values) for key, values in measured.items()}


def _evaluation(simulation, off, whole):
    """Return the function that times an evaluation in states of a motion [s]."""
    if off:
        for name in simulation.effects:
            simulation.set_effect(name, enabled=False)
    own = simulation.data.integrated
    states = []
    for row in np.linspace(0, len(whole.time) - 1, STATES).astype(int):
        state = own.copy()
        moved = np.concatenate((whole.position[row], whole.velocity[row]))
        state[:len(moved)] = moved
        states.append(state)

    def time(count):
        begin = process_time()
        for state in states:
            simulation.data.system.native.evaluate_again(state, count)
        return (process_time() - begin) / (count * STATES)

    time(1)
    count = max(1, round(TURN / (STATES * max(time(1), 1e-7))))
    return lambda: time(count)


def _ratio_of(times, key, other):
    """Return the ratio of the times of two variants; NaN where there are none."""
    if key in times and other in times:
        return ratio(times[key], times[other])
    return Ratio(math.nan, math.nan, math.nan)


def ratio(times, others):
    """Return the median ratio of times that were measured in turn, and its range."""
    ratios = np.sort(np.divide(times, others))
    count = len(ratios)
    # Ranks between which the median lies in 95 of 100 cases, whatever the distribution is.
    out = max(0, int(0.5 * count - 0.98 * math.sqrt(count)))
    return Ratio(float(np.median(ratios)), float(ratios[out]), float(ratios[count - 1 - out]))
