# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Long computations: Ctrl-C ends them at once, and other threads go on meanwhile."""

import json
import os
from pathlib import Path
import subprocess
import sys
import threading

from closedloop_dynamics.engine import native
from closedloop_dynamics.engine.stop_flag import StopFlag
from closedloop_dynamics.simulation import rollout
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
# It would take hours.
ENDLESS = 1_000_000_000
# How much CPU time may pass between the signal and the exception, on a slow machine, too [s]: the
# computations themselves would take hours.
HEARD = 2.0
# One thread does what takes long; another sends the signal when the first is within the engine:
# its Python code stands still although the other has the lock of the interpreter again and again.
CHILD = """
import json, os, signal, sys, threading, time
# A shell starts what runs in the background with this signal ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
import numpy as np
from closedloop_dynamics.simulation.model import Model
from closedloop_dynamics.simulation.simulation import Simulation

scene, method, action = json.loads(sys.argv[1])
simulation = Simulation.from_scene(scene, **method)
na, main, sent = len(simulation.actuated_joints), threading.main_thread().ident, []


def place():
    # Nowhere while generated code is compiled.
    frame = top = sys._current_frames()[main]
    while frame is not None:
        if 'llvmlite' in frame.f_code.co_filename:
            return None
        frame = frame.f_back
    return top.f_code.co_name, top.f_lasti


def interrupt():
    # For a tenth of a second of this process's own time, whatever else the machine does.
    seen, since = None, time.process_time()
    while seen is None or time.process_time() < since + 0.1:
        time.sleep(0.01)
        here = place()
        if here != seen:
            seen, since = here, time.process_time()
    sent.append(time.process_time())
    os.kill(os.getpid(), signal.SIGINT)
    while time.process_time() < sent[0] + 10.0:
        time.sleep(0.005)
    print(json.dumps({'within': seen[0], 'unheard': True}), flush=True)
    os._exit(1)


threading.Thread(target=interrupt, daemon=True).start()
try:
    if action == 'step':
        simulation.step(duration=1e6)
    elif action == 'assemble':
        model = Model(simulation.scene)
        model.assemble(np.tile(model.assemble().q + 1e-3, (1_000_000, 1)))
    else:
        simulation.rollout(np.zeros((action['samples'], 1, na)), steps=action['steps'],
                           every=action['steps'], threads=action['threads'])
except KeyboardInterrupt:
    took = time.process_time() - sent[0]
# Position and time belong together: as if nobody had interrupted.
again = Simulation.from_scene(scene, **method)
whole = min(simulation.time, 2.0)
if 0.0 < simulation.time <= 2.0:
    again.step(duration=simulation.time)
error = float(np.abs(simulation.position - again.position).max()) if whole < 2.0 else 0.0
# It goes on.
simulation.step(duration=0.01)
print(json.dumps({'took': took, 'time': simulation.time, 'error': error}), flush=True)
os._exit(0)
"""


def interrupted(scene, method, action):
    """Return what a process says that was interrupted while it did something."""
    done = subprocess.run(
        [sys.executable, '-c', CHILD, json.dumps([scene, method, action])], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=500, check=False,
        env={**os.environ, 'PYTHONPATH': str(ROOT)})
    assert done.stdout, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    assert done.returncode == 0, (said, done.stderr)
    return said


@pytest.mark.parametrize('scene, integrator', [
    ('three_rrr', 'auto'),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('three_rrr', 'rodas4_fixed'), ('stewart_platform', 'rk4'), ('three_rrr', 'rk4'),
        ('three_rrr', 'dop853'), ('three_rrr', 'rodas4'),
        ('carpet_scraper_on_carpet', 'auto')))])
def test_an_interrupt_ends_a_long_step(scene, integrator):
    said = interrupted(scene, {'integrator': integrator, 'step_size': 1e-4}, 'step')
    assert said['took'] < HEARD and said['error'] < 1e-6 and said['time'] >= 0.01


def test_an_interrupt_ends_a_long_assembly_of_many_states():
    assert interrupted('three_rrr', {}, 'assemble')['took'] < HEARD


@pytest.mark.parametrize('integrator, samples, threads', [
    ('rk4', 8, 1), ('auto', 2, 2), *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('rk4', 1, 1), ('rk4', 24, 2), ('rodas4_fixed', 2, 2), ('auto', 1, 1)))])
def test_an_interrupt_ends_a_long_rollout(integrator, samples, threads):
    said = interrupted('three_rrr', {'integrator': integrator, 'step_size': 1e-4},
                       {'samples': samples, 'steps': 5_000_000, 'threads': threads})
    assert said['took'] < HEARD and said['error'] == 0.0


def test_two_rollouts_in_two_threads_run_at_once():
    long, short = (Simulation.from_scene('three_rrr', integrator='rk4') for _ in range(2))
    torques = np.zeros((1, 3))
    alone = short.rollout(torques, steps=50).position
    short.reset()
    inside, results = threading.Event(), {}

    def run():
        inside.set()
        results['long'] = long.rollout(torques, steps=200_000, every=200_000)

    thread = threading.Thread(target=run)
    thread.start()
    inside.wait()
    # Each of these needs the lock of the interpreter, which the long one would keep to its end.
    found = [short.rollout(torques, steps=50).position for _ in range(3)]
    was_over = not thread.is_alive()
    thread.join()
    assert not was_over and results['long'].failures == {}
    for position in found:
        np.testing.assert_array_equal(position, alone)


def test_results_do_not_depend_on_threads():
    simulation = Simulation.from_scene('carpet_scraper', integrator='auto')
    torques = np.random.default_rng(1).normal(size=(6, 1, 1))
    one, more = (simulation.rollout(torques, duration=0.05, threads=threads).position
                 for threads in (1, 3))
    np.testing.assert_array_equal(one, more)


def test_a_stop_reaches_those_that_heed_it_alone():
    simulation, other = (Simulation.from_scene('three_rrr', integrator='rk4') for _ in range(2))
    tau, stop = simulation.joint_torques(None), StopFlag()
    stop.set()
    with stop:
        with pytest.raises(KeyboardInterrupt):
            simulation.advance(tau, ENDLESS)
        # The threads that a rollout starts stop as the thread does that started them.
        with pytest.raises(KeyboardInterrupt):
            simulation.rollout(np.zeros((8, 1, 3)), steps=ENDLESS, every=ENDLESS, threads=2)
        # So does what a run does within another one that may be stopped.
        with StopFlag(), pytest.raises(KeyboardInterrupt):
            simulation.advance(tau, ENDLESS)
    # Long enough to ask several times.
    assert not other.rollout(np.zeros((8, 1, 3)), steps=40_000, every=40_000, threads=2).failures
    simulation.advance(tau, 40_000)
    stop.clear()
    with stop:
        simulation.advance(tau, 100)


def test_a_rollout_that_fails_ends_no_work_of_other_threads(monkeypatch):
    failing, other = (Simulation.from_scene('three_rrr', integrator='rk4') for _ in range(2))
    tau, failed, over, ends = other.joint_torques(None), threading.Event(), threading.Event(), []
    first = threading.Lock()

    class Runs:
        """In the place of runs in the lanes of a vector."""

        def record_alike(self, *_):
            if first.acquire(blocking=False):
                failed.set()
            else:
                # The rollout has not ended before the work beside it has.
                assert over.wait(500)
            # Whichever of them is asked for its results first.
            raise RuntimeError('a fault of a sample')

    def work():
        assert failed.wait(500)
        try:
            other.advance(tau, 40_000)
            ends.append('all steps')
        except KeyboardInterrupt:
            ends.append('stopped')
        over.set()

    monkeypatch.setattr(rollout, 'SimdRuns', Runs)
    thread = threading.Thread(target=work)
    thread.start()
    with pytest.raises(RuntimeError, match='a fault of a sample'):
        failing.rollout(np.zeros((256, 1, 3)), steps=100, threads=2)
    thread.join()
    assert ends == ['all steps']


@pytest.mark.parametrize('arguments', [(None, 1), (1.0, 1), ('flag', 2), ('flag', 0.5)])
def test_a_stop_that_is_none_is_refused(arguments):
    flag, stops = arguments
    with pytest.raises((ValueError, TypeError)):
        native.StopFlag.set_stop(native.stop_flag(0) if flag == 'flag' else flag, stops)
