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
Cost and influence of each effect of a scene.

The scene is run as it is, and once more without each type of effect; the differences are what
that type changes. Times are measured on short runs of every variant in turn, so that disturbances
of the machine affect all of them, and each is compared with the one of the same round. The bare
scene is measured twice: that tells how far such ratios can be trusted.

"""

from dataclasses import dataclass, replace
import math
from time import process_time
from typing import Dict, Tuple

import numpy as np

from ..effects.registry import effect_type
from ..simulation.errors import SimulationError
from ..simulation.simulation import Simulation

# How fast an error of the rate is to decay [1/s].
GAIN = 20.0
# Rates of a mechanism that rests [rad/s, m/s], and when it does no more [s].
AT_REST, SOON = 1e-6, 1e-6


class RateControl:
    """
    Computed torque for constant rates.

    The model is the scene without drives, so that their lags and limits show in the result.

    ``rates``: dict of str to float; wanted rate of every actuated joint [rad/s, m/s].

    Raises
    ------
    ValueError
        Where a joint is not actuated, or an actuated one has no rate.

    """

    def __init__(self, scene, rates):
        """Build the model."""
        effects = {name: effect for name, effect in scene.effects.items()
                   if effect.drive() is None}
        self._model = Simulation(_only(scene, effects))
        # At rest dry friction would hold what the torques are to move.
        self._smooth = Simulation(_only(scene, (
            name for name, effect in effects.items() if not effect.ENDS_STEPS)))
        names = self._model.actuated_joints
        if set(rates) != set(names):
            raise ValueError(f'rate: expected one for every actuated joint ({", ".join(names)}), '
                             f'got {", ".join(rates) or "none"}')
        if len(self._model.actuated_in_tree) < len(names):
            raise ValueError('rate: expected actuated joints of the tree, got one that closes a '
                             'loop: cut another joint of that loop')
        self._joints = [self._model.joint_names.index(name) for name in names]
        self._rates = np.array([rates[name] for name in names])
        self._names = names

    def torque(self, simulation):
        """
        Return the torques for the present state, by joint.

        Raises
        ------
        SimulationError
            Where the torques cannot set the rates.

        """
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


# Steps of one measurement, and how often it is repeated.
STEPS, REPEATS = 200, 60
# Made before them, untimed: what ran before must not matter.
RUN_IN = 50


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
class Record:
    """One run."""

    time: np.ndarray  # Shape (n,) [s]
    # Shape (n, nv): of the joints, the effort behind the drives.
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    force: np.ndarray  # Shape (n, number of cuts): magnitudes of the forces at the cut joints [N]
    balance: np.ndarray  # Shape (n, 5): kinetic, stored, dissipated energy, work, residual [J]
    readings: Dict[str, Dict[str, np.ndarray]]  # What each effect says of itself
    points: Dict[str, np.ndarray]  # Shape (n, 2): places of the named points [m]


@dataclass(frozen=True)
class Finding:
    """Cost and influence of one type of effect."""

    kind: str  # Type of the effects
    names: Tuple[str, ...]  # Which effects of the scene those are
    alone: Ratio  # Time per step with these effects alone, over that of the scene without any
    without: Ratio  # Time per step of the scene without them, over that of the whole scene
    # Largest differences that leaving them out makes: positions [rad, m], efforts [N m, N],
    # forces at the cut joints [N], kinetic and stored energy [J].
    position: float
    effort: float
    force: float
    energy: float
    run: Record  # Without them


@dataclass(frozen=True)
class Study:
    """The findings on one scene."""

    simulation: Simulation  # Of the scene
    run: Record  # Of the scene as it is
    findings: Tuple[Finding, ...]  # One for each type of effect, in the scene's order
    bare: float  # Time per step without any effect [s]
    # Time per step, over that: without any effect once more, which only noise keeps from 1;
    # with all listed but switched off; of the scene as it is.
    again: Ratio
    off: Ratio
    whole: Ratio


def study_effects(scene, duration=2.0, torque=None, rates=None, rows=400,
                  progress=lambda done, total: None):
    """
    Measure what each type of effect costs and changes.

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
    progress : callable
        Called with the parts done and all parts.

    Raises
    ------
    SimulationError, ValueError

    """
    types = {}
    for name, effect in scene.effects.items():
        types.setdefault(effect_type(effect), []).append(name)
    parts = len(types) + 2
    progress(0, parts)
    times = _times(scene, types)
    progress(1, parts)
    simulation = Simulation(scene)
    whole = record(simulation, duration, rows, torque, rates)
    progress(2, parts)
    findings = []
    for k, (kind, names) in enumerate(types.items()):
        run = record(Simulation(_without(scene, names)), duration, rows, torque, rates)
        findings.append(Finding(
            kind, tuple(names), ratio(times['alone', kind], times['bare']),
            ratio(times['without', kind], times['whole']),
            *(float(np.abs(a - b).max(initial=0.0)) for a, b in (
                (run.position, whole.position), (run.effort, whole.effort),
                (run.force, whole.force),
                (run.balance[:, :2].sum(axis=1), whole.balance[:, :2].sum(axis=1)))), run))
        progress(3 + k, parts)
    return Study(simulation, whole, tuple(findings), float(np.median(times['bare'])), *(
        ratio(times[key], times['bare']) for key in ('again', 'off', 'whole')))


def record(simulation, duration, rows, torque=None, rates=None):
    """Run a simulation from its start and keep what happens."""
    control = RateControl(simulation.scene, rates) if rates else None
    kept, step = [], 0
    steps = max(1, round(duration / simulation.step_size))
    for row in range(min(rows, steps) + 1):
        until = round(row * steps / min(rows, steps))
        while step < until:
            if control is None:
                simulation.step(torque, (until - step) * simulation.step_size)
                step = until
            else:
                simulation.step(control.torque(simulation))
                step += 1
        kept.append(_row(simulation))
    columns = list(zip(*kept))
    arrays = [np.array(column) for column in columns[:6]]
    return Record(
        *arrays,
        readings={name: {key: np.array([values[name][key] for values in columns[6]])
                         for key in columns[6][0][name]} for name in columns[6][0]},
        points={name: np.array([values[name] for values in columns[7]])
                for name in columns[7][0]})


def _row(simulation):
    balance = simulation.energy_balance
    return (
        simulation.time, simulation.position, simulation.velocity, simulation.effort,
        np.hypot(*simulation.constraint_forces[:, 1:].T),
        (balance.kinetic, balance.stored, balance.dissipated, balance.work, balance.residual),
        {name: simulation.effect_readings(name) for name in simulation.effects},
        {point.name: simulation.point(point.name) for point in simulation.mechanism.points})


def _only(scene, names):
    """Return the scene with these of its effects."""
    names = tuple(names)
    return replace(scene, effects={name: scene.effects[name] for name in names},
                   switched_off=tuple(name for name in scene.switched_off if name in names))


def _without(scene, names):
    """Return the scene without some of its effects."""
    return _only(scene, (name for name in scene.effects if name not in names))


def _times(scene, types):
    """Return the times per step of every variant, one a round [s]."""
    everything = tuple(scene.effects)
    variants = {
        'whole': Simulation(scene), 'off': Simulation(scene),
        **{key: Simulation(_without(scene, everything)) for key in ('bare', 'again')}}
    for name in everything:
        variants['off'].set_effect(name, enabled=False)
    for kind, names in types.items():
        others = [name for name in everything if name not in names]
        variants['alone', kind] = Simulation(_without(scene, others))
        variants['without', kind] = Simulation(_without(scene, names))
    measured = {key: [] for key in variants}
    keys, shuffle = list(variants), np.random.default_rng(0)
    for _ in range(REPEATS):
        for k in shuffle.permutation(len(keys)):
            simulation = variants[keys[k]]
            simulation.reset()
            tau = simulation.joint_torques(None)
            simulation.advance(tau, RUN_IN)
            start = process_time()
            simulation.advance(tau, STEPS)
            measured[keys[k]].append((process_time() - start) / STEPS)
    return {key: np.array(values) for key, values in measured.items()}


def ratio(times, others):
    """Return the median ratio of times that were measured in turn, and its range."""
    ratios = np.sort(np.divide(times, others))
    count = len(ratios)
    # Ranks between which the median lies in 95 of 100 cases, whatever the distribution is.
    out = max(0, int(0.5 * count - 0.98 * math.sqrt(count)))
    return Ratio(float(np.median(ratios)), float(ratios[out]), float(ratios[count - 1 - out]))
