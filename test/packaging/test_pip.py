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

"""The package installed with pip: as a wheel, in a directory and in a virtual environment."""

import os
from pathlib import Path
import subprocess
import sys
import sysconfig
from test.packaging.package import (
    copy_package, files_below, outside_environment, PACKAGE, PROGRAMS, ROOT, run, SHARED)
import venv
from xml.etree import ElementTree
from zipfile import ZipFile

import pytest

PIP = (sys.executable, '-m', 'pip', '--disable-pip-version-check', '--no-input')
OFFLINE = ('--no-deps', '--no-index')
# Each argument is a line of arguments to closedloop.
ALL_COMMANDS = """
import sys
import closedloop_dynamics
from closedloop_dynamics.cli import main
assert closedloop_dynamics.__file__.startswith(sys.prefix)
for line in sys.argv[1:]:
    print(f'> {line}', flush=True)
    assert main(line.split()) == 0
"""
SHOW_CONFIG = (
    'from closedloop_dynamics.mechanism.config import config_directory; print(config_directory())')


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
    """Return the path of a wheel of the package."""
    directory = tmp_path_factory.mktemp('wheel')
    source = copy_package(directory / 'source')
    run(*PIP, 'wheel', *OFFLINE, '--no-build-isolation', '--wheel-dir', directory, source,
        cwd=directory)
    return next(directory.glob('*.whl'))


def with_libraries(*first):
    """Return an environment in which Python finds these directories and its present libraries."""
    libraries = [sysconfig.get_path('purelib'), sysconfig.get_path('platlib')]
    inherited = outside_environment()['PYTHONPATH'].split(os.pathsep)
    paths = [str(path) for path in first] + inherited + libraries
    return outside_environment(PYTHONPATH=os.pathsep.join(filter(None, paths)))


@pytest.fixture(scope='module')
def environment(wheel, tmp_path_factory):
    """Return the directory of a new virtual environment with the package installed."""
    directory = tmp_path_factory.mktemp('environment')
    venv.create(directory, system_site_packages=True)
    run(*PIP, '--python', directory / 'bin' / 'python', 'install', *OFFLINE, wheel, cwd=directory)
    return directory


def test_wheel_holds_the_package_and_nothing_else(wheel):
    names = {Path(name).parts[0] for name in ZipFile(wheel).namelist()}
    assert {name for name in names if not name.startswith(f'{PACKAGE}-')} == {PACKAGE}


def test_versions_agree(wheel):
    version = ElementTree.parse(wheel.parent / 'source' / 'package.xml').findtext('version')
    assert wheel.name.startswith(f'{PACKAGE}-{version}-')


def test_programs_are_on_the_path_of_the_environment(environment):
    assert PROGRAMS <= files_below(environment / 'bin')
    assert SHARED <= files_below(environment / 'share' / PACKAGE)


def test_data_files_of_the_package_are_in_the_wheel(wheel):
    here = {str(path.relative_to(ROOT)) for path in (ROOT / PACKAGE).rglob('*')
            if path.is_file() and '__pycache__' not in path.parts}
    assert here <= set(ZipFile(wheel).namelist())
    assert any(name.endswith('page.html') for name in here)


def test_program_works_in_the_environment_from_another_directory(environment, tmp_path):
    assert 'theta_1' in run(environment / 'bin' / 'closedloop', 'check', 'three_rrr',
                            cwd=tmp_path, env=with_libraries())


def test_commands_work_in_the_environment_from_another_directory(environment, tmp_path):
    lines, expected = zip(
        ('simulate four_bar --duration 0.1 --output run.csv', 'run.csv: 11 rows'),
        ('plot run.csv --scene four_bar --output pictures', 'positions.png'),
        ('animate run.csv --scene four_bar --output run.gif', 'run.gif'),
        ('view run.csv --scene four_bar --save run.html', 'run.html'),
        ('urdf four_bar --output tree.urdf', ''),
        ('export four_bar --output loops.urdf', 'loops.urdf'),
        ('import loops.urdf --output again.yaml', 'again.yaml'),
        ('check again.yaml', 'degrees of freedom'))
    # In one process: a start takes longer than most commands.
    output = run(environment / 'bin' / 'python', '-c', ALL_COMMANDS, *lines, cwd=tmp_path,
                 env=with_libraries())
    for line, said in zip(lines, expected):
        assert said in output.split(f'> {line}\n')[1].split('\n> ')[0]


def test_nodes_without_ros_say_what_is_missing(wheel, tmp_path):
    venv.create(tmp_path / 'bare')
    run(*PIP, '--python', tmp_path / 'bare' / 'bin' / 'python', 'install', *OFFLINE, wheel,
        cwd=tmp_path)
    for program in sorted(PROGRAMS - {'closedloop'}):
        done = subprocess.run(
            [tmp_path / 'bare' / 'bin' / program], cwd=tmp_path, text=True, capture_output=True,
            env={'PATH': os.environ['PATH']})
        assert done.returncode == 2
        assert done.stderr.count('\n') == 1 and "'ros-jazzy-rclpy[fastrtps]'" in done.stderr


def test_config_is_found_in_the_environment(environment):
    output = run(environment / 'bin' / 'python', '-c', SHOW_CONFIG,
                 cwd=environment, env=with_libraries())
    assert Path(output.strip()) == environment / 'share' / PACKAGE / 'config'


def test_config_is_found_in_a_directory(wheel, tmp_path):
    run(*PIP, 'install', *OFFLINE, '--target', tmp_path / 'target', wheel, cwd=tmp_path)
    output = run(sys.executable, '-c', SHOW_CONFIG, cwd=tmp_path,
                 env=with_libraries(tmp_path / 'target'))
    assert Path(output.strip()) == tmp_path / 'target' / 'share' / PACKAGE / 'config'
