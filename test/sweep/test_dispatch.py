# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Batches are handed out so that no sample is lost and none doubled, whatever workers do."""

from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from functools import partial

from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.sweep.batch import failed, Job, SAMPLE_DONE, SAMPLE_FAILED
from closedloop_dynamics.sweep.executors import (
    dispatched, EngineError, ExternalExecutor, SerialExecutor)
from closedloop_dynamics.sweep.plan import Grid, Plan
from closedloop_dynamics.sweep.runner import calls
import numpy as np
import pytest

PLAN = Plan(load_scene('four_bar'), (Grid('mechanism.bodies.crank.mass', tuple(range(1, 21))),),
            duration=0.01)
JOB = Job(PLAN.scene, PLAN.paths, PLAN.schedule, PLAN.keep)
TASKS = np.split(np.arange(20), [3, 6, 9, 12, 15, 18])


class Lossy(SerialExecutor):
    """An engine whose workers die of some samples; all that is on its way dies with them."""

    def __init__(self, deadly=(), first_loss=None, error=BrokenExecutor):
        self.deadly, self.first_loss, self.error = set(deadly), first_loss, error
        self.waiting, self.calls, self.renewals, self.ran = [], 0, 0, []

    def limit(self):
        return 3

    def submit(self, function, job, samples, *rest):
        self.calls += 1
        future = Future()
        self.waiting.append((future, function, (job, samples, *rest)))
        if len(self.waiting) == self.limit() or self.deadly & set(samples.tolist()):
            self._work()
        return future

    def _work(self):
        waiting, self.waiting = self.waiting, []
        lost = self.calls == self.first_loss or any(
            self.deadly & set(arguments[1].tolist()) for _, _, arguments in waiting)
        for future, function, arguments in waiting:
            if lost:
                future.set_exception(self.error('a worker is gone'))
            else:
                self.ran += arguments[1].tolist()
                future.set_result(function(*arguments))

    def renew(self):
        self.renewals += 1


def run(engine):
    """Return the samples that came back, and their status, in the order of samples."""
    batches = list(dispatched(engine, calls(JOB, PLAN), partial(failed, JOB), iter(TASKS),
                              keep_going(engine)))
    samples = np.concatenate([batch.samples for batch in batches])
    status = np.concatenate([batch.status for batch in batches])
    return np.sort(samples), status[np.argsort(samples)], batches


def keep_going(engine):
    def asked():
        # Whatever still waits to be computed together is computed now.
        if getattr(engine, 'waiting', None):
            engine._work()
        return True
    return asked


def test_all_samples_come_back_once():
    samples, status, _ = run(SerialExecutor())
    np.testing.assert_array_equal(samples, np.arange(20))
    assert (status == SAMPLE_DONE).all()


def test_what_was_on_its_way_when_workers_were_lost_is_done_again():
    engine = Lossy(first_loss=3)
    samples, status, _ = run(engine)
    np.testing.assert_array_equal(samples, np.arange(20))
    assert (status == SAMPLE_DONE).all() and engine.renewals == 1
    assert sorted(engine.ran) == list(range(20))


def test_only_the_sample_that_kills_its_worker_fails():
    engine = Lossy(deadly=[7])
    samples, status, batches = run(engine)
    np.testing.assert_array_equal(samples, np.arange(20))
    assert np.flatnonzero(status == SAMPLE_FAILED).tolist() == [7]
    reason = next(batch.reasons[0] for batch in batches if 7 in batch.samples)
    assert 'lost, each time' in reason


def test_an_engine_that_reports_each_loss_alone_is_served_the_same():
    samples, status, _ = run(Lossy(deadly=[7, 8], error=RuntimeError))
    np.testing.assert_array_equal(samples, np.arange(20))
    assert np.flatnonzero(status == SAMPLE_FAILED).tolist() == [7, 8]


def test_a_handed_in_executor_computes_the_same():
    alone = run(SerialExecutor())[2]
    with ThreadPoolExecutor(2) as executor:
        samples, _, batches = run(ExternalExecutor(executor))
        assert executor.submit(int).result() == 0
    np.testing.assert_array_equal(samples, np.arange(20))
    expected = {int(b.samples[0]): b for b in alone}
    for batch in batches:
        for name, values in batch.values.items():
            np.testing.assert_array_equal(values, expected[int(batch.samples[0])].values[name])


def test_a_broken_executor_ends_the_sweep_with_a_word():
    class Broken(ThreadPoolExecutor):

        def submit(self, *arguments):
            future = Future()
            future.set_exception(BrokenExecutor('gone'))
            return future

    with Broken(1) as executor, pytest.raises(EngineError, match='resume'):
        run(ExternalExecutor(executor))
