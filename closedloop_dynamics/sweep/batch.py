# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Run some samples of a sweep, in a worker anywhere."""

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from .plan import TORQUE
from ..mechanism.errors import SimulationError
from ..scene.key_paths import changed
from ..scene.records import Scene
from ..simulation.rollout_run import (
    FEWEST, fits_simd, InitialState, MOST, nothing, record, RunResult, SimdRuns, STATE, TimeGrid)
from ..simulation.simulation import Simulation

# What the summary of a sample is made of.
SUMMARISED = (*STATE, 'effort', 'constraint_forces', 'closure', 'energy')
SAMPLE_DONE, SAMPLE_FAILED = 1, 2


@dataclass(frozen=True)
class Job:
    """Data that all samples of a sweep have in common."""

    scene: Scene
    paths: Tuple[Tuple[str, ...], ...]  # What varies
    schedule: TimeGrid
    keep: Tuple[str, ...]  # Quantities kept at every instant


@dataclass
class Batch:
    """The results of some samples, in one array for each variable."""

    samples: np.ndarray  # Shape (n,): their places in the sweep
    values: dict  # Shape (n, ...): by the names of ``storage.Layout.results``
    status: np.ndarray  # Shape (n,): ``SAMPLE_DONE`` or ``SAMPLE_FAILED``
    reasons: list  # List of str: why a sample failed; empty where it did not


def run_batch(job, samples, values, torques):
    """
    Run samples, some of them at a time; a failed one has its reason in the batch, none raises.

    ``samples``: their places in the sweep, shape (n,); ``values`` of the varied quantities, shape
    (n, number of keys); ``torques``, shape (rows, na) or (n, rows, na), or None [N m or N].
    """
    source = _Source(job)
    results, reasons = [], []
    own = torques if torques is not None and torques.ndim == 3 else [torques] * len(values)
    for first in range(0, len(values), MOST):
        some = slice(first, first + MOST)
        for done in _records(job, source, values[some], own[some]):
            results.append(summary(job, done.values))
            reasons.append(done.failure or '')
    return Batch(
        np.asarray(samples), {name: np.array([result[name] for result in results])
                              for name in results[0]},
        np.array([SAMPLE_FAILED if reason else SAMPLE_DONE for reason in reasons], dtype=np.int8),
        reasons)


def failed(job, samples, reason):
    """Return the batch of samples that gave no result at all."""
    wanted = dict.fromkeys((*SUMMARISED, *job.keep))
    empty = summary(job, nothing(wanted, job.scene.mechanism, job.schedule.instants))
    return Batch(np.asarray(samples),
                 {name: np.array([value] * len(samples)) for name, value in empty.items()},
                 np.full(len(samples), SAMPLE_FAILED, dtype=np.int8), [reason] * len(samples))


def _records(job, source, rows, torques):
    """Return the results of samples, run together where possible, else one by one."""
    wanted = tuple(dict.fromkeys((*SUMMARISED, *job.keep)))
    starts = {}
    if len(rows) >= FEWEST and source.together:
        for k, (row, own) in enumerate(zip(rows, torques)):
            try:
                starts[k] = source.start(row, own)
            except Exception:
                # Run alone, it will say why.
                pass
            if not source.together:
                break
    records = None
    if starts and source.together:
        records = SimdRuns(job.schedule, wanted).record(list(starts.values()))
    done = dict(zip(starts, records or ()))
    return [done.get(k) or _singly(job, source, row, own, wanted)
            for k, (row, own) in enumerate(zip(rows, torques))]


def _singly(job, source, row, torques, wanted):
    """Return the result of a sample run alone."""
    try:
        start = source.start(row, torques)
        return record(start.simulation, start.torques, job.schedule, wanted)
    except (SimulationError, ValueError) as error:
        failure = str(error)
    except Exception as error:
        # Whatever it is, the other samples of the sweep shall not be lost by it.
        failure = f'{type(error).__name__}: {error}'
    return RunResult(nothing(wanted, job.scene.mechanism, job.schedule.instants), failure)


def summary(job, values):
    """
    Return the variables of a sample, arrays by name: quantities kept, end state, peaks.

    ``values``: arrays of shape (instants, ...) by name; all that is summarised.
    """
    wrenches = values['constraint_forces']
    moments = wrenches.shape[-1] // 2
    forces = (np.hypot(wrenches[:, :, 1], wrenches[:, :, 2]) if moments == 1
              else np.linalg.norm(wrenches[:, :, moments:], axis=-1))
    moment = (np.abs(wrenches[:, :, 0]) if moments == 1
              else np.linalg.norm(wrenches[:, :, :moments], axis=-1))
    return {
        **{name: values[name] for name in job.keep},
        'final_position': values['position'][-1], 'final_velocity': values['velocity'][-1],
        'initial_energy': values['energy'][0], 'final_energy': values['energy'][-1],
        'peak_force': _peak(forces), 'peak_moment': _peak(moment),
        'peak_effort': _peak(np.abs(values['effort'])), 'peak_closure': _peak(values['closure'])}


def _peak(values):
    """Return the largest values over the instants that were reached; NaN where none was."""
    reached = ~np.isnan(values).reshape(len(values), -1).any(axis=1)
    return values[reached].max(axis=0) if reached.any() else np.full(values.shape[1:], np.nan)


class _Source:
    """Simulations of changed scenes; the same one again where nothing changes."""

    def __init__(self, job):
        self._job, self._values, self._simulation = job, None, None
        # Whether samples may be run together: until one is seen that may not.
        self.together = True

    def start(self, row, torques):
        """Return the initial state of a sample, with its simulation there."""
        simulation, varied = self._at_start(row)
        if torques is None:
            torques = np.zeros((1, len(simulation.actuated_joints)))
        if varied:
            torques = torques.copy()
            for joint, value in varied.items():
                torques[:, simulation.actuated_joints.index(joint)] = value
        return InitialState(simulation, simulation.data.integrated.copy(), torques)

    def _at_start(self, row):
        """Return a simulation at its start, and torques by joint that are varied."""
        values, torque = {}, {}
        for path, value in zip(self._job.paths, row.tolist()):
            if path[0] == TORQUE:
                torque[path[1]] = value
            else:
                values[path] = value
        if self._simulation is not None and values == self._values:
            self._simulation.reset()
        else:
            self._simulation = None
            simulation = Simulation(changed(self._job.scene, values))
            simulation.stepping.monitor.sampling = False
            self._values = values
            self.together &= fits_simd(simulation, self._job.schedule)
            self._simulation = simulation
        return self._simulation, torque
