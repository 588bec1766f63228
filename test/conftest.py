# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What all tests share: ``--all`` and ``--starts``, and an environment that harms nothing around it.

The environment is set here, before anything imports rclpy, for runs without
``scripts/test``: by hand, or by ``colcon test``. What is set already is left alone. Where the
engine is compiled elsewhere, as by ``colcon build``, the package installed there is tested.

"""

import gc
import os
from pathlib import Path
import sys

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


# Where scripts/test shares the files among processes, those that compile or wait longest go first.
# Two that stand side by side compile different kernels: without effects, and with them.
FIRST = (
    'test/integration/test_methods.py', 'test/effects/test_effect_set.py',
    'test/core/test_forward_dynamics.py', 'test/effects/test_joint_friction.py',
    'test/core', 'test/stability/test_known_answers.py', 'test/studies', 'test/effects',
    'test/stability', 'test/packaging', 'test/simulation',
    'test/test_benchmark.py', 'test/view/test_browser.py',
    'test/ros/test_simulator_process.py', 'test/test_documentation.py', 'test/ros/test_faults.py',
    'test/ros/test_recorder_process.py', 'test/attack', 'test/ros/test_demo.py',
    'test/test_linters.py', 'test/ros', 'test/recording', 'test/sweep')


def pytest_addoption(parser):
    parser.addoption('--all', action='store_true', help='run the tests marked slow, too')
    parser.addoption('--starts', type=int, default=20, metavar='N', help=(
        'with --all, start each pair of commands in the documents N times (default: 20)'))


def _turn(item):
    """Return which file's turn it is."""
    return next((k for k, start in enumerate(FIRST) if item.nodeid.startswith(start)), len(FIRST))


def pytest_collection_modifyitems(config, items):
    items.sort(key=_turn)
    if config.getoption('--all'):
        return
    slow = [item for item in items if item.get_closest_marker('slow')]
    if slow:
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if item not in slow]
