# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Simulate both machines side by side, each in a namespace of its own: left and right.

    ros2 launch closedloop_dynamics two_mechanisms.launch.py rviz:=true

The left one is the 3-RRR on its circle, the right one the carpet scraper at 45 rpm.

"""

from pathlib import Path

from closedloop_dynamics.config import config_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import GroupAction
from launch.actions import IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch.substitutions import PythonExpression
from launch_ros.actions import Node

ONE = Path(__file__).resolve().parent / 'simulate.launch.py'
# Namespace, drive, and where it stands [m].
MACHINES = (('left', 'three_rrr_circle', 0.0), ('right', 'carpet_scraper_speed', 1.6))


def generate_launch_description():
    """Return both machines, and RViz for both."""
    rviz = LaunchConfiguration('rviz')
    entities = [
        DeclareLaunchArgument('record', default_value='false', description=(
            'true: record each into a bag of its own, named left and right')),
        DeclareLaunchArgument('rviz', default_value='false', description=(
            'true: show both in RViz; needs rviz2, robot_state_publisher and tf2_ros')),
        DeclareLaunchArgument('mode', default_value='realtime', description=(
            'realtime, as_fast_as_possible or lockstep, of both simulators')),
    ]
    for namespace, drive, place in MACHINES:
        record = PythonExpression([
            f"'{namespace}' if '", LaunchConfiguration('record'),
            "'.lower() == 'true' else 'false'"])
        # In a group, the arguments of the one do not become those of the other.
        entities.append(GroupAction([IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(ONE)), launch_arguments={
                'namespace': namespace, 'drive': drive, 'record': record, 'rviz': rviz,
                'mode': LaunchConfiguration('mode'), 'frame_prefix': f'{namespace}/',
                'marker_frame': f'{namespace}/world'}.items())]))
        entities.append(Node(
            package='tf2_ros', executable='static_transform_publisher', name=f'place_{namespace}',
            condition=IfCondition(rviz), arguments=[
                '--x', str(place), '--frame-id', 'world', '--child-frame-id',
                f'{namespace}/world']))
    entities.append(Node(
        package='rviz2', executable='rviz2', condition=IfCondition(rviz), output='screen',
        arguments=['-d', str(config_directory() / 'rviz' / 'two_mechanisms.rviz')]))
    return LaunchDescription(entities)
