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
from ..scene_text import same_but_effects
from ..simulation import Simulation

# Beyond this share of a step, a time is no multiple of it.
ROUNDING = 1e-6


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
    player = (_Logged if recording.log is not None else _Stamped)(recording)
    motion, rows = recording.motion, []
    for k in range(len(motion.time)):
        player.go_to(k)
        simulation = player.simulation
        rows.append((*simulation.measured(), simulation.effort, simulation.constraint_forces))
        progress(k + 1)
    simulated = Motion(motion.mechanism, motion.time, *(np.array(values) for values in zip(*rows)))
    return Replay(motion, simulated, player.starts, player.notes)


class _Logged:
    """Follows the replay log: simulated times and commands as they were."""

    def __init__(self, recording):
        self._recording, self._log = recording, recording.log
        self._changes = list(recording.changes[1:])
        first = recording.changes[0] if recording.changes else (recording.scene, {})
        self._scene, self._off = first[0], set(first[1].get('disabled', ()))
        self.simulation = _simulation(recording.scene, self._off)
        self.starts, self.notes = [], []

    def go_to(self, k):
        """Advance to the state of an entry, or start there anew."""
        log, motion = self._log, self._recording.motion
        before = k - 1
        self._change(log.index[before] if k else log.index[0] - 1)
        if k == 0:
            known = log.jumps[0] == 0 and (log.index[0] == 1 or log.time[0] == 0.0)
            if known:
                self._reset(k)
                self.starts.append((log.time[0], 'from the initial state of the scene'))
            else:
                self._set(k, 'from the first recorded state: the recording began later')
        elif log.jumps[k] != log.jumps[before]:
            if log.time[k] < log.time[before]:
                self._reset(k)
                self.starts.append((motion.time[k], 'after a reset'))
            else:
                self._set(k, 'a state was set from outside')
        elif log.index[k] > log.index[before] + 1 and np.any(log.torque[k] != log.torque[before]):
            self._set(k, f'{log.index[k] - log.index[before] - 1} states and their commands are '
                      'missing')
        else:
            self._advance(k, log.time[k] - log.time[before])

    def _advance(self, k, duration):
        steps = duration / self.simulation.step_size
        if abs(steps - round(steps)) > ROUNDING * max(1.0, steps):
            self.simulation.step(self._log.torque[k][self._actuated()], duration)
        elif round(steps):
            # Without a step, a new command has not acted yet.
            self.simulation.advance(self._log.torque[k], round(steps))

    def _actuated(self):
        return [self.simulation.joint_names.index(name)
                for name in self.simulation.actuated_joints]

    def _reset(self, k):
        self.simulation.reset()
        self._advance(k, self._log.time[k])

    def _set(self, k, why):
        motion = self._recording.motion
        self.simulation.set_state(motion.position[k], motion.velocity[k])
        self.simulation.advance(self._log.torque[k], 0)
        self.starts.append((motion.time[k], why))

    def _change(self, index):
        """Apply changes of the scene that were told up to a state."""
        while self._changes and self._changes[0][1].get('after', 0) <= index:
            scene, facts = self._changes.pop(0)
            off = set(facts.get('disabled', ()))
            simulation = self.simulation
            if not same_but_effects(scene, self._scene):
                self.simulation = _simulation(scene, off)
                self.simulation.set_state(simulation.position, simulation.velocity)
                self.notes.append(
                    'the method was changed on the way: memories of effects (lag, friction) '
                    'began anew there')
            else:
                _switch(simulation, scene.effects, off)
            self._scene, self._off = scene, off


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
            self.notes.append('effects were changed on the way, which is left out')
        if any(hasattr(effect, 'drives') for effect in recording.scene.effects.values()):
            self.notes.append('the scene has drives: the efforts behind them are commanded')
        self._steps = 0

    def go_to(self, k):
        """Advance to the time of a stamp."""
        motion, simulation = self._motion, self.simulation
        if k == 0:
            simulation.set_state(motion.position[0], motion.velocity[0])
            return
        due = round(motion.time[k] / simulation.step_size)
        torque = np.where([joint.actuated for joint in motion.mechanism.joints],
                          motion.effort[k], 0.0)
        simulation.advance(torque, max(0, due - self._steps))
        self._steps = max(due, self._steps)


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
        of_cut = forces[:, k]
        rows.append((f'{cut.name} (force)', _deviations(np.hypot(*of_cut[:, 1:].T)), '', ''))
    return text_table(
        ('largest, rms', 'position [rad, m]', 'velocity [1/s]', 'effort [N m, N]'),
        [row if row[2] else (row[0], row[1] + ' N', '', '') for row in rows])


def _deviations(values):
    values = values[np.isfinite(values)]
    if not len(values):
        return 'not recorded'
    return f'{short(np.abs(values).max())}, {short(np.sqrt(np.mean(values ** 2)))}'
