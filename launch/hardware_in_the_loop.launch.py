# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A simulated machine that waits for each answer of a controller: hardware in the loop.

    ros2 launch closedloop_dynamics hardware_in_the_loop.launch.py
    ros2 launch closedloop_dynamics hardware_in_the_loop.launch.py stand_in:=true

The controller answers each state on joint_states with one command on torque_command; with
stand_in:=true closedloop_torque_source does. Other arguments are those of simulate.launch.py.
doc/examples_lockstep.md has a bridge to a device.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import IncludeLaunchDescription
from launch.actions import OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

ONE = Path(__file__).resolve().parent / 'simulate.launch.py'


def generate_launch_description():
    """Return the simulator, and what stands for the controller if that is asked for."""
    return LaunchDescription([
        DeclareLaunchArgument('stand_in', default_value='false', description='true: the torque '
                              'source answers; false: the hardware does'),
        OpaqueFunction(function=start)])


def start(context):
    """Return what the arguments ask for."""
    stands_in = LaunchConfiguration('stand_in').perform(context).lower() == 'true'
    return [IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(ONE)), launch_arguments={
            'mode': 'lockstep', 'publish_clock': 'true',
            **({'drive': 'three_rrr_circle'} if stands_in else {'scene': 'three_rrr'})}.items())]
