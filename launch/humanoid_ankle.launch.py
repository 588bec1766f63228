# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
All joints of a humanoid's ankle, and the forces in its rods, from what its motors measure.

    ros2 launch closedloop_dynamics humanoid_ankle.launch.py
    ros2 launch closedloop_dynamics humanoid_ankle.launch.py robot:=false

A simulator in the namespace robot stands for the robot; without it, drivers of the motors publish
on /robot/joint_states. doc/examples_ankle.md looks at what comes out.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import GroupAction
from launch.actions import IncludeLaunchDescription
from launch.actions import OpaqueFunction
from launch.actions import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ONE = Path(__file__).resolve().parent / 'simulate.launch.py'


def generate_launch_description():
    """Return the node that completes, and what stands for the robot."""
    return LaunchDescription([
        DeclareLaunchArgument('robot', default_value='true', description='true: a simulator '
                              'stands for the robot; false: the robot is there'),
        OpaqueFunction(function=start)])


def start(context):
    """Return what the arguments ask for."""
    completion = Node(
        package='closedloop_dynamics', executable='closedloop_joint_states', output='screen',
        parameters=[{'scene': 'humanoid_ankle', 'joints': ['left', 'right'], 'forces': True}],
        remappings=[('joint_states', '/robot/joint_states')],
        on_exit=Shutdown(reason='closedloop_joint_states ended'))
    if LaunchConfiguration('robot').perform(context).lower() != 'true':
        return [completion]
    return [completion, GroupAction([IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(ONE)), launch_arguments={
            'namespace': 'robot', 'drive': 'humanoid_ankle_swing'}.items())])]
