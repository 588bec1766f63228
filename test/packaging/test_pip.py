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
import sys
import sysconfig
from test.packaging.package import (
    copy_package, files_below, outside_environment, PACKAGE, PROGRAMS, run, SHARED)
import venv
from xml.etree import ElementTree
from zipfile import ZipFile

import pytest

PIP = (sys.executable, '-m', 'pip', '--disable-pip-version-check', '--no-input')
OFFLINE = ('--no-deps', '--no-index')
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


def test_command_line_runs_in_the_environment(environment):
    output = run(environment / 'bin' / 'closedloop', 'check', 'three_rrr',
                 cwd=environment, env=with_libraries())
    assert 'theta_1' in output


def test_config_is_found_in_the_environment(environment):
    output = run(environment / 'bin' / 'python', '-c', SHOW_CONFIG,
                 cwd=environment, env=with_libraries())
    assert Path(output.strip()) == environment / 'share' / PACKAGE / 'config'


def test_config_is_found_in_a_directory(wheel, tmp_path):
    run(*PIP, 'install', *OFFLINE, '--target', tmp_path / 'target', wheel, cwd=tmp_path)
    output = run(sys.executable, '-c', SHOW_CONFIG, cwd=tmp_path,
                 env=with_libraries(tmp_path / 'target'))
    assert Path(output.strip()) == tmp_path / 'target' / 'share' / PACKAGE / 'config'
