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

"""Simulate again what was recorded, and tell how far the recorded states are from that."""

from dataclasses import dataclass, fields

import numpy as np

from .motion import Motion
from .tables import short, text_table
from ..simulation import Simulation

# Beyond this share of a step, a time is no multiple of it.
ROUNDING = 1e-6
SENSORS = 'the scene has sensors: a start from a recorded state is one from what they measured'


@dataclass(frozen=True)
class Replay:
    """
    A recorded motion and its re-simulation.

    Attributes
    ----------
    recorded, simulated : Motion
        At the same instants.
    starts : list of (float, str)
        Times at which the re-simulation began anew [s], and why.
    notes : list of str
        What limits the comparison.

    """

    recorded: Motion
    simulated: Motion
    starts: list
    notes: list

    def deviation(self, quantity):
        """
        Return recorded minus re-simulated values.

        Parameters
        ----------
        quantity : str
            ``'position'``, ``'velocity'``, ``'effort'`` or ``'forces'``.

        Returns
        -------
        ndarray
            NaN where nothing was recorded.

        """
        return getattr(self.recorded, quantity) - getattr(self.simulated, quantity)

    @property
    def largest(self):
        """Return the largest deviation of a position [rad or m]."""
        return float(np.abs(self.deviation('position')).max())


def replay(recording, progress=lambda time: None):
    """
    Simulate a recording again, from its commands.

    Parameters
    ----------
    recording : recording.Recording
        With its scene.
    progress : callable
        Told how many states are done.

    Returns
    -------
    Replay

    Raises
    ------
    SimulationError
        Where the re-simulation fails.

    """
    motion, rows = recording.motion, []
    player = (_Stamped if recording.log is None else _Logged)(recording)
    for _ in player.states():
        simulation = player.simulation
        rows.append((*simulation.measured(), simulation.effort, simulation.constraint_forces))
        progress(len(rows))
    simulated = Motion(motion.mechanism, motion.time, *(np.array(values) for values in zip(*rows)))
    return Replay(motion, simulated, player.starts, player.notes)


class _Logged:
    """Follows the replay log: simulated times and commands as they were."""

    def __init__(self, recording):
        self._recording, self._log = recording, recording.log
        self._changes = list(recording.changes[1:])
        self._scene, facts = (*recording.changes[:1], (recording.scene, {}))[0]
        self.simulation = _simulation(recording.scene, facts.get('disabled', ()))
        self._lost = True
        self.starts, self.notes = [], []

    def states(self):
        """Go to the state of one entry after the other; yield after each that was recorded."""
        for k, state in enumerate(self._log.state):
            self._go_to(k, state)
            if state >= 0:
                yield

    def _go_to(self, k, state):
        """Advance to the time of an entry, or start there anew."""
        log, before = self._log, max(k - 1, 0)
        if k:
            self._change(log.index[before])
        jump = log.jumps[k] != log.jumps[before]
        gap = log.index[k] - log.index[before] - 1
        if k == 0 and log.jumps[0] == 0 and (log.index[0] == 1 or log.time[0] == 0.0):
            self._reset(k, 'from the initial state of the scene')
        elif jump and log.time[k] < log.time[before]:
            self._reset(k, 'after a reset')
        elif k == 0 or jump or self._lost or gap > 0 and np.any(
                log.torque[k] != log.torque[before]):
            why = ('from the first recorded state: the recording began later' if k == 0
                   else 'a state was set from outside' if jump
                   else f'{gap} entries with their commands are missing' if gap > 0
                   else 'the first recorded state')
            self._set(k, state, why)
        else:
            self._advance(k, log.time[k] - log.time[before])

    def _advance(self, k, duration):
        torque, simulation = self._log.torque[k], self.simulation
        steps = duration / simulation.step_size
        if abs(steps - round(steps)) > ROUNDING * max(1.0, steps):
            simulation.step({name: torque[simulation.joint_names.index(name)]
                             for name in simulation.actuated_joints}, duration)
        elif round(steps):
            # Without a step, a new command has not acted yet.
            simulation.advance(torque, round(steps))

    def _reset(self, k, why):
        self._lost = False
        self.simulation.reset()
        self.starts.append((float(self._log.time[k]), why))
        self._advance(k, self._log.time[k])

    def _set(self, k, state, why):
        """Start from a recorded state; where the entry has none, at the next that has one."""
        self._lost = state < 0
        if self._lost:
            return
        motion = self._recording.motion
        self.simulation.set_state(motion.position[state], motion.velocity[state])
        self.simulation.advance(self._log.torque[k], 0)
        self.starts.append((float(self._log.time[k]), why))
        if SENSORS not in self.notes and any(
                hasattr(effect, 'instrument') for effect in self.simulation.effects.values()):
            self.notes.append(SENSORS)

    def _change(self, index):
        """Apply changes of the scene that were told up to an entry."""
        while self._changes and self._changes[0][1].get('after', 0) <= index:
            scene, facts = self._changes.pop(0)
            method = {field.name: getattr(scene.method, field.name)
                      for field in fields(scene.method)
                      if getattr(scene.method, field.name)
                      != getattr(self._scene.method, field.name)}
            if method:
                self.simulation.prepare_method(**method)()
            _switch(self.simulation, scene.effects, facts.get('disabled', ()))
            self._scene = scene


class _Stamped:
    """Makes do with stamps and efforts, where there is no log."""

    def __init__(self, recording):
        self._motion = recording.motion
        self.simulation = _simulation(recording.scene, ())
        self.starts = [(0.0, 'from the first recorded state')]
        self.notes = [
            'there is no replay_log in it: times are those of the stamps, rounded to whole steps, '
            'and torques the recorded efforts; record the topic replay_log for an exact replay']
        if len(recording.changes) > 1:
            self.notes.append('the scene was changed on the way, which is left out')
        if any(hasattr(effect, 'drives') for effect in recording.scene.effects.values()):
            self.notes.append('the scene has drives: the efforts behind them are commanded')

    def states(self):
        """Go from stamp to stamp; yield at each."""
        motion, simulation = self._motion, self.simulation
        simulation.set_state(motion.position[0], motion.velocity[0])
        actuated = [joint.actuated for joint in motion.mechanism.joints]
        done = 0
        for time, effort in zip(motion.time, motion.effort):
            due = round(time / simulation.step_size)
            simulation.advance(np.where(actuated, effort, 0.0), max(0, due - done))
            done = max(due, done)
            yield


def _simulation(scene, off):
    simulation = Simulation(scene)
    for name in off:
        simulation.set_effect(name, enabled=False)
    return simulation


def _switch(simulation, effects, off):
    """Give the effects of a running simulation other values."""
    for name, record in effects.items():
        enabled = name not in off
        if record != simulation.effects[name] or enabled != (name in simulation.enabled_effects):
            simulation.set_effect(name, enabled=enabled, **{
                field.name: getattr(record, field.name) for field in fields(record)})


def table(result):
    """
    Return the deviations as a table.

    Parameters
    ----------
    result : Replay
        Compared.

    Returns
    -------
    str

    """
    motion = result.recorded
    rows = []
    for k, joint in enumerate(motion.mechanism.joints):
        rows.append((joint.name, *(_deviations(result.deviation(quantity)[:, k])
                                   for quantity in ('position', 'velocity', 'effort'))))
    forces = result.deviation('forces')
    for k, cut in enumerate(motion.mechanism.cut_joints):
        rows.append((f'{cut.name} (force)', '', '', _deviations(
            np.hypot(*forces[:, k, 1:].T))))
    return text_table(
        ('largest, rms', 'position [rad, m]', 'velocity [1/s]', 'effort, force [N m, N]'), rows)


def _deviations(values):
    values = values[np.isfinite(values)]
    if not len(values):
        return 'not recorded'
    return f'{short(np.abs(values).max())}, {short(np.sqrt(np.mean(values ** 2)))}'
