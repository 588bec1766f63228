# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The platform of the 3-RRR gives way like a spring: impedance control.

    ros2 launch closedloop_dynamics impedance_control.launch.py

Arguments are those of simulate.launch.py. doc/examples_impedance.md pushes the platform.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

ONE = Path(__file__).resolve().parent / 'simulate.launch.py'


def generate_launch_description():
    """Return the simulator and its controller."""
    return LaunchDescription([IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(ONE)),
        launch_arguments={'drive': 'three_rrr_impedance'}.items())])
