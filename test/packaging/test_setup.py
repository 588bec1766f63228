# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""What scripts do: the Python that environments are made from, the order of the tests."""

import os
import subprocess
import sys
from test.conftest import in_order
from test.packaging.package import ROOT


def chosen(folder):
    """Return name, base and digest that a shell with this folder first on its path arrives at."""
    script = 'source scripts/_setup.sh; choose_kind; echo "$name"; echo "$base_python"; digest'
    environment = {**os.environ, 'PATH': f'{folder}{os.pathsep}{os.environ["PATH"]}'}
    for name in ('ROS_DISTRO', 'PYTHON', 'VERSIONS'):
        environment.pop(name, None)
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


def test_every_process_gets_the_tests_in_the_same_order():
    # One that waits and one that computes: both have the middle for their place.
    files = [ROOT / 'test' / name for name in ('ros/test_messages.py', 'core/test_codegen.py')]
    assert in_order(files) == in_order(files[::-1])
