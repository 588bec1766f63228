# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Type hints of what users script with: complete, and consistent with the code."""

from configparser import ConfigParser
from pathlib import Path
import re
import subprocess
import sys

import closedloop_dynamics
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'closedloop_dynamics'


def checked_files():
    """Return the files that setup.cfg has checked."""
    settings = ConfigParser()
    settings.read(ROOT / 'setup.cfg')
    return [name.strip() for name in settings['mypy']['files'].split(',')]


def check(arguments, cache):
    """Return the exit code and the report of mypy."""
    done = subprocess.run(
        [sys.executable, '-m', 'mypy', '--cache-dir', str(cache), '--no-error-summary',
         *arguments], cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    return done.returncode, done.stdout


@pytest.fixture(scope='module')
def cache(request, tmp_path_factory):
    """Return where mypy keeps what it has read, from run to run where pytest has such a place."""
    place = getattr(request.config, 'cache', None)
    return place.mkdir('mypy') if place else tmp_path_factory.mktemp('mypy')


def test_hints_are_complete_and_hold(cache):
    code, report = check((), cache)
    assert code == 0, report


def test_all_that_is_public_is_checked():
    stub = (ROOT / PACKAGE / '__init__.pyi').read_text()
    assert sorted(re.findall(r'(\w+) as \1', stub)) == sorted(closedloop_dynamics.__all__)
    homes = {Path(sys.modules[getattr(closedloop_dynamics, name).__module__].__file__)
             for name in closedloop_dynamics.__all__}
    # Of rollout.py the function is that of model_rollout.py; ``Rollout`` is a record of arrays.
    known = {ROOT / name for name in (*checked_files(), f'{PACKAGE}/simulation/rollout.py')}
    assert not homes - known
    assert (ROOT / PACKAGE / 'py.typed').is_file()


@pytest.mark.parametrize('script, complaint', [
    ('import closedloop_dynamics as cld\n'
     'def accelerations(name: str) -> cld.Evaluation:\n'
     '    model = cld.Model.from_scene(name)\n'
     '    return model.evaluate(model.assemble({"crank": 0.3}), {"crank": 1.0})\n', ''),
    ('import closedloop_dynamics as cld\n'
     'wrong: int = cld.Model.from_scene("four_bar")\n', 'Incompatible types in assignment'),
    ('import closedloop_dynamics as cld\n'
     'cld.Simulation.from_scene("four_bar").step(duration="long")\n', 'has incompatible type'),
    ('def unknown(name):\n    return name\n', 'missing a type annotation'),
])
def test_scripts_are_checked_against_them(script, complaint, cache, tmp_path):
    path = tmp_path / 'script.py'
    path.write_text(script)
    code, report = check([str(path)], cache)
    assert (code, report) == (0, '') if not complaint else code == 1 and complaint in report, (
        report)
