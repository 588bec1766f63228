# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Where generated code is kept, for how long, and what makes it another."""

import os
from pathlib import Path
import time

from closedloop_dynamics import Differentiator, Simulation
from closedloop_dynamics.codegen import cache, machine_code
import numpy as np
import pytest


@pytest.fixture
def package(tmp_path, monkeypatch):
    for name in ('engine/kernel.py', 'codegen/routine.py', 'effects/law.py',
                 'integration/step.py', 'cli/command.py'):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text('VALUE = 1\n')
    monkeypatch.setattr(cache, 'PACKAGE', tmp_path)
    return tmp_path


@pytest.mark.parametrize('name, depends', [
    ('engine/kernel.py', True), ('codegen/routine.py', True), ('effects/law.py', True),
    ('integration/step.py', False), ('cli/command.py', False)])
def test_edits_of_what_generates_code_lead_to_another_directory(package, name, depends):
    before = cache.sources_digest()
    (package / name).write_text('VALUE = 2\n')
    assert (cache.sources_digest() != before) == depends


def test_code_that_nobody_used_for_long_is_removed(tmp_path):
    for name, age in (('old', 2.0 * cache.UNUSED), ('new', 0.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'routines').write_text('code')
        os.utime(tmp_path / name, 2 * (time.time() - age,))
    cache.remove_unused(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ['new']


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    monkeypatch.setenv('CLOSEDLOOP_CACHE_DIR', '')
    monkeypatch.setenv('XDG_CACHE_HOME', '')
    return tmp_path


def test_processes_that_start_together_share_the_directory(home, monkeypatch):
    found = cache.directory.__wrapped__()
    # One looked before another made the directory, and lists what another then removes.
    answers = iter([False])
    monkeypatch.setattr(Path, 'is_dir', lambda path: path != found or next(answers, True))
    monkeypatch.setattr(Path, 'iterdir', lambda path: iter([path / 'removed']))
    assert cache.directory.__wrapped__() == found


@pytest.mark.parametrize('environment, place', [
    ({'CLOSEDLOOP_CACHE_DIR': '{home}/own', 'XDG_CACHE_HOME': '{home}/xdg'}, 'own'),
    ({'CLOSEDLOOP_CACHE_DIR': '~/own'}, 'own'), ({'XDG_CACHE_HOME': '{home}/xdg'}, 'xdg'),
    ({}, '.cache')])
def test_code_is_kept_where_users_keep_caches(home, monkeypatch, environment, place):
    for name, value in environment.items():
        monkeypatch.setenv(name, value.format(home=home))
    found = cache.directory.__wrapped__()
    assert found.parent == home / place / Path(cache.__file__).parents[1].name
    assert found.is_dir()


def test_where_there_is_no_place_nothing_is_kept_and_nothing_fails(home, monkeypatch):
    (home / 'file').write_text('')
    monkeypatch.setenv('CLOSEDLOOP_CACHE_DIR', str(home / 'file'))
    assert cache.directory.__wrapped__() is None
    monkeypatch.setattr(cache, 'directory', lambda: None)
    cache.write('code', b'code')
    assert cache.read('code') is None


def test_two_that_write_the_same_at_once_leave_one_whole_file(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, 'directory', lambda: tmp_path)
    replace, written = Path.replace, []

    def late(path, target):
        # Another process writes its code after this one wrote its own, before it is in place.
        if not written:
            written.append(path)
            cache.write('code', b'of the other')
            assert cache.read('code') == b'of the other'
        return replace(path, target)

    monkeypatch.setattr(Path, 'replace', late)
    cache.write('code', b'of this one')
    assert cache.read('code') == b'of this one'
    assert [path.name for path in tmp_path.iterdir()] == ['code']


def test_files_that_have_each_others_names_are_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, 'directory', lambda: tmp_path)
    for name in ('one', 'other'):
        cache.write(name, f'code of {name}'.encode())
    for name, target in (('one', 'spare'), ('other', 'one'), ('spare', 'other')):
        (tmp_path / name).replace(tmp_path / target)
    assert cache.read('one') is None and cache.read('other') is None


def test_code_is_in_memory_once_however_many_ask_for_it():
    simulation = Simulation.from_scene('four_bar')
    Differentiator(simulation)
    before = set(machine_code.engines)
    derivatives = [Differentiator(Simulation.from_scene('four_bar')) for _ in range(3)]
    assert set(machine_code.engines) == before
    state = simulation.position, simulation.velocity
    for one in derivatives:
        assert np.isfinite(one(*state).by_position).all()
