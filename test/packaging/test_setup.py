# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""What scripts do: the Python that environments are made from, the order of the tests."""

import os
import subprocess
import sys
from test.conftest import in_order
from test.packaging.package import ROOT

import pytest


def chosen(folder, **settings):
    """Return name, base and digest that a shell with this folder first on its path arrives at."""
    script = 'source scripts/_setup.sh; choose_kind; echo "$name"; echo "$base_python"; digest'
    environment = {**os.environ, 'PATH': f'{folder}{os.pathsep}{os.environ["PATH"]}'}
    for name in ('ROS_DISTRO', 'PYTHON', 'VERSIONS', 'WHEELS'):
        environment.pop(name, None)
    environment.update(settings)
    return subprocess.run(
        ['bash', '-c', script], cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, text=True,
        stdout=subprocess.PIPE, check=True).stdout.splitlines()


def test_an_active_environment_is_not_taken_for_the_python_to_make_it_from(tmp_path):
    base = os.path.realpath(sys._base_executable)
    subprocess.run([base, '-m', 'venv', '--without-pip', str(tmp_path)], check=True)
    name, python, digest = chosen(tmp_path / 'bin')
    assert python == base
    # Nothing would be made again, either.
    assert [name, python, digest] == chosen(os.path.dirname(base))


@pytest.mark.parametrize('settings, ends', [
    ({}, ('pypi-', '')), ({'WHEELS': 'kilted'}, ('pypi-', '-kilted')),
    ({'ROS_DISTRO': 'jazzy'}, ('ros-', '')), ({'ROS_DISTRO': 'kilted'}, ('ros-', '-kilted')),
    ({'ROS_DISTRO': 'lyrical'}, ('ros-', '-lyrical')),
    ({'ROS_DISTRO': 'rolling'}, ('ros-', '-rolling')), ({'ROS_DISTRO': 'humble'}, ('pypi-', ''))])
def test_environment_is_of_the_distribution(settings, ends):
    # The Python of this test imports rclpy, as that of a sourced ROS does.
    version = '%d.%d' % sys.version_info[:2]
    name, *_ = chosen(os.path.dirname(sys.executable), PYTHON=sys.executable, **settings)
    assert name == f'{ends[0]}{version}{ends[1]}'


def test_every_process_gets_the_tests_in_the_same_order():
    # One that waits and one that computes: both have the middle for their place.
    files = [ROOT / 'test' / name for name in ('ros/test_messages.py', 'codegen/test_codegen.py')]
    assert in_order(files) == in_order(files[::-1])
