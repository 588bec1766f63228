# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Attack: damaged, foreign and unwritable stores of generated code; processes that race."""

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import random
import resource
import subprocess
import sys

from closedloop_dynamics.codegen import cache, machine_code as in_memory
from closedloop_dynamics.codegen.expression_graph import ExpressionGraph, LOAD, Q, QD, Routine
from closedloop_dynamics.codegen.machine_code import machine_code, SCALAR
import pytest

ROOT = Path(__file__).resolve().parents[2]
DAMAGES = 300
RUN = """\
from closedloop_dynamics.simulation.simulation import Simulation
simulation = Simulation.from_scene('four_bar', integrator='rk4')
simulation.step(duration=0.01)
print(simulation.position.tobytes().hex())
"""


def damaged(content, rng):
    """Return a name for what happened to a file, and what it holds now."""
    kind = rng.choice(['emptied', 'cut', 'flipped', 'overwritten', 'extended', 'swapped'])
    place = rng.randrange(len(content))
    if kind == 'emptied':
        return kind, b''
    if kind == 'cut':
        return kind, content[:place]
    if kind == 'flipped':
        return kind, (content[:place] + bytes([content[place] ^ 1 << rng.randrange(8)])
                      + content[place + 1:])
    if kind == 'overwritten':
        return kind, (content[:place] + rng.randbytes(64))[:len(content)] + content[place + 64:]
    if kind == 'extended':
        return kind, content + b'\0'
    return kind, content[32:] + content[:32]


@pytest.fixture
def directory(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, 'directory', lambda: tmp_path)
    return tmp_path


@pytest.fixture
def forgetful(monkeypatch):
    """Return a function that makes this process forget what code it has, as a new one would."""
    def forget():
        monkeypatch.setattr(in_memory, 'engines', {})
    forget()
    return forget


def halves():
    """Return a routine that halves a number."""
    graph = ExpressionGraph()
    return [Routine('half', graph, [(QD, 0, graph.put(LOAD, Q, 0) * 0.5)])]


def test_no_damaged_file_is_ever_loaded(directory, forgetful):
    machine_code(('attack', 1), halves, SCALAR)
    stored, = directory.iterdir()
    content, rng, counts = stored.read_bytes(), random.Random(1), {}
    assert cache.read(stored.name) == content[32:]
    for _ in range(DAMAGES):
        kind, data = damaged(content, rng)
        stored.write_bytes(data)
        assert cache.read(stored.name) is None, kind
        counts[kind] = counts.get(kind, 0) + 1
    assert sum(counts.values()) == DAMAGES and len(counts) == 6
    assert list(directory.iterdir()) == [stored]


def test_damaged_code_is_generated_again_and_replaced(directory, forgetful):
    made = []

    def counted():
        made.append(True)
        return halves()

    machine_code(('attack', 1), counted, SCALAR)
    stored, = directory.iterdir()
    content = stored.read_bytes()
    stored.write_bytes(content[:-1])
    for count in (2, 2):
        forgetful()
        machine_code(('attack', 1), counted, SCALAR)
        assert len(made) == count
        assert stored.read_bytes() == content


def start(directory, **options):
    """Return a process that simulates with a store of its own."""
    return subprocess.Popen(
        [sys.executable, '-c', RUN], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, 'PYTHONPATH': str(ROOT),
             'CLOSEDLOOP_CACHE_DIR': str(directory / 'cache')}, **options)


def result(process):
    """Return what a process computed; it must not complain."""
    found, complaints = process.communicate(timeout=300)
    assert process.returncode == 0 and complaints == '', complaints
    return found


def files(directory):
    """Return the stored files by name."""
    return {path.name: path for path in (directory / 'cache').rglob('*') if path.is_file()}


def test_processes_find_stored_code_and_repair_what_is_damaged(tmp_path):
    expected = result(start(tmp_path))
    stored = files(tmp_path)
    contents = {name: path.read_bytes() for name, path in stored.items()}
    assert stored
    for path in stored.values():
        path.write_bytes(path.read_bytes()[:-1])
    assert result(start(tmp_path)) == expected
    assert {name: path.read_bytes() for name, path in files(tmp_path).items()} == contents


def test_two_processes_that_race_find_the_same_and_leave_whole_files(tmp_path):
    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(result, [start(tmp_path) for _ in range(2)])
    assert one == other
    stored = files(tmp_path)
    assert stored
    for path in stored.values():
        content = path.read_bytes()
        assert cache.checksum(path.name, content[32:]) == content[:32], path.name
    assert result(start(tmp_path)) == one
    assert files(tmp_path) == stored


def test_full_disk_leaves_a_result_and_no_temporary_file(tmp_path):
    def fill():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    assert result(start(tmp_path, preexec_fn=fill)) == result(start(tmp_path))
    for path in files(tmp_path).values():
        content = path.read_bytes()
        assert cache.checksum(path.name, content[32:]) == content[:32], path.name


def test_no_directory_to_write_to_is_no_error(tmp_path):
    (tmp_path / 'cache').write_text('a file')
    (tmp_path / 'other').mkdir()
    assert result(start(tmp_path)) == result(start(tmp_path / 'other'))
