# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Repeat a recorded simulation, and compare the recorded states with it."""

from dataclasses import dataclass, field, fields, replace

import numpy as np

from ..mechanism.errors import SimulationError
from ..scene.integrators import ADAPTIVE, AUTO, INTEGRATORS
from ..simulation.simulation import Simulation
from ..visual.tables import short, text_table
from ..visual.trajectory import magnitudes, Trajectory

# Beyond this share of a step, a time is not a multiple of it.
STAMP_ROUNDING = 1e-6
# Added to the coordinates at each start of a second replay, to see how differences grow [rad, m].
PERTURBATION = 1e-12
# Allowed ratio of rounding on another machine to the growth of the perturbation.
MARGIN = 10.0
SENSORS = ('the scene has sensors: the states of the log are compared, not what was measured of '
           'them')
MEMORY = ('the recording does not hold what the integrator, or commands on their way to a drive, '
          'remembered where it starts, and no command begins later: deviations are those of the '
          "method's tolerance, and grow")


@dataclass(frozen=True)
class Replay:
    """A recorded motion and its re-simulation."""

    # At the same instants; the simulated values are NaN where too little is known to
    # compare.
    recorded: Trajectory
    simulated: Trajectory
    starts: list  # List of (float, str): times at which the re-simulation began again [s], and why
    notes: list  # List of str: limits of the comparison
    # How many times larger a small difference of positions has become up to each instant.
    growth: np.ndarray
    # By topic and name, recorded less simulated forces of couplings and prescribed motions.
    efforts: dict = field(default_factory=dict)
    # Difference of positions at a start that is explained [rad or m]: by rounding, or by the
    # error that the method may make where the recording does not hold its past.
    explained: float = MARGIN * PERTURBATION

    def deviation(self, quantity):
        """
        Return recorded minus re-simulated values of a quantity.

        They are NaN where nothing was recorded, or too little is known to compare.
        """
        return getattr(self.recorded, quantity) - getattr(self.simulated, quantity)

    @property
    def largest(self):
        """Return the largest deviation of a position [rad or m]; NaN where none was compared."""
        deviation = np.abs(self.deviation('position'))
        return float(np.nanmax(deviation)) if np.isfinite(deviation).any() else np.nan

    @property
    def unexplained(self):
        """Return the first time of a deviation that nothing explains [s], or None."""
        deviation = np.abs(self.deviation('position')).max(axis=1)
        places = np.flatnonzero(deviation > self.explained * np.maximum(self.growth, 1.0))
        return float(self.recorded.time[places[0]]) if len(places) else None


def replay(recording, progress=lambda time: None):
    """
    Simulate a recording again, twice: to compare, and to see how differences grow.

    ``progress`` is called with how many states are done. Raises SimulationError where that fails.
    """
    kind = _Stamped if recording.log is None else _Logged
    player = kind(recording)
    motion, values, true, forces = recording.motion, [], [], []
    perturbed = _positions(kind(recording, PERTURBATION))
    growth = []
    for known, other in zip(player.states(), perturbed):
        simulation = player.simulation
        portion = (*simulation.measured(), simulation.effort, simulation.constraint_forces)
        values.append(portion if known else tuple(np.full_like(each, np.nan) for each in portion))
        true.append(simulation.state)
        if recording.efforts:
            forces.append(simulation.data.equation_forces() if known else {})
        growth.append(np.abs(other - simulation.position).max() / PERTURBATION)
        progress(len(values))
    simulated = Trajectory(
        motion.mechanism, motion.time, *(np.array(each) for each in zip(*values)))
    if player.sensed and recording.log is not None and recording.log.whole is not None:
        logged = [whole for whole, state in zip(recording.log.whole, recording.log.state)
                  if state >= 0]
        motion, simulated = _true(motion, logged), _true(simulated, true)
        player.notes.append(SENSORS)
    explained = MARGIN * PERTURBATION
    method = recording.scene.method
    if MEMORY in player.notes and INTEGRATORS[method.integrator].kind == ADAPTIVE:
        explained = method.accuracy if method.integrator == AUTO else method.tolerance
    efforts = {topic: {name: recorded - [each.get(topic, {}).get(name, np.nan) for each in forces]
                       for name, recorded in efforts.items()}
               for topic, efforts in recording.efforts.items()}
    return Replay(motion, simulated, player.starts, player.notes, np.maximum.accumulate(growth),
                  efforts, explained)


def _true(motion, states):
    """Return a motion with positions and velocities of whole states."""
    names = motion.mechanism.coordinates
    values = np.array([state[:names.nq + names.nv] for state in states])
    values[np.isnan(motion.position).any(axis=1)] = np.nan
    return replace(motion, position=values[:, :names.nq], velocity=values[:, names.nq:])


def _positions(player):
    """Yield the positions of a replay, infinite from where it fails."""
    try:
        for _ in player.states():
            yield player.simulation.position
    except SimulationError:
        while True:
            yield np.full(player.simulation.coordinates.nq, np.inf)


class _Player:
    """A simulation that follows a recording, with small differences at its starts if wanted."""

    def __init__(self, recording, perturbation):
        self._recording, self._perturbation = recording, perturbation
        # What a budget led to is in the log.
        self.simulation = Simulation(replace(
            recording.scene, method=recording.scene.method.without_budget))
        self.starts, self.notes = [], []
        self.sensed = any(
            effect.instrument() is not None for effect in self.simulation.effects.values())

    def _start(self, state, time):
        """Set a whole state bit for bit, but for the perturbation."""
        names, state = self.simulation.coordinates, state.copy()
        if self._perturbation:
            state[:names.nq] = names.moved(state[:names.nq], (
                self._perturbation * np.random.default_rng(0).standard_normal(names.nv)))
        self.simulation.restore(state, time)


class _Logged(_Player):
    """Follows the replay log: simulated times and commands as they were."""

    def __init__(self, recording, perturbation=0.0):
        self._log, self._changes = recording.log, list(recording.changes[1:])
        self._scene = recording.changes[0][0] if recording.changes else recording.scene
        super().__init__(recording, perturbation)
        # Torques that act at each entry: without a step, a new command has not acted yet.
        self._acting = self._log.torque.copy()
        for k in np.flatnonzero(np.diff(self._log.time) == 0.0) + 1:
            self._acting[k] = self._acting[k - 1]
        # Whether the present state is lost; from which entry on it is known to the last bit.
        self._lost, self._known = True, 0

    def states(self):
        """Go from entry to entry; yield at each state whether it is exact to the last bit."""
        for k, state in enumerate(self._log.state):
            self._go_to(k)
            if state >= 0:
                yield k >= self._known

    def _go_to(self, k):
        """Advance to the time of an entry, or start there again."""
        log, before = self._log, max(k - 1, 0)
        jump = log.jumps[k] != log.jumps[before]
        if jump and log.time[k] < log.time[before]:
            # Which forgets the motions that were commanded before it.
            self.simulation.reset()
        if k:
            self._change(log.index[before])
        gap = log.index[k] - log.index[before] - 1
        if k == 0 and log.jumps[0] == 0 and (log.index[0] == 1 or log.time[0] == 0.0):
            self._reset(k, 'from the initial state of the scene')
        elif jump and log.time[k] < log.time[before]:
            self._reset(k, 'after a reset')
        elif k == 0 or jump or self._lost or gap > 0:
            self._set(k, 'from the first recorded state: the recording began later' if k == 0
                      else 'a state was set from outside' if jump
                      else f'{gap} entries with their commands are missing' if gap > 0
                      else 'the first recorded state')
        else:
            if self._scene.method.by_budget and log.whole is not None:
                self.simulation.stepping.adopt_accuracy(log.whole[before])
            self._advance(k, log.time[k] - log.time[before])
            if k == self._known:
                self._start(log.whole[k], log.time[k])
                self.starts.append((float(log.time[k]), 'compared from here, where a command '
                                    'begins: now all that acts is in the recording'))

    def _advance(self, k, duration):
        torque, simulation = self._log.torque[k], self.simulation
        steps = duration / simulation.step_size
        if abs(steps - round(steps)) > STAMP_ROUNDING * max(1.0, steps):
            simulation.step({name: torque[simulation.torque_names.index(name)]
                             for name in simulation.actuated_joints}, duration)
        elif round(steps):
            simulation.advance(torque, round(steps))

    def _reset(self, k, why):
        self._lost, self._known = False, k
        self.simulation.reset()
        if self._perturbation:
            self._start(self.simulation.state, 0.0)
        self.starts.append((float(self._log.time[k]), why))
        self._advance(k, self._log.time[k])

    def _set(self, k, why):
        """Start from a recorded state; where the entry has none, at the next that has one."""
        log, motion = self._log, self._recording.motion
        self._known = k
        if log.whole is not None and len(log.whole[k]) == len(self.simulation.state):
            self._start(log.whole[k], log.time[k])
            self._known = self._first_known(k)
        else:
            # A bag of an earlier version, or another scene: without the effects' states.
            self._lost = log.state[k] < 0
            if self._lost:
                return
            self.simulation.set_state(
                motion.position[log.state[k]], motion.velocity[log.state[k]])
            self._start(self.simulation.state, log.time[k])
        self._lost = False
        self.simulation.advance(self._acting[k], 0)
        self.starts.append((float(log.time[k]), why))

    def _first_known(self, k):
        """Return the first entry from k on at which nothing acts that is not in the log."""
        log, simulation = self._log, self.simulation
        delay = max(simulation.data.effect_set.drives.values(), default=0.0)
        # Error control restarts with a command; a delayed one does so between two entries.
        adaptive = INTEGRATORS[simulation.scene.method.integrator].kind == ADAPTIVE
        for entry in range(k, len(log.time) - 1):
            begins = not adaptive or delay == 0.0 and np.any(
                self._acting[entry + 1] != self._acting[entry])
            if begins and log.time[entry] - log.time[k] >= delay:
                return entry
            if (log.jumps[entry + 1] != log.jumps[k]
                    or log.index[entry + 1] != log.index[entry] + 1):
                break
        if MEMORY not in self.notes and (adaptive or delay > 0.0):
            self.notes.append(MEMORY)
        return k

    def _change(self, index):
        """Apply the changes of the scene that were recorded up to an entry."""
        while self._changes and self._changes[0][1].get('after', 0) <= index:
            scene, facts = self._changes.pop(0)
            method = {field.name: getattr(scene.method, field.name)
                      for field in fields(scene.method)
                      if getattr(scene.method, field.name)
                      != getattr(self._scene.method, field.name)}
            if method:
                # What a budget led to is in the log.
                method.pop('budget', None)
                self.simulation.stepping.prepare_method(**method)()
            _switch(self.simulation, scene)
            self._scene = scene


class _Stamped(_Player):
    """Makes do with stamps and efforts, where there is no log."""

    def __init__(self, recording, perturbation=0.0):
        super().__init__(recording, perturbation)
        self._motion = recording.motion
        self.starts.append((0.0, 'from the first recorded state'))
        self.notes.append(
            'there is no replay_log in it, or no scene that names its columns: times are those of '
            'the stamps, rounded to whole steps, and torques the recorded efforts; record the '
            'topics replay_log and scene for an exact replay')
        if len(recording.changes) > 1:
            self.notes.append('the scene was changed on the way, which is left out')
        if any(effect.drive() is not None for effect in recording.scene.effects.values()):
            self.notes.append('the scene has drives: the efforts behind them are commanded')
        if any(cut.actuated for cut in recording.scene.mechanism.cut_joints):
            self.notes.append('torques at cut joints are left out')

    def states(self):
        motion, simulation = self._motion, self.simulation
        simulation.set_state(motion.position[0], motion.velocity[0])
        self._start(simulation.state, 0.0)
        tau, driven = simulation.joint_torques(None), simulation.data.actuated_in_tree
        done = 0
        for time, effort in zip(motion.time, motion.effort):
            due = round(time / simulation.step_size)
            tau[driven] = effort[driven]
            simulation.advance(tau, max(0, due - done))
            done = max(due, done)
            yield True


def _switch(simulation, scene):
    """Give the effects of a running simulation those values that they have in a scene."""
    for name, record in scene.effects.items():
        enabled = name not in scene.switched_off
        acts = name in simulation.data.enabled_effects
        if record != simulation.effects[name] or enabled != acts:
            simulation.set_effect(name, enabled=enabled, **{
                field.name: getattr(record, field.name) for field in fields(record)})


def table(result):
    """Return the deviations as a table."""
    motion = result.recorded
    rows = []
    for group in motion.mechanism.coordinates.groups:
        rows.append((group.name, *(
            _deviations(result.deviation(quantity)[:, places])
            for quantity, places in (('position', group.coordinates), ('velocity', group.rates),
                                     ('effort', group.rates)))))
    forces = result.deviation('forces')
    for k, cut in enumerate(motion.mechanism.cut_joints):
        rows.append((f'{cut.name} (force)', '', '', _deviations(magnitudes(forces[:, k]))))
    for topic, efforts in result.efforts.items():
        rows += [(f'{name} ({topic[:-len("_forces")]})', '', '', _deviations(values))
                 for name, values in efforts.items()]
    return text_table(
        ('largest, rms', 'position [rad, m]', 'velocity [1/s]', 'effort, force [N m, N]'), rows)


def _deviations(values):
    values = values[np.isfinite(values)]
    if not len(values):
        return 'not recorded'
    return f'{short(np.abs(values).max())}, {short(np.sqrt(np.mean(values ** 2)))}'
