# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Launch files of the package, as launch_testing runs them."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_testing.actions import ReadyToTest

FOLDER = Path(__file__).resolve().parents[2] / 'launch'


def described(name, **arguments):
    """Return what a launch file starts, and that the test may begin."""
    return LaunchDescription([
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(FOLDER / f'{name}.launch.py')),
            launch_arguments=arguments.items()),
        ReadyToTest()])
