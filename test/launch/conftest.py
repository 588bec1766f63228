# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests by launch_testing: left out where it, or what they launch, is not installed."""

from importlib.util import find_spec

from ament_index_python.packages import get_package_prefix, PackageNotFoundError

# What each file launches.
PACKAGES = {
    'test_simulate.py': ('closedloop_dynamics',),
    'test_ros2_control.py': ('closedloop_dynamics', 'closedloop_hardware', 'controller_manager',
                             'joint_state_broadcaster', 'joint_trajectory_controller',
                             'robot_state_publisher')}


def _is_installed(package):
    try:
        return bool(get_package_prefix(package))
    except (LookupError, PackageNotFoundError):
        return False


collect_ignore = [
    file for file, packages in PACKAGES.items()
    if find_spec('launch_testing_ros') is None or not all(map(_is_installed, packages))]
