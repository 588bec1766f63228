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
"""Attack on stored compiled code: whatever becomes of the files, results stay right."""

import os
from pathlib import Path
import random
import resource
import subprocess
import sys
import warnings

from closedloop_dynamics.core import cache, compiled
import numba
import pytest

ROOT = Path(__file__).resolve().parents[2]
DAMAGES = 300
KERNELS = """\
from closedloop_dynamics.core.compiled import compiled

@compiled
def _square(x):
    return x * x

@compiled
def total(x):
    return _square(x) + 1.0

if __name__ == '__main__':
    print(total(3.0))
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
    monkeypatch.setattr(cache, '_said', set())
    return tmp_path


def cube(x):
    return x * x * x


def test_no_damaged_file_is_ever_loaded(directory):
    kernel, rng = compiled.compiled(cube), random.Random(1)
    assert kernel(2.0) == 8.0
    stored, = directory.iterdir()
    content, signature = stored.read_bytes(), (numba.float64,)
    counts = {}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter('always')
        for _ in range(DAMAGES):
            kind, data = damaged(content, rng)
            stored.write_bytes(data)
            assert kernel._cache.load_overload(signature, kernel.targetctx) is None, kind
            assert [path.name for path in directory.iterdir()] == [f'{stored.name}.damaged']
            counts[kind] = counts.get(kind, 0) + 1
    assert len(told) == 1 and str(stored) in str(told[0].message)
    print(f'tried {DAMAGES}: {counts}; compiled again {DAMAGES}, loaded 0')
    stored.write_bytes(content)
    assert kernel._cache.load_overload(signature, kernel.targetctx).entry_point is not None


def test_whole_file_of_another_kind_is_set_aside_and_replaced(directory):
    kernel = compiled.compiled(cube)
    kernel(2.0)
    stored, = directory.iterdir()
    cache.write(stored.name, b'no pickle')
    again = compiled.compiled(cube)
    with pytest.warns(RuntimeWarning, match='damaged'):
        assert again(2.0) == 8.0
    assert again._cache.load_overload((numba.float64,), again.targetctx) is not None


def test_a_function_with_the_code_of_another_signature_does_not_share_it(directory):
    kernel = compiled.compiled(cube)
    assert (kernel(2.0), kernel(2)) == (8.0, 8)
    assert len(list(directory.iterdir())) == 2


def run(directory, **options):
    """Run the kernels in a process of their own; return its result and what it complained of."""
    script = directory / 'kernels.py'
    script.write_text(KERNELS)
    done = subprocess.run(
        [sys.executable, str(script)], text=True, capture_output=True, check=True, env={
            **os.environ, 'PYTHONPATH': str(ROOT), 'NUMBA_CACHE_DIR': str(directory / 'cache')},
        **options)
    assert float(done.stdout) == 10.0
    return done.stderr


def test_process_says_once_what_is_damaged_and_the_next_finds_it_repaired(tmp_path):
    assert run(tmp_path) == ''
    stored = sorted((tmp_path / 'cache').rglob('*.nbc'))
    assert len(stored) == 2
    for path in stored:
        path.write_bytes(path.read_bytes()[:-1])
    said = run(tmp_path)
    assert said.count('RuntimeWarning') == 1 and 'is damaged' in said
    assert run(tmp_path) == ''


def test_full_disk_leaves_a_result_one_warning_and_no_temporary_file(tmp_path):
    def fill():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    said = run(tmp_path, preexec_fn=fill)
    assert said.count('RuntimeWarning') == 1
    assert f"cannot be stored in {tmp_path / 'cache'}" in said
    assert [path for path in (tmp_path / 'cache').rglob('*') if path.is_file()] == []


def test_no_directory_to_write_to_is_said_once(tmp_path):
    (tmp_path / 'cache').write_text('a file')
    said = run(tmp_path)
    assert said.count('RuntimeWarning') == 1
    assert f"cannot be stored in {tmp_path / 'cache'}" in said
