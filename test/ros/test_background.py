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

"""Tests of closedloop_dynamics.ros.background and integration.precompile."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from closedloop_dynamics import Simulation
from closedloop_dynamics.core import rank_revealing
from closedloop_dynamics.core.codegen import function_table as calls
from closedloop_dynamics.integration import precompile
from closedloop_dynamics.ros import background
import pytest

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 60.0


def wait(condition, what):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f'no {what}'
        time.sleep(0.02)


def is_alive(number):
    """Return whether a process runs: not ended, and not waiting for its parent to notice."""
    try:
        return Path(f'/proc/{number}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except FileNotFoundError:
        return False


@pytest.fixture
def build(monkeypatch):
    """Return a function that builds a preparation whose process runs some code, and its log."""
    def make(code, stored=False):
        loaded, said = [], []
        monkeypatch.setattr(precompile, 'is_stored', lambda system: stored)
        monkeypatch.setattr(precompile, 'preparations', lambda system: [
            lambda: loaded.append('first'), lambda: loaded.append('second')])
        monkeypatch.setattr(background, 'COMMAND', (sys.executable, '-c', code))
        monkeypatch.setattr(background, 'DELAY', 0.0)
        logger = type('', (), {'info': said.append, 'warning': said.append})
        return background.Preparation('four_bar', None, logger), loaded, said
    return make


def test_what_is_on_disk_is_loaded_at_once_and_nothing_is_said(build):
    prepared, loaded, said = build('', stored=True)
    assert sorted(loaded) == ['first', 'second']
    prepared.look()
    assert prepared.over and prepared._process is None
    assert said == []


def test_what_is_not_is_compiled_by_a_process_and_loaded_then(build):
    prepared, loaded, said = build(
        'import sys; sys.exit(sys.argv[1:3] != ["compile", "four_bar"])')
    assert (loaded, prepared._process) == ([], None)
    prepared.look()
    prepared._process.wait()
    for k in range(3):
        assert len(loaded) == k
        prepared.look()
    assert prepared.over
    assert [line.split(':')[0].split(' (')[0] for line in said] == [
        'compiling the code for singular configurations in the background',
        'singular configurations']


def test_process_that_fails_is_told(build):
    prepared, loaded, said = build('raise SystemExit(3)')
    prepared.look()
    prepared._process.wait()
    prepared.look()
    assert 'exit code 3' in said[-1]
    assert (loaded, prepared.over) == ([], True)


def test_process_ends_with_the_node(build):
    prepared, loaded, _ = build('import time; time.sleep(600)')
    prepared.look()
    prepared.look()
    process = prepared._process
    assert process.poll() is None
    prepared.close()
    assert process.poll() == -signal.SIGKILL
    assert loaded == []


def test_process_ends_with_a_parent_that_was_killed(tmp_path):
    child = ('import os, sys, time; from closedloop_dynamics.ros.background import die_with; '
             'die_with(int(sys.argv[1])); print(os.getpid(), flush=True); time.sleep(600)')
    parent = subprocess.Popen(
        [sys.executable, '-c', 'import os, subprocess, sys; subprocess.run('
         f'[sys.executable, "-c", {child!r}, str(os.getpid())])'],
        stdout=subprocess.PIPE, text=True, cwd=ROOT)
    number = int(parent.stdout.readline())
    assert is_alive(number)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    wait(lambda: not is_alive(number), 'end of the orphan')


def test_kernels_that_were_prepared_are_those_that_are_called():
    simulation = Simulation.from_scene('three_rrr')
    system = simulation.system
    for get_ready in precompile.preparations(system):
        get_ready()
    assert precompile.is_stored(system)
    kernels = (rank_revealing.accelerate, rank_revealing.correct)
    before = [len(kernel.overloads) for kernel in kernels]
    for which in (calls.RANK_REVEALING_ACCELERATION, calls.RANK_REVEALING_POSITION,
                  calls.RANK_REVEALING_VELOCITY):
        calls.run(system.table, which, simulation.position, simulation.velocity)
    assert [len(kernel.overloads) for kernel in kernels] == before


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_new_installation_gets_it_ready_in_the_background(processes, tmp_path):
    processes.environment['NUMBA_CACHE_DIR'] = str(tmp_path / 'cold')

    def children(process):
        number = process.popen.pid
        return Path(f'/proc/{number}/task/{number}/children').read_text().split()

    killed = processes.start('closedloop_simulator', scene='carpet_scraper_on_carpet')
    killed.wait_for('compiling in the background', patience=300.0)
    child, = children(killed)
    killed.send(signal.SIGKILL)
    killed.wait()
    wait(lambda: not is_alive(child), 'end of the orphan')
    first = processes.start('closedloop_simulator', scene='carpet_scraper_on_carpet')
    first.wait_for('compiling in the background', patience=300.0)
    first.wait_for('singular configurations: ready', patience=600.0)
    assert first.stop() == 0
    second = processes.start('closedloop_simulator', scene='carpet_scraper_on_carpet')
    second.wait_until_ready()
    time.sleep(background.DELAY + 2.0)
    assert children(second) == []
    assert second.stop() == 0
    assert 'background' not in second.output


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_disk_is_known_to_hold_it_or_not(tmp_path):
    code = ('from closedloop_dynamics import Simulation; '
            'from closedloop_dynamics.integration import precompile; '
            'print(precompile.is_stored(Simulation.from_scene("three_rrr").system))')
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'cold')}

    def tell():
        return subprocess.run([sys.executable, '-c', code], cwd=ROOT, env=environment, text=True,
                              check=True, stdout=subprocess.PIPE).stdout.strip()

    assert tell() == 'False'
    subprocess.run(
        [sys.executable, '-c', 'import os, subprocess, sys; sys.exit(subprocess.call(['
         'sys.executable, "-m", "closedloop_dynamics.ros.background", "compile", "three_rrr", '
         'str(os.getpid())]))'],
        cwd=ROOT, env=environment, check=True)
    assert tell() == 'True'
