# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The package in a colcon workspace: built, and used from where colcon installs it."""

import os
import shutil
import subprocess
import sys
import sysconfig
from test.packaging.package import (
    copy_package, files_below, outside_environment, PACKAGE, PROGRAMS, run, SHARED)
from test.ros.domains import reserve_domain
from xml.etree import ElementTree

from closedloop_dynamics.engine.build import OBJECTS
from programs import Program
import pytest

pytest.importorskip('colcon_core', reason='colcon is not installed')
pytestmark = [
    pytest.mark.timeout(600),
    pytest.mark.skipif(' ' in sys.executable, reason='colcon breaks on a space in its path')]
# For what hardly depends on the way of building; --all tries both.
ONCE = pytest.mark.parametrize(
    'workspace', ['copied', pytest.param('linked', marks=pytest.mark.slow)], indirect=True)


def colcon(workspace, verb, *arguments):
    """Run colcon in a workspace, with the Python of this test."""
    return run(sys.executable, '-m', 'colcon', '--log-base', workspace / 'log', verb, *arguments,
               cwd=workspace)


def build(workspace, *options):
    """Build the package in a new workspace and return the workspace."""
    copy_package(workspace / 'src' / PACKAGE)
    if OBJECTS.is_dir():
        # What setup.cfg says of them is lost on the way with --symlink-install.
        place = f'temp.{sysconfig.get_platform()}-{sys.implementation.cache_tag}'
        shutil.copytree(OBJECTS, workspace / 'build' / PACKAGE / 'build' / place)
    colcon(workspace, 'build', *options)
    return workspace


@pytest.fixture(scope='module')
def copied(tmp_path_factory):
    """Return a workspace with the package copied into ``install``."""
    return build(tmp_path_factory.mktemp('copied_workspace'))


@pytest.fixture(scope='module')
def linked(tmp_path_factory):
    """Return a workspace with the package linked into ``install``."""
    return build(tmp_path_factory.mktemp('linked_workspace'), '--symlink-install')


@pytest.fixture(params=['copied', 'linked'])
def workspace(request):
    """Return a workspace with the package built, once in each way people build."""
    return request.getfixturevalue(request.param)


def prefix(workspace):
    """Return the directory the package is installed in."""
    return workspace / 'install' / PACKAGE


def sourced(workspace, **settings):
    """Return the environment of a shell that has sourced the workspace."""
    command = '. install/setup.bash && exec env -0'
    done = subprocess.run(
        ['bash', '-c', command], cwd=workspace, env=outside_environment(**settings),
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, check=True)
    return dict(entry.split('=', 1) for entry in done.stdout.split('\0') if entry)


@pytest.fixture
def start(copied):
    """Return a function that starts an installed executable; none outlives the test."""
    started = []
    with reserve_domain() as domain:
        environment = sourced(copied, ROS_DOMAIN_ID=str(domain), PYTHONUNBUFFERED='1')

        def start(executable, *arguments):
            # As ros2 run does.
            started.append(Program(
                executable, arguments, copied / f'{executable}.log', environment, copied,
                prefix(copied) / 'lib' / PACKAGE / executable))
            return started[-1].wait_until_ready()

        yield start
        for process in started:
            process.popen.kill()
            process.popen.wait()


def test_programs_are_where_ros2_run_looks(workspace):
    directory = prefix(workspace) / 'lib' / PACKAGE
    assert files_below(directory) == PROGRAMS
    assert all(os.access(directory / program, os.X_OK) for program in PROGRAMS)


def test_mechanisms_scenes_and_launch_files_are_installed(workspace):
    share = prefix(workspace) / 'share'
    assert SHARED <= files_below(share / PACKAGE)
    assert (share / 'ament_index' / 'resource_index' / 'packages' / PACKAGE).is_file()


def test_package_is_found_in_the_workspace(workspace):
    code = ('from closedloop_dynamics.mechanism import config; '
            'print(config.__file__, config.config_directory(), sep="\\n")')
    output = run(sys.executable, '-c', code, cwd=workspace, env=sourced(workspace))
    assert all(line.startswith(str(workspace)) for line in output.splitlines()), output


@ONCE
def test_command_line_runs(workspace):
    program = prefix(workspace) / 'lib' / PACKAGE / 'closedloop'
    assert 'simulate' in run(program, '--help', cwd=workspace, env=sourced(workspace))
    assert 'theta_1' in run(program, 'check', 'three_rrr', cwd=workspace, env=sourced(workspace))


def test_nodes_run_together_and_end_when_interrupted(start):
    names = ('closedloop_simulator', 'closedloop_torque_source', 'closedloop_recorder')
    processes = [start(name) for name in names]
    codes = {process.executable: process.stop() for process in reversed(processes)}
    assert codes == dict.fromkeys(names, 0), [process.output for process in processes]


@pytest.mark.slow
@ONCE
def test_colcon_test_finds_the_tests(workspace):
    colcon(workspace, 'test', '--pytest-args', 'test/mechanism/test_expressions.py')
    results = ElementTree.parse(workspace / 'build' / PACKAGE / 'pytest.xml')
    assert int(results.getroot().find('testsuite').get('tests')) > 3
