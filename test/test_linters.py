# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Ruff; the linters of ROS 2 Jazzy, ament_flake8 and ament_pep257; the licence headers."""

import hashlib
from importlib.metadata import distributions
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('benchmark', 'closedloop_dynamics', 'doc', 'launch', 'scripts', 'test')
SOURCES = sorted(['setup.py', *(str(path.relative_to(ROOT)) for folder in FOLDERS
                                for path in (ROOT / folder).rglob('*.py'))])
# Of all that may have a part in it.
VERSIONS = sorted(
    f'{one.name} {one.version}' for one in distributions() if str(one.name).startswith((
        'ament', 'flake8', 'mccabe', 'pycodestyle', 'pydocstyle', 'pyflakes', 'ros-ament')))
LICENCE = ['SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors',
           'SPDX-License-Identifier: Apache-2.0']


def digest(linter, path):
    """Return a digest of a file, its name and all that checks it."""
    return hashlib.sha256(repr(
        (linter, path, sys.version, VERSIONS, (ROOT / path).read_bytes())).encode()).hexdigest()


def test_sources_are_found():
    assert {'setup.py', 'test/test_linters.py'} < set(SOURCES)


def test_ruff_finds_nothing():
    done = subprocess.run([sys.executable, '-m', 'ruff', 'check', '--no-cache', *SOURCES],
                          cwd=ROOT, text=True, stdin=subprocess.DEVNULL, capture_output=True)
    assert done.returncode == 0, done.stdout + done.stderr


# Most of their rules are ruff's, too, which takes a hundredth of their time.
@pytest.mark.slow
@pytest.mark.parametrize('linter', ['ament_flake8', 'ament_pep257'])
def test_linter_finds_nothing(linter, pytestconfig):
    # Files are checked one by one: those in which the same linters found nothing are left out.
    known = set(pytestconfig.cache.get(f'linters/{linter}', ())) if hasattr(
        pytestconfig, 'cache') else set()
    digests = {path: digest(linter, path) for path in SOURCES}
    changed = [path for path in SOURCES if digests[path] not in known]
    if changed:
        # In a process of its own: flake8 forks, which must not happen beside this one's threads.
        # Looking for cycles of unused objects takes a third of the time, and finds few.
        code = (f'import gc; gc.disable(); import sys; from {linter}.main import main; '
                'sys.exit(main())')
        done = subprocess.run([sys.executable, '-c', code, *changed], cwd=ROOT, text=True,
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT)
        names_of_files = ('checking ', '* ')
        report = [line for line in done.stdout.splitlines()
                  if not line.startswith(names_of_files)]
        assert done.returncode == 0, '\n'.join(report)
    if hasattr(pytestconfig, 'cache'):
        pytestconfig.cache.set(f'linters/{linter}', sorted(digests.values()))


def test_every_file_has_its_licence():
    engine = [str(path.relative_to(ROOT)) for pattern in ('*.cpp', '*.hpp')
              for path in (ROOT / 'closedloop_dynamics' / 'engine').glob(pattern)]
    starts = {path: (ROOT / path).read_text().splitlines()[:3] for path in (*SOURCES, *engine)}
    assert engine
    assert not [path for path, lines in starts.items()
                if not all(any(line.endswith(each) for line in lines) for each in LICENCE)]
