# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A sweep from its description to its file."""

from collections import Counter
from dataclasses import dataclass, field
from functools import partial
import re

import numpy as np

from .batch import failed, Job, run_batch, SAMPLE_FAILED
from .executors import dispatched, engine_for
from .plan import combined, Plan, variation
from .storage import checked_path, Layout, opened
from ..mechanism.fields import FieldError
from ..scene.loading import load_scene
from ..scene.records import require_no_budget, Scene
from ..simulation.rollout_run import STATE

# Samples in a batch: so many batches, so many samples, so much memory [B] at most.
BATCHES, LARGEST_BATCH, MOST_BATCH_BYTES = 64, 64, 64_000_000
NUMBER = re.compile(r'(?<![\w.])-?\d+\.?\d*(e[-+]?\d+)?(?!\w)')


@dataclass
class Outcome:
    """
    Result of a sweep.

    Attributes
    ----------
    samples : int
        Of the whole sweep.
    before : int
        That were there already.
    done : int
        Computed now, failed ones among them.
    failed : int
        Of these.
    reasons : collections.Counter
        Why they failed, without the numbers in it.

    """

    samples: int
    before: int = 0
    done: int = 0
    failed: int = 0
    reasons: Counter = field(default_factory=Counter)

    @property
    def finished(self):
        """Return whether every sample is there."""
        return self.before + self.done == self.samples


def sweep(scene, vary, output, *, samples=1, seed=0, duration=2.0, rate=100.0, torque=None,
          torques=None, keep=STATE, resume=False, overwrite=False, workers=None, scheduler=None,
          executor=None, on_progress=None, keep_going=lambda: True):
    """
    Run many simulations of one scene with different numbers, and write results to a file.

    Parameters
    ----------
    scene : Scene, str or pathlib.Path
        As ``load_scene`` takes it.
    vary : mapping of str to str or sequence of float, or sequence of Grid and Random
        Variations by key path: the forms of the command line, or the values of a grid.
    output : str or pathlib.Path
        Ends with .nc or .zarr.
    samples : int
        Draws from the distributions, at each point of the grid.
    seed : int
        Of the draws.
    duration, rate : float
        Simulated time [s], and instants per second [Hz].
    torque : mapping of str to float, optional
        Constant torques of actuated joints [N m or N].
    torques : array_like, optional
        Sequences of them, for equal parts of the duration: shape (rows, number of actuated
        joints), or (samples, rows, number of actuated joints).
    keep : sequence of str
        Quantities kept at every instant, of ``rollout_run.QUANTITIES``; the final values and a
        summary always are.
    resume : bool
        Go on where a file is there already, of the same sweep.
    overwrite : bool
        Replace a file that is there.
    workers : int, optional
        Processes on this machine; as many as it has processors, where that pays, when not
        given.
    scheduler : str, optional
        Address of a Dask cluster to run on instead.
    executor : concurrent.futures.Executor or the like, optional
        To run on instead; it is not shut down.
    on_progress : callable, optional
        Takes the ``Outcome`` so far, after every batch.
    keep_going : callable
        Polled; where it returns False the sweep ends early, with a valid file.

    Raises
    ------
    SceneError, FieldError
        For what makes no sense; nothing is written.
    StorageError, EngineError
        For a file that cannot be written, and workers that are gone.

    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    require_no_budget(scene.method, 'a sweep')
    if hasattr(vary, 'items'):
        vary = [variation(key, what) for key, what in vary.items()]
    plan = Plan(scene, tuple(vary), samples, seed, float(duration), float(rate),
                combined(torque, torques, scene), tuple(keep))
    path = checked_path(output)
    if workers is not None and (workers != int(workers) or workers < 1):
        raise FieldError('a whole number > 0', repr(workers), path=('workers',))
    layout = Layout(plan, 1)
    layout.batch = batch_size(layout)
    batches = -(-plan.samples // layout.batch)
    with engine_for(batches, workers, scheduler, executor) as engine, \
            opened(path, layout, resume, overwrite) as storage:
        missing = np.flatnonzero(~storage.done())
        outcome = Outcome(plan.samples, plan.samples - len(missing))
        if len(missing):
            _compute(plan, layout, storage, engine, missing, outcome, on_progress, keep_going)
    return outcome


def _compute(plan, layout, storage, engine, missing, outcome, on_progress, keep_going):
    """Compute the missing samples, write them as they come."""
    job = Job(plan.scene, plan.paths, plan.schedule, plan.keep)
    # Those of one batch lie together in the file, whichever of them are missing.
    starts = np.flatnonzero(np.diff(missing // layout.batch)) + 1
    tasks = np.split(missing, starts)
    for batch in dispatched(engine, calls(job, plan), partial(failed, job), tasks, keep_going):
        storage.write(batch)
        outcome.done += len(batch.samples)
        outcome.failed += int((batch.status == SAMPLE_FAILED).sum())
        outcome.reasons.update(without_numbers(reason) for reason in batch.reasons if reason)
        if on_progress is not None:
            on_progress(outcome)


def calls(job, plan):
    """Return a factory of the function, with arguments, that computes samples."""
    def call(samples):
        return run_batch, job, samples, plan.values(samples), plan.torques_of(samples)
    return call


def batch_size(layout):
    """
    Return how many samples are computed and written at once.

    It is the same for the same sweep, wherever it runs.
    """
    most = MOST_BATCH_BYTES // layout.bytes_per_sample()
    return int(max(1, min(layout.samples // BATCHES, LARGEST_BATCH, most)))


def without_numbers(reason):
    """Return a reason without its numbers, which differ from sample to sample."""
    return NUMBER.sub('...', reason)
