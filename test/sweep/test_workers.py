# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Workers killed in the middle of a sweep: no sample lost, none doubled, the same numbers."""

import multiprocessing
from multiprocessing.connection import Connection
import os
import signal
from test.sweep.files import assert_same, read
import threading
import time

from closedloop_dynamics.sweep import executors, storage, sweep
from closedloop_dynamics.sweep.executors import EngineError
import numpy as np
import pytest

pytest.importorskip('netCDF4')

VARY = {'mechanism.bodies.crank.mass': 'uniform:1:2', 'torque.crank_joint': [0.0, 0.5, -900.0]}
OPTIONS = {'samples': 12, 'duration': 0.3}


@pytest.fixture
def written(monkeypatch):
    """Return the samples that are written, as they are."""
    samples = []
    write = storage.Storage.write

    def noted(self, batch):
        samples.extend(batch.samples.tolist())
        write(self, batch)

    monkeypatch.setattr(storage.Storage, 'write', noted)
    return samples


def assert_complete(path, written):
    """Check that every sample was written once, and is what one process makes of it."""
    assert sorted(written) == list(range(36))
    alone = path.with_name('alone.nc')
    sweep('four_bar', VARY, alone, **OPTIONS, workers=1)
    assert_same(read(path), read(alone))
    assert np.isfinite(read(path)['final_position'][:24]).all()


def test_workers_end_in_the_middle_of_sending():
    for delay in np.linspace(0.0, 0.04, 9):
        before = set(threading.enumerate())
        processes = executors.ProcessExecutor(2)
        first = processes.submit(np.zeros, 1000)
        for _ in range(3):
            processes.submit(np.zeros, 4_000_000)
        first.result(300)
        time.sleep(delay)  # There is no telling from outside when a worker sends.
        closing = threading.Thread(target=processes.close, daemon=True)
        closing.start()
        for thread in [closing, *set(threading.enumerate()) - before]:
            thread.join(300)
            assert not thread.is_alive()


def test_workers_end_however_long_sending_takes(monkeypatch):
    receive, begun = Connection._recv, threading.Event()

    def slowly(self, size, *more):
        if size > 1_000_000:
            begun.set()
            time.sleep(1.5 * executors.END_WITHIN)
        return receive(self, size, *more)

    monkeypatch.setattr(Connection, '_recv', slowly)
    processes = executors.ProcessExecutor(1)
    processes.submit(np.zeros, 4_000_000)
    assert begun.wait(300)
    closing = threading.Thread(target=processes.close, daemon=True)
    closing.start()
    closing.join(300)
    assert not closing.is_alive()


def test_a_killed_process_loses_no_sample(tmp_path, written):
    before = set(multiprocessing.active_children())
    killed = []

    def kill_one(outcome):
        if outcome.done >= 6 and not killed:
            worker = (set(multiprocessing.active_children()) - before).pop()
            os.kill(worker.pid, signal.SIGKILL)
            killed.append(worker)

    path = tmp_path / 'results.nc'
    outcome = sweep('four_bar', VARY, path, **OPTIONS, workers=2, on_progress=kill_one)
    assert killed and outcome.finished
    assert_complete(path, written)
    assert not set(multiprocessing.active_children()) - before


def test_workers_are_started_only_where_they_pay(tmp_path, written, monkeypatch):
    started = []
    make = executors.ProcessExecutor

    def noted(workers):
        started.append(workers)
        return make(1)

    monkeypatch.setattr(executors, 'ProcessExecutor', noted)
    monkeypatch.setattr(os, 'sched_getaffinity', lambda pid: range(8))
    monkeypatch.setattr(executors, 'WORTH', 1e6)
    monkeypatch.setattr(executors, 'WORTH_AT_ONCE', 1e6)
    sweep('four_bar', VARY, tmp_path / 'few.nc', **OPTIONS)
    assert not started
    written.clear()
    monkeypatch.setattr(executors, 'WORTH', 0.0)
    path = tmp_path / 'results.nc'
    sweep('four_bar', VARY, path, **OPTIONS)
    assert started == [8]
    assert_complete(path, written)


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_loses_no_sample(tmp_path, written):
    distributed = pytest.importorskip('distributed')
    path = tmp_path / 'results.nc'
    killed = []
    with distributed.LocalCluster(
            n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None,
            silence_logs=50) as cluster:
        with distributed.Client(cluster, set_as_default=False) as client:
            workers = client.run(os.getpid)

        def kill_one(outcome):
            if outcome.done >= 6 and not killed:
                killed.append(next(iter(workers.values())))
                os.kill(killed[0], signal.SIGKILL)

        outcome = sweep('four_bar', VARY, path, **OPTIONS, on_progress=kill_one,
                        scheduler=cluster.scheduler_address)
    assert killed and outcome.finished
    assert_complete(path, written)


@pytest.mark.slow
def test_a_scheduler_that_is_gone_leaves_what_was_done(tmp_path, written):
    distributed = pytest.importorskip('distributed')
    path = tmp_path / 'results.nc'
    with distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None,
            silence_logs=50) as cluster:

        def end(outcome):
            if outcome.done == 4:
                cluster.close()

        with pytest.raises(EngineError, match='scheduler'):
            sweep('four_bar', VARY, path, **OPTIONS, scheduler=cluster.scheduler_address,
                  on_progress=end)
    assert 4 <= len(written) < 36
    again = sweep('four_bar', VARY, path, **OPTIONS, workers=1, resume=True)
    assert again.done < 36 and again.finished
    assert_complete(path, written)
