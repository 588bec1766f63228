# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The command line with the libraries of the core alone: it works, or names the extra."""

import re
import runpy
import subprocess
import sys
from test.packaging.package import ROOT

from closedloop_dynamics.cli.commands import COMMANDS
from closedloop_dynamics.mechanism.extras import LIBRARIES
import pytest

# Runs each line of arguments, in one process that finds none of the libraries.
RUN = f"""
import io, sys
from contextlib import redirect_stderr
from importlib.machinery import PathFinder

class Without(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name.split('.')[0] not in {sorted(LIBRARIES)!r}:
            return super().find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Without
from closedloop_dynamics.cli import main
for line in sys.argv[1:]:
    said = io.TextIOWrapper(io.BytesIO())
    with redirect_stderr(said):
        try:
            code = main(line.split())
        except SystemExit as end:
            code = end.code
    said.flush()
    print(f'> {{line}}: {{code}}: {{said.buffer.getvalue().decode().strip()}}')
    print('scipy' if 'scipy' in sys.modules else 'no scipy')
"""
# What commands without pictures, bags and pages do, each from files of those before it.
WORKING = (
    'list', 'check four_bar', 'effects four_bar', 'urdf four_bar --output tree.urdf',
    'simulate four_bar --duration 0.1 --output run.csv',
    'view run.csv --save run.html',
    'export four_bar --output loops.urdf', 'import loops.urdf --output again.yaml',
    'kinematics four_bar --drive crank_joint=0:1:5 --output kinematics.csv', 'modes four_bar',
    'kinematics four_bar --drive crank_joint=0:1:5 --drawing lines.svg --output lines.csv',
    'compare four_bar --set mechanism.bodies.coupler.mass=2', 'replay run.csv')
ASKING = {
    'plot run.csv --output pictures': 'plot',
    'animate run.csv --output run.gif': 'plot',
    'accuracy four_bar --output results': 'plot',
    'effects four_bar --output results': 'plot',
    'report four_bar --output report.html': 'plot',
    'modes four_bar --picture modes.png': 'plot',
    'compare four_bar --set mechanism.bodies.coupler.mass=2 --output heavier': 'plot',
    'check model.xml': 'models',
    'view four_bar --no-open': 'view',
    'replay bag': 'bags',
    'plot bag --output pictures': 'plot',
    'forces bag --scene four_bar --output forces.csv': 'bags',
}


def run(lines, folder):
    """Run commands; return by line the exit code, errors and whether scipy is loaded."""
    (folder / 'bag').mkdir()
    (folder / 'bag' / 'bag.db3').touch()
    (folder / 'model.xml').write_text('<mujoco/>')
    done = subprocess.run([sys.executable, '-c', RUN, *lines], cwd=folder, text=True,
                          capture_output=True)
    assert not done.stderr and not done.returncode, done.stderr
    found = re.findall(r'^> (.*?): (\d+): (.*?)\n(scipy|no scipy)$', done.stdout,
                       re.MULTILINE | re.DOTALL)
    return {line: (int(code), said, scipy == 'scipy') for line, code, said, scipy in found}


def test_help_of_every_command_needs_nothing_and_loads_no_scipy(tmp_path):
    found = run([f'{name} --help' for name in COMMANDS] + ['--help'], tmp_path)
    assert len(found) == len(COMMANDS) + 1
    assert set(found.values()) == {(0, '', False)}


def test_commands_work_without_extras(tmp_path):
    found = run(WORKING, tmp_path)
    assert {line: said for line, (code, said, _) in found.items() if code} == {}
    assert list(found) == list(WORKING)


def test_commands_that_need_an_extra_say_how_to_install_it(tmp_path):
    lines = 'simulate four_bar --duration 0.1 --output run.csv'
    found = run([lines, *ASKING], tmp_path)
    for line, extra in ASKING.items():
        code, said, _ = found[line]
        assert code == 2, (line, found[line])
        assert re.search(rf"needs \w+: pip install \w+, or 'closedloop_dynamics\[{extra}\]'$",
                         said), (line, said)


def test_extras_have_what_asks_for_them(monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, 'argv', ['setup.py', '--version'])
    extras = runpy.run_path('setup.py')['extras']
    for package, extra in LIBRARIES.values():
        names = {re.split('[<>=]', one)[0] for one in extras[extra]}
        # What mcap and rosbags bring.
        assert package in names | {'zstandard'}, (package, extra)
    assert all(extra in extras for extra in ('plot', 'bags', 'view', 'all'))


@pytest.mark.parametrize('library', ['matplotlib', 'mcap'])
def test_a_broken_library_is_distinguished_from_a_missing_one(library):
    from closedloop_dynamics.mechanism import extras
    with pytest.raises(extras.MissingLibraryError, match='installed, but cannot be used: boom'):
        with extras.of_an_extra():
            raise ImportError('boom', name=f'{library}.part')
    # Faults of other libraries are their own.
    with pytest.raises(ImportError, match='^boom$') as caught:
        with extras.of_an_extra():
            raise ImportError('boom', name='numpy')
    assert not isinstance(caught.value, extras.MissingLibraryError)
