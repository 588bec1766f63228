# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A copy of the package to build from, and an environment that does not know the checkout."""

import os
from pathlib import Path
import shutil
import subprocess

from closedloop_dynamics.engine import build

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = 'closedloop_dynamics'
PARTS = (PACKAGE, 'CHANGELOG.rst', 'LICENSE', 'MANIFEST.in', 'README.md', 'config', 'launch',
         'package.xml', 'pyproject.toml', 'resource', 'setup.cfg', 'setup.py', 'test')
PROGRAMS = {
    'closedloop', 'closedloop_joint_states', 'closedloop_recorder', 'closedloop_simulator',
    'closedloop_estimator', 'closedloop_torque_source', 'closedloop_viewer'}
# Relative to share/PACKAGE of wherever the package is installed.
SHARED = {
    'package.xml',
    *(str(path.relative_to(ROOT)) for pattern in ('*.yaml', '*.srdf')
      for path in (ROOT / 'config').rglob(pattern)),
    *(str(path.relative_to(ROOT)) for path in (ROOT / 'launch').glob('*') if path.is_file())}


def copy_package(destination):
    """
    Copy what belongs to the package, without what earlier builds left beside it.

    But for the objects of the engine, which takes a minute to compile: where the command and all
    that was read are the same, they are linked again.
    """
    destination.mkdir(parents=True)
    for part in PARTS:
        source = ROOT / part
        if source.is_dir():
            shutil.copytree(source, destination / part,
                            ignore=shutil.ignore_patterns('__pycache__', '*.so'))
        elif source.is_file():
            shutil.copy(source, destination)
    if build.OBJECTS.is_dir():
        objects = destination / build.OBJECTS.relative_to(ROOT)
        shutil.copytree(build.OBJECTS, objects)
        with open(destination / 'setup.cfg', 'a') as settings:
            settings.write(f'\n[build_ext]\nbuild_temp = {objects}\n')
    return destination


def outside_environment(**settings):
    """Return the environment of a user for whom the checkout is not on Python's path."""
    paths = os.environ.get('PYTHONPATH', '').split(os.pathsep)
    kept = [path for path in paths if path and Path(path).resolve() != ROOT]
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(kept), **settings}


def run(*command, cwd, env=None):
    """Run a command to its end and return its output; fail with all of it if it fails."""
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=env or outside_environment(),
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, f'{command} exited with {done.returncode}:\n{done.stdout}'
    return done.stdout


def files_below(directory):
    """Return the paths of all files below a directory, relative to it."""
    return {str(path.relative_to(directory)) for path in directory.rglob('*') if path.is_file()}
