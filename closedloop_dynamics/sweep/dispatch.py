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

"""Hand out batches, take in their results, and lose none when workers are lost."""

from collections import deque
from concurrent.futures import BrokenExecutor, CancelledError, FIRST_COMPLETED, wait
from dataclasses import dataclass

import numpy as np

from .batch import failed, run_batch

# Between two looks whether to go on [s].
LOOK_EVERY = 0.2


@dataclass
class Task:
    """
    Samples to be computed together.

    Attributes
    ----------
    samples : ndarray of int
    lost : int
        How often their worker was lost.

    """

    samples: np.ndarray
    lost: int = 0

    @property
    def suspect(self):
        """Return whether these samples may be what kills workers."""
        return self.lost > 1


def dispatched(engine, job, plan, tasks, keep_going):
    """
    Compute tasks, in whatever order.

    Parameters
    ----------
    engine : object
        Of ``executors``.
    job : Job
        What all samples have in common.
    plan : Plan
        Of the sweep.
    tasks : iterable of ndarray of int
        Samples that are computed together.
    keep_going : callable
        Asked again and again; the rest is given up where it returns False.

    Yields
    ------
    Batch
        Each sample once. One whose worker is lost whenever it runs, even alone, has failed.

    Raises
    ------
    EngineError
        Where there are no workers any more.

    """
    fresh, again, running = iter(tasks), deque(), {}

    def submit(task):
        future = engine.submit(run_batch, job, task.samples, plan.values(task.samples),
                               plan.torques_of(task.samples))
        running[future] = task

    def hand_out():
        """Keep the workers busy; what may kill a worker runs alone."""
        if any(task.suspect for task in running.values()):
            return
        limit = engine.limit()
        while len(running) < limit:
            task = again.popleft() if again else _next(fresh)
            if task is None:
                return
            if task.suspect and running:
                again.appendleft(task)
                return
            submit(task)
            if task.suspect:
                return

    try:
        hand_out()
        while running and keep_going():
            done, _ = wait(running, timeout=LOOK_EVERY, return_when=FIRST_COMPLETED)
            broken = False
            for future in done:
                broken = (yield from _result(future, running.pop(future), job, again)) or broken
            if broken:
                # The others on their way are lost with the pool.
                wait(running, timeout=LOOK_EVERY)
                for future in list(running):
                    future.cancel()
                    yield from _result(future, running.pop(future), job, again)
                engine.renew()
            hand_out()
    finally:
        for future in running:
            future.cancel()


def _next(fresh):
    samples = next(fresh, None)
    return None if samples is None else Task(samples)


def _result(future, task, job, again):
    """Yield a batch, or see to a lost task; return whether all other work is lost, too."""
    try:
        batch = future.result(0)
    except (CancelledError, OSError):
        # The connection to the engine, or the time to wait for a pool that is lost: nothing that
        # tells against these samples.
        again.append(task)
        return True
    except Exception as error:
        yield from _lost(task, error, job, again)
        return isinstance(error, BrokenExecutor)
    yield batch
    return False


def _lost(task, error, job, again):
    """Put a task back, sample by sample the second time; give it up the third."""
    lost = task.lost + 1
    if task.suspect:
        reason = str(error) or type(error).__name__
        yield failed(job, task.samples, f'the worker that ran it was lost, each time: {reason}')
    elif lost == 1:
        again.append(Task(task.samples, lost))
    else:
        again.extend(Task(np.array([sample]), lost) for sample in task.samples)
