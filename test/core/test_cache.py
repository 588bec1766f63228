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
"""Tests of closedloop_dynamics.core.cache: what stored code depends on."""

import gc
import os
from pathlib import Path
import time

from closedloop_dynamics.core import cache
from closedloop_dynamics.core.codegen import available
from closedloop_dynamics.core.compiled import compiled
import grimp
import numba
from numba.core import event
import pytest


@pytest.fixture
def package(tmp_path, monkeypatch):
    for name in ('core/kernel.py', 'effects/law.py', 'integration/step.py', 'cli/command.py'):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text('VALUE = 1\n')
    monkeypatch.setattr(cache, 'PACKAGE', tmp_path)
    return tmp_path


@pytest.mark.parametrize('name, depends', [
    ('core/kernel.py', True), ('effects/law.py', True), ('integration/step.py', True),
    ('cli/command.py', False)])
def test_edits_of_compiled_sources_lead_to_another_directory(package, name, depends):
    before = cache._sources()
    (package / name).write_text('VALUE = 2\n')
    assert (cache._sources() != before) == depends


def test_compiled_functions_elsewhere_are_called_by_no_others():
    name = cache.PACKAGE.name
    graph = grimp.build_graph(name, cache_dir=None)
    compiled = graph.find_modules_that_directly_import(f'{name}.core.compiled')
    elsewhere = {module for module in compiled
                 if module.split('.')[1] not in cache.COMPILED_FOLDERS}
    assert len(compiled) > 20
    for module in compiled:
        assert not graph.find_modules_directly_imported_by(module) & elsewhere, module


def test_code_that_nobody_used_for_long_is_removed(tmp_path):
    for name, age in (('old', 2.0 * cache.UNUSED), ('new', 0.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'kernel.nbc').write_text('code')
        os.utime(tmp_path / name, 2 * (time.time() - age,))
    cache._remove_unused(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ['new']


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setattr(cache.numba.config, 'CACHE_DIR', '')
    monkeypatch.setenv('HOME', str(tmp_path))
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
    ({'XDG_CACHE_HOME': '{home}/xdg'}, 'xdg'), ({'XDG_CACHE_HOME': ''}, '.cache')])
def test_code_is_kept_where_users_keep_caches(home, monkeypatch, environment, place):
    for name, value in environment.items():
        monkeypatch.setenv(name, value.format(home=home))
    found = cache.directory.__wrapped__()
    assert found.parent == home / place / Path(cache.__file__).parents[1].name
    assert found.is_dir()


@compiled
def multiplied(number, factor):
    return number * factor


@compiled
def multiplied_twice(number):
    return multiplied(number, 2) * multiplied(number, 3)


@pytest.mark.skipif(not available(), reason='nothing is compiled')
def test_nothing_is_compiled_anew_for_another_constant():
    assert multiplied_twice(5.0) == 150.0
    # None where it comes from the disk.
    assert len(multiplied.overloads) <= 1


@pytest.fixture
def thresholds():
    before = gc.get_threshold()
    gc.set_threshold(700, 9, 8)
    yield gc.get_threshold()
    gc.set_threshold(*before)


@pytest.mark.skipif(not available(), reason='nothing is compiled')
def test_garbage_is_looked_for_as_before_after_code_was_compiled(thresholds):
    during = []
    # Neither comes from the disk.
    good, bad = numba.njit(lambda x: x + 1), numba.njit(lambda x: x + 'one')

    class Listener(event.Listener):

        def on_start(self, _):
            during.append(gc.get_threshold())

        def on_end(self, _):
            pass

    with event.install_listener('numba:compile', Listener()):
        assert good(1) == 2
        with pytest.raises(numba.TypingError):
            bad(1)
    assert len(during) >= 2 and all(objects > 10000 for objects, *_ in during)
    assert gc.get_threshold() == thresholds
