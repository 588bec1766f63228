# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Where batches are computed, and how none is lost when workers are.

An engine is this process, worker processes of this machine, a Dask cluster or an executor of
``concurrent.futures``. It offers ``submit``, which returns a future, ``limit()`` (how many of
these shall be on their way), ``renew()`` after its workers were lost, and ``close()``.
"""

from collections import deque
from concurrent.futures import (
    BrokenExecutor, CancelledError, FIRST_COMPLETED, Future, ProcessPoolExecutor, wait)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
import importlib
import multiprocessing
import os
import signal
import threading
import time

import numpy as np

from ..mechanism.errors import SimulationError
from ..mechanism.extras import remedy

# Period of polling the number of workers of a cluster [s].
COUNT_WORKERS_EVERY = 5.0
# Computing time that is worth the start of workers, which takes some 5 s: known well, and guessed
# from one batch [s].
WORTH, WORTH_AT_ONCE = 15.0, 600.0
# For a scheduler to answer [s].
SCHEDULER_PATIENCE = 10


class EngineError(SimulationError):
    """Workers that cannot be started, or are gone for good."""


class SerialExecutor:
    """This process itself."""

    def submit(self, function, *arguments):
        """Call the function at once."""
        future = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future

    def limit(self):
        """Return one: there is nothing to be kept busy meanwhile."""
        return 1

    def renew(self):
        """Nothing can be lost."""

    def close(self):
        """Nothing is held."""


class ProcessExecutor:
    """Worker processes on this machine."""

    def __init__(self, workers):
        """Start when the first work comes."""
        self._workers = workers
        # Never a plain fork: this process has threads. A server forks what it has imported.
        forkserver = 'forkserver' in multiprocessing.get_all_start_methods()
        self._context = multiprocessing.get_context('forkserver' if forkserver else 'spawn')
        if forkserver:
            self._context.set_forkserver_preload(['closedloop_dynamics.sweep.batch'])
        self._pool = self._new()

    def _new(self):
        parent, self._alive = self._context.Pipe(duplex=False)
        return ProcessPoolExecutor(
            self._workers, self._context, initializer=_begin, initargs=(parent,))

    def submit(self, function, *arguments):
        """Hand over work."""
        try:
            return self._pool.submit(_work, function, *arguments)
        except BrokenProcessPool as error:
            future = Future()
            future.set_exception(error)
            return future

    def limit(self):
        """Return how many batches keep the workers busy."""
        return 2 * self._workers

    def renew(self):
        """
        Start new workers, all work on its way being lost.

        Raises
        ------
        EngineError
            Where they do not even begin.

        """
        self.close()
        self._pool = self._new()
        try:
            self._pool.submit(os.getpid).result()
        except BrokenProcessPool:
            raise EngineError(
                'The worker processes end as soon as they begin. In a script, call sweep below '
                "if __name__ == '__main__'; otherwise look whether the system kills them, or "
                'take one worker, which is this process.') from None

    def close(self):
        """End the workers, and drop their work."""
        # Not by signals: a worker that is killed while it sends leaves the pool waiting for ever
        # for the rest of its message. A byte for each worker: the end of the pipe means that this
        # process is gone.
        if not self._alive.closed:
            os.write(self._alive.fileno(), bytes(self._workers))
        self._pool.shutdown(cancel_futures=True)
        self._alive.close()


class AdaptiveExecutor:
    """This process at first, worker processes as soon as that is worth their start."""

    def __init__(self, batches, workers):
        """Begin here."""
        self._left, self._workers = batches, workers
        self._engine, self._times = SerialExecutor(), []

    def submit(self, function, *arguments):
        """Compute here, or hand over work."""
        if isinstance(self._engine, SerialExecutor) and self._worth_it():
            self._engine = ProcessExecutor(self._workers)
        self._left -= 1
        begin = time.perf_counter()
        future = self._engine.submit(function, *arguments)
        self._times.append(time.perf_counter() - begin)
        return future

    def _worth_it(self):
        """Return whether the remaining work takes much longer than workers take to start."""
        if not self._times:
            return False
        # The first batch may have waited for the compiler.
        worth = WORTH if len(self._times) > 1 else WORTH_AT_ONCE
        return self._times[-1] * self._left > worth

    def limit(self):
        """Return how many batches keep the present workers busy."""
        return self._engine.limit()

    def renew(self):
        """Start new workers."""
        self._engine.renew()

    def close(self):
        """End the workers."""
        self._engine.close()


class _Worker:
    """State of a worker process."""

    computes = False
    ends = False


def _begin(parent):
    """
    Leave Ctrl-C to the parent; give up computing when it wants that, and end when it is gone.

    It sends a byte to each worker that is to end.
    """

    def interrupt(number, frame):
        if _Worker.ends and _Worker.computes:
            raise KeyboardInterrupt

    def watch():
        wanted = os.read(parent.fileno(), 1)
        _Worker.ends = True
        while True:
            # Once more where the exception was swallowed.
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
            time.sleep(END_WITHIN)
            if not wanted:
                # Nobody waits for the message. With a parent, sending may take its time.
                os._exit(1)

    signal.signal(signal.SIGINT, interrupt)
    threading.Thread(target=watch, daemon=True).start()


def _work(function, *arguments):
    """Compute in a worker, as long as it is wanted."""
    _Worker.computes = True
    try:
        if _Worker.ends:
            raise KeyboardInterrupt
        return function(*arguments)
    finally:
        _Worker.computes = False


class ExternalExecutor:
    """An executor that was handed in; it is not shut down."""

    def __init__(self, executor):
        """Store the executor."""
        self._executor = executor

    def submit(self, function, *arguments):
        """Hand over work."""
        return self._executor.submit(function, *arguments)

    def limit(self):
        """Return how many batches keep the workers busy."""
        workers = getattr(self._executor, '_max_workers', None) or os.cpu_count() or 1
        return 2 * workers + 2

    def renew(self):
        """Raise: an external executor cannot be restarted."""
        raise EngineError('The executor has lost its workers and takes no more work. What is '
                          'written is kept: go on with resume, and another executor.')

    def close(self):
        """Leave the executor to its owner."""


class Cluster(ExternalExecutor):
    """A cluster of Dask, by its scheduler's address, such as ``tcp://192.0.2.1:8786``."""

    def __init__(self, address):
        """Connect."""
        try:
            distributed = importlib.import_module('distributed')
        except ImportError as error:
            raise EngineError('The scheduler of a cluster needs '
                              f'{remedy("distributed", error)}') from None
        try:
            self._client = distributed.Client(
                address, set_as_default=False, timeout=SCHEDULER_PATIENCE)
        except (OSError, ValueError) as error:
            raise EngineError(f'No scheduler answers at {address}: {error}. Start one with: dask '
                              'scheduler') from None
        super().__init__(self._client.get_executor(pure=False))
        self._counted, self._limit, self._seen = -COUNT_WORKERS_EVERY, 2, time.monotonic()

    def limit(self):
        """Return how many batches keep the workers busy that are there now."""
        now = time.monotonic()
        if self._client.status == 'running':
            self._seen = now
        elif now - self._seen > SCHEDULER_PATIENCE:
            self.renew()
        if now - self._counted > COUNT_WORKERS_EVERY and self._seen == now:
            self._counted = now
            try:
                self._limit = 2 * sum(self._client.nthreads().values()) + 2
            except OSError:
                self.renew()
        return self._limit

    def renew(self):
        """Refuse to go on without the scheduler."""
        raise EngineError('The scheduler of the cluster is gone, or has cancelled the work. What '
                          'is written is kept: go on with resume when it is back.')

    def close(self):
        """Disconnect; work on its way there is dropped."""
        self._client.close()


@contextmanager
def engine_for(batches, workers=None, scheduler=None, executor=None):
    """
    Yield the executor of a sweep of at most so many batches, and close it.

    ``workers``: processes on this machine; None: as many as it has processors, where that pays;
    ``scheduler``: address of a Dask cluster; ``executor``: like ``concurrent.futures.Executor``.
    """
    engine = _engine(batches, workers, scheduler, executor)
    try:
        yield engine
    finally:
        engine.close()


def _engine(batches, workers, scheduler, executor):
    if executor is not None:
        return ExternalExecutor(executor)
    if scheduler is not None:
        return Cluster(scheduler)
    if workers is not None:
        workers = min(workers, batches)
        return ProcessExecutor(workers) if workers > 1 else SerialExecutor()
    processors = (len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity')
                  else os.cpu_count() or 1)
    return AdaptiveExecutor(batches, processors) if processors > 1 else SerialExecutor()


# Period of polling for cancellation [s].
ASK_EVERY = 0.2

# What a worker has to give up its computation [s].
END_WITHIN = 2.0


@dataclass
class Task:
    """Samples to be computed together."""

    samples: np.ndarray
    lost: int = 0  # How often their worker was lost

    @property
    def suspect(self):
        """Return whether these samples may kill workers."""
        return self.lost > 1


def dispatched(engine, call, given_up, tasks, keep_going):
    """
    Compute tasks, samples that are computed together, in any order; yield what comes of them.

    ``call`` takes samples, returns the function that computes them, and its arguments;
    ``given_up`` takes samples whose worker is lost whenever they run, even alone, and the reason,
    and returns what is yielded for them. Polled, ``keep_going`` gives the rest up where it returns
    False. EngineError where there are no workers any more.
    """
    fresh, again, running = iter(tasks), deque(), {}

    def submit(task):
        future = engine.submit(*call(task.samples))
        running[future] = task

    def hand_out():
        """Keep the workers busy; samples that may kill a worker run alone."""
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
            done, _ = wait(running, timeout=ASK_EVERY, return_when=FIRST_COMPLETED)
            broken = False
            for future in done:
                task = running.pop(future)
                broken = (yield from _result(future, task, given_up, again)) or broken
            if broken:
                # The others on their way are lost with the pool.
                wait(running, timeout=ASK_EVERY)
                for future in list(running):
                    future.cancel()
                    yield from _result(future, running.pop(future), given_up, again)
                engine.renew()
            hand_out()
    finally:
        for future in running:
            future.cancel()


def _next(fresh):
    samples = next(fresh, None)
    return None if samples is None else Task(samples)


def _result(future, task, given_up, again):
    """Yield a result, or see to a lost task; return whether all other work is lost, too."""
    try:
        found = future.result(0)
    except (CancelledError, OSError):
        # The connection to the engine, or the time to wait for a pool that is lost: nothing that
        # counts against these samples.
        again.append(task)
        return True
    except Exception as error:
        yield from _lost(task, error, given_up, again)
        return isinstance(error, BrokenExecutor)
    yield found
    return False


def _lost(task, error, given_up, again):
    """Put a task back, sample by sample the second time; give it up the third."""
    lost = task.lost + 1
    if task.suspect:
        reason = str(error) or type(error).__name__
        yield given_up(
            task.samples, f'the worker that ran it was lost, each time: {reason}')
    elif lost == 1:
        again.append(Task(task.samples, lost))
    else:
        again.extend(Task(np.array([sample]), lost) for sample in task.samples)
