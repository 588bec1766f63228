# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Simulate both machines side by side, each in a namespace of its own: left and right.

    ros2 launch closedloop_dynamics two_mechanisms.launch.py rviz:=true

The left one is the 3-RRR on its circle, the right one the carpet scraper at 45 rpm.
"""

from pathlib import Path

from closedloop_dynamics.mechanism.config import config_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import GroupAction
from launch.actions import IncludeLaunchDescription
from launch.actions import OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ONE = Path(__file__).resolve().parent / 'simulate.launch.py'
MACHINES = (('left', 'three_rrr_circle', 0.0), ('right', 'carpet_scraper_speed', 1.6))
ARGUMENTS = (
    ('record', 'false', 'true: record each into a bag of its own, named left and right'),
    ('rviz', 'false', 'true: show both in RViz; needs rviz2 and tf2_ros'),
    ('mode', 'realtime', 'realtime, as_fast_as_possible or lockstep, of both simulators'),
)


def generate_launch_description():
    """Return the arguments, and what makes both machines of them."""
    declared = [DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS]
    # In a function, so that the arguments of what is included are not shown as arguments of this.
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def start(context):
    """Return both machines, and RViz for both."""
    values = {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    shown, recorded = (values[name].lower() == 'true' for name in ('rviz', 'record'))
    # In a group, the arguments of the one do not become those of the other.
    entities = [GroupAction([IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(ONE)), launch_arguments={
            'namespace': namespace, 'drive': drive, 'rviz': values['rviz'],
            'record': namespace if recorded else 'false', 'mode': values['mode'],
            'frame_prefix': f'{namespace}/', 'marker_frame': f'{namespace}/world'}.items())])
        for namespace, drive, _ in MACHINES]
    if shown:
        entities += [Node(
            package='tf2_ros', executable='static_transform_publisher', name=f'place_{namespace}',
            arguments=['--x', str(place), '--frame-id', 'world', '--child-frame-id',
                       f'{namespace}/world']) for namespace, _, place in MACHINES]
        entities.append(Node(
            package='rviz2', executable='rviz2', output='screen',
            arguments=['-d', str(config_directory() / 'rviz' / 'two_mechanisms.rviz')]))
    return entities
