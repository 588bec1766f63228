# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What all tests share: ``--all`` and ``--starts``, and an environment that harms nothing around it.

The environment is set here, before anything imports rclpy, for runs without
``scripts/test``: by hand, or by ``colcon test``. What is set already is left alone. Where the
engine is compiled elsewhere, as by ``colcon build``, the package installed there is tested.
"""

from contextlib import suppress
import gc
from importlib import import_module
import os
from pathlib import Path
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
if not list((ROOT / 'closedloop_dynamics' / 'engine').glob('native*.so')):
    # pytest puts the sources first again for every file: the package is found once, here.
    sys.path[:] = [*(path for path in sys.path if Path(path).resolve() != ROOT), str(ROOT)]
    import closedloop_dynamics  # noqa: F401

os.environ.setdefault('MPLBACKEND', 'Agg')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
# Linux has free ports for domains 0 to 101; 0 is everyone's.
if 'ROS_DOMAIN_ID' not in os.environ or 'PYTEST_XDIST_WORKER' in os.environ:
    os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 101)
# Compilers make millions of objects. Looking through them for cycles as often as by default takes
# a seventh of all CPU time; looking so seldom takes 50 MB.
gc.set_threshold(100_000, 20, 100)


# Tests in these folders wait for processes more than they compute.
WAITING = ('ros', 'view', 'packaging', 'attack')


def pytest_addoption(parser):
    parser.addoption('--all', action='store_true', help='run the tests marked slow, too')
    parser.addoption('--starts', type=int, default=20, metavar='N', help=(
        'with --all, start each pair of commands in the documents N times (default: 20)'))


def in_order(files):
    """
    Return files in the order in which ``scripts/test`` gives them to its processes.

    Long files first, so that none is begun when all others have ended; those whose tests wait
    evenly among those whose tests compute.
    """
    kinds = {}
    for file in sorted(files, key=lambda file: (-file.stat().st_size, file)):
        kinds.setdefault(file.relative_to(ROOT / 'test').parts[0] in WAITING, []).append(file)
    # The name decides between equal places: all processes have to find the same order.
    places = {file: ((k + 0.5) / len(kind), file) for kind in kinds.values()
              for k, file in enumerate(kind)}
    return sorted(files, key=places.get)


def pytest_collection(session):
    """
    Import the tests, in each process beginning with other ones.

    What pytest makes of assertions takes as long as all else of a first collection. It is kept in
    files: so each process finds most of it.

    """
    count = int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', 1))
    asked = [Path(name.split('::')[0]).resolve() for name in session.config.args]
    files = [file for file in sorted((ROOT / 'test').rglob('test_*.py'))
             if any(file.is_relative_to(place) for place in asked)]
    first = len(files) * int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:]) // count
    for file in files[first:] + files[:first] if count > 1 else ():
        # What fails, or skips all its tests, says so when it is collected.
        with suppress(Exception, pytest.skip.Exception):
            import_module('.'.join(file.relative_to(ROOT).with_suffix('').parts))


def pytest_collection_modifyitems(config, items):
    turn = {file: k for k, file in enumerate(in_order({item.path for item in items}))}
    items.sort(key=lambda item: turn[item.path])
    if config.getoption('--all'):
        return
    kept, slow = [], []
    for item in items:
        (slow if item.get_closest_marker('slow') else kept).append(item)
    if slow:
        config.hook.pytest_deselected(items=slow)
        items[:] = kept


@pytest.fixture
def wanted(monkeypatch):
    """Return a list of the names of code that was asked for, found or compiled, since."""
    from closedloop_dynamics.codegen import cache
    names, read = [], cache.read

    def noted(name):
        names.append(name)
        return read(name)

    monkeypatch.setattr(cache, 'read', noted)
    return names


@pytest.fixture
def counted(monkeypatch):
    """Measure evaluations, of 1 us each, in the place of time; return what measures time."""
    from closedloop_dynamics.simulation.monitor import Monitor
    import numpy as np
    real = Monitor.measured.fget

    def measured(self):
        simulated, _, _, *work = real(self)
        return np.array([simulated, *2 * [1e-6 * sum(work)], *work])

    monkeypatch.setattr(Monitor, 'measured', property(measured))
    return real
