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

"""Many simulations of one scene at once: what ``Simulation.rollout`` does."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
import os
import threading
from typing import Optional

import numpy as np

from .errors import SimulationError
from .key_paths import changed
from .rollout_input import Given, scheduled
from .rollout_lockstep import FEWEST, may_go_together, MOST, Start, Together
from .rollout_run import checked_quantities, is_plain, nothing, record, STATE


@dataclass(frozen=True)
class Rollout:
    """
    What many simulations of one scene did; NaN where a sample failed, from then on.

    Attributes
    ----------
    time : ndarray, shape (instants,)
        [s]; the first instant is the start.
    position, velocity : ndarray, shape (samples, instants, nv)
        Joint coordinates [rad or m] and rates [rad/s or m/s].
    acceleration : ndarray, shape (samples, instants, nv)
        [rad/s^2 or m/s^2], under the torques acting up to the instant.
    effort : ndarray, shape (samples, instants, nv)
        Joint torques, behind the drives [N m or N].
    constraint_forces : ndarray, shape (samples, instants, number of cuts, 3)
        As ``Simulation.constraint_forces`` [N m, N].
    joint_forces : ndarray, shape (samples, instants, nv, 3)
        As ``Simulation.joint_forces`` [N m, N].
    points : ndarray, shape (samples, instants, number of points, 2)
        Places of the named points [m].
    closure : ndarray, shape (samples, instants)
        Largest closure error [m or rad].
    energy : ndarray, shape (samples, instants)
        Kinetic and stored [J].
    failures : dict of int to str
        Why each sample that failed did, and by how much energy balances are off.

    Notes
    -----
    A quantity that was not asked for is None.

    """

    time: np.ndarray
    position: Optional[np.ndarray] = None
    velocity: Optional[np.ndarray] = None
    acceleration: Optional[np.ndarray] = None
    effort: Optional[np.ndarray] = None
    constraint_forces: Optional[np.ndarray] = None
    joint_forces: Optional[np.ndarray] = None
    points: Optional[np.ndarray] = None
    closure: Optional[np.ndarray] = None
    energy: Optional[np.ndarray] = None
    failures: dict = field(default_factory=dict)


def rollout(simulation, torques=None, initial_position=None, initial_velocity=None, *, hold=None,
            duration=None, steps=None, every=1, parameters=None, quantities=STATE,
            threads=None):
    """
    Run many simulations; see ``Simulation.rollout``.

    Raises
    ------
    ValueError

    """
    given = Given(simulation, torques, initial_position, initial_velocity, parameters)
    schedule = scheduled(simulation.step_size, given.rows, duration, steps, every)
    quantities = checked_quantities(quantities)
    runs = _Runs(simulation, given, schedule, quantities, hold)
    results = {name: np.empty((given.samples, *values.shape))
               for name, values in runs.nothing().items()}
    failures = {}

    def run(samples):
        for sample, (done, failure) in runs.run(samples, results):
            for name, values in done.items():
                if not np.may_share_memory(results[name], values):
                    results[name][sample] = values
            if failure is not None:
                failures[sample] = failure

    _each(run, runs.portions(), threads)
    time = schedule.interval * (schedule.every * np.arange(schedule.instants))
    return Rollout(time, **results, failures=dict(sorted(failures.items())))


def _each(run, portions, threads):
    """Call a function with the numbers of some samples at a time, in several threads."""
    if threads is None:
        threads = len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else (
            os.cpu_count() or 1)
    if int(threads) != threads or threads < 1:
        raise ValueError(f'threads: expected a whole number > 0, got {threads!r}')
    if min(threads, len(portions)) == 1:
        for samples in portions:
            run(samples)
        return
    pool = ThreadPoolExecutor(int(threads))
    try:
        for _ in pool.map(run, portions):
            pass
    finally:
        pool.shutdown(cancel_futures=True)


class _Runs:
    """Some runs after the others; a thread keeps its simulation where that changes nothing."""

    def __init__(self, simulation, given, schedule, quantities, hold):
        self._type, self._given, self._schedule = type(simulation), given, schedule
        self._quantities, self._hold = quantities, hold
        self._scene = replace(simulation.scene, effects=simulation.effects)
        self._disabled = [name for name in simulation.effects
                          if name not in simulation.enabled_effects]
        self._again = not given.parameters and is_plain(simulation)
        self._together = may_go_together(simulation, schedule)
        self._own = threading.local()

    def nothing(self):
        """Return the results of a run that did not even begin."""
        return nothing(self._quantities, self._scene.mechanism, self._schedule.instants)

    def portions(self):
        """Return the numbers of all samples, those together that may be run together."""
        count, size = self._given.samples, MOST if self._together else 1
        return [range(first, min(first + size, count)) for first in range(0, count, size)]

    def run(self, samples, results):
        """Return for each of some samples its number, results and why it ended early or None."""
        starts = self._starts(samples) if len(samples) >= FEWEST else {}
        done = {}
        if starts and all(may_go_together(start.simulation, self._schedule)
                          for start in starts.values()):
            if not hasattr(self._own, 'together'):
                self._own.together = Together(self._schedule, self._quantities)
            room = None
            if len(starts) == MOST and all(name in results for name in STATE):
                room = tuple(results[name][samples[0]:samples[-1] + 1] for name in STATE)
            together = self._own.together.record(list(starts.values()), room)
            done = dict(zip(starts, together or ()))
        for sample in samples:
            yield sample, self._result(done[sample]) if sample in done else self._alone(sample)

    def _starts(self, samples):
        """Return what those samples begin with that can begin."""
        given, starts = self._given, {}
        for sample in samples:
            if starts and self._again and given.position is None and given.velocity is None:
                # Nothing has moved since the first of them.
                starts[sample] = replace(starts[samples[0]], torques=given.torques_of(sample))
                continue
            try:
                starts[sample] = self._start(sample)
            except (SimulationError, ValueError):
                # Run alone, it will say why.
                pass
        return starts

    def _result(self, record):
        return record.values, record.failure

    def _alone(self, sample):
        """Return results by quantity, and why the run ended early or None."""
        try:
            start = self._start(sample)
            return self._result(record(start.simulation, start.torques, self._schedule,
                                       self._quantities))
        except (SimulationError, ValueError) as error:
            return self.nothing(), str(error)

    def _start(self, sample):
        """Return what a run begins with, its simulation standing there."""
        given = self._given
        simulation = self._simulation(sample)
        position, velocity = given.state_of(sample)
        if position is not None or velocity is not None:
            initial = simulation.scene.initial
            hold = self._hold
            if position is None:
                position, hold = initial.position, hold or initial.hold
            simulation.set_state(position, velocity, hold)
        return Start(simulation, simulation._state.copy(), given.torques_of(sample))

    def _simulation(self, sample):
        """Return a simulation at its start."""
        simulation = getattr(self._own, 'simulation', None)
        if simulation is not None:
            simulation.reset()
            return simulation
        scene = changed(self._scene, self._given.parameters_of(sample))
        simulation = self._type(scene)
        if self._disabled:
            for name in self._disabled:
                simulation.set_effect(name, enabled=False)
            simulation.reset()
        if self._again:
            self._own.simulation = simulation
        return simulation
