# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The package installed with pip: as a wheel, in a directory and in a virtual environment."""

import os
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from test.packaging.package import (
    copy_package, files_below, outside_environment, PACKAGE, PROGRAMS, ROOT, run, SHARED)
import venv
from xml.etree import ElementTree
from zipfile import ZipFile

from closedloop_dynamics.engine import build
import pytest

PIP = (sys.executable, '-m', 'pip', '--disable-pip-version-check', '--no-input')
OFFLINE = ('--no-deps', '--no-index')
# Python compiles what is imported when it first is.
INSTALL = ('install', '--no-compile', *OFFLINE)
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
SHOW_ENGINE = 'from closedloop_dynamics.engine import native; print(native.__file__)'
SHOW_CONFIG = (
    'from closedloop_dynamics.mechanism.config import config_directory; print(config_directory())')


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
    """Return the path of a wheel of the package, made from its archive of sources."""
    directory = tmp_path_factory.mktemp('wheel')
    source = copy_package(directory / 'source')
    run(sys.executable, '-c', 'from setuptools.build_meta import build_sdist; build_sdist("..")',
        cwd=source)
    run(*PIP, 'wheel', *OFFLINE, '--no-build-isolation', '--wheel-dir', directory,
        next(directory.glob('*.tar.gz')), cwd=directory)
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
    run(*PIP, '--python', directory / 'bin' / 'python', *INSTALL, wheel, cwd=directory)
    return directory


def test_wheel_holds_the_package_and_nothing_else(wheel):
    names = {Path(name).parts[0] for name in ZipFile(wheel).namelist()}
    assert {name for name in names if not name.startswith(f'{PACKAGE}-')} == {PACKAGE}


def test_archive_of_sources_holds_all_that_is_compiled(wheel):
    with tarfile.open(next(wheel.parent.glob('*.tar.gz'))) as archive:
        names = {Path(name).name for name in archive.getnames() if f'{PACKAGE}/engine/' in name}
    engine = ROOT / PACKAGE / 'engine'
    needed = {path.name for path in (*engine.glob('*.cpp'), *engine.glob('*.hpp'))}
    assert len(needed) > 80 and needed <= names


def test_versions_agree(wheel):
    version = ElementTree.parse(wheel.parent / 'source' / 'package.xml').findtext('version')
    assert wheel.name.startswith(f'{PACKAGE}-{version}-')


def test_programs_are_on_the_path_of_the_environment(environment):
    assert PROGRAMS <= files_below(environment / 'bin')
    assert SHARED <= files_below(environment / 'share' / PACKAGE)


def test_files_of_the_package_are_in_the_wheel_without_what_they_are_compiled_from(wheel):
    here = {str(path.relative_to(ROOT)) for path in (ROOT / PACKAGE).rglob('*')
            if path.is_file() and '__pycache__' not in path.parts
            and path.suffix not in ('.cpp', '.hpp', '.so')}
    there = {name for name in ZipFile(wheel).namelist() if name.startswith(f'{PACKAGE}/')}
    assert there - here == {f'{PACKAGE}/engine/{build.module()}'}
    assert here <= there
    assert any(name.endswith('page.html') for name in here)


def test_one_wheel_is_for_all_supported_versions_of_python(wheel):
    assert '-cp311-abi3-linux_' in wheel.name


def test_checkout_that_has_its_engine_needs_no_compiler(tmp_path):
    source = copy_package(tmp_path / 'source')
    engine = Path(PACKAGE, 'engine', build.module())
    shutil.copy2(ROOT / engine, source / engine)
    venv.create(tmp_path / 'venv')
    python = tmp_path / 'venv' / 'bin' / 'python'
    run(*PIP, '--python', python, *INSTALL, '--no-build-isolation', '--editable', source,
        cwd=tmp_path, env=with_libraries() | {'CXX': 'missing'})
    assert (source / engine).read_bytes() == (ROOT / engine).read_bytes()
    assert run(python, '-c', SHOW_ENGINE, cwd=tmp_path).strip() == str(source / engine)


@pytest.mark.slow
@pytest.mark.parametrize('pip', ['pip==23.0.1', 'pip'])
@pytest.mark.parametrize('options', [(), ('--editable',)])
def test_every_pip_puts_the_programs_on_the_path(pip, options, tmp_path):
    source = copy_package(tmp_path / 'source')
    venv.create(tmp_path / 'venv', with_pip=True)
    python = tmp_path / 'venv' / 'bin' / 'python'
    run(python, '-m', 'pip', 'install', pip, cwd=tmp_path)
    # In an environment of pip's own making, from the package index.
    run(python, '-m', 'pip', 'install', '--no-deps', *options, source, cwd=tmp_path)
    assert PROGRAMS <= files_below(tmp_path / 'venv' / 'bin')
    output = run(python, '-c', SHOW_ENGINE, cwd=tmp_path)
    assert output.startswith(str(source) if options else str(tmp_path / 'venv'))


def test_program_works_in_the_environment_from_another_directory(environment, tmp_path):
    assert 'theta_1' in run(environment / 'bin' / 'closedloop', 'check', 'three_rrr',
                            cwd=tmp_path, env=with_libraries())


def test_commands_work_in_the_environment_from_another_directory(environment, tmp_path):
    lines, expected = zip(
        ('simulate four_bar --duration 0.1 --output run.csv', 'run.csv: 11 rows'),
        ('plot run.csv --output pictures', 'positions.png'),
        ('animate run.csv --output run.gif', 'run.gif'),
        ('view run.csv --save run.html', 'run.html'),
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
    run(*PIP, '--python', tmp_path / 'bare' / 'bin' / 'python', *INSTALL, wheel,
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
    run(*PIP, *INSTALL, '--target', tmp_path / 'target', wheel, cwd=tmp_path)
    output = run(sys.executable, '-c', SHOW_CONFIG, cwd=tmp_path,
                 env=with_libraries(tmp_path / 'target'))
    assert Path(output.strip()) == tmp_path / 'target' / 'share' / PACKAGE / 'config'
