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

"""Simulate a scene: ``ros2 launch closedloop_dynamics simulate.launch.py scene:=four_bar``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

# Name, type, default and meaning of the simulator's parameters.
PARAMETERS = (
    ('scene', str, 'three_rrr', 'name of a shipped scene, or path of a scene file'),
    ('publish_rate', float, '100.0', 'states per second [Hz]'),
    ('step_size', float, '0.0', "step of the time integration [s]; 0: the scene's own"),
    ('real_time_factor', float, '1.0', 'simulated seconds per second'),
    ('command_timeout', float, '0.0',
     'torques fall to zero without commands for so long [s]; 0: never'),
    ('wait_for_command', bool, 'false', 'keep the initial state until the first command'),
)


def generate_launch_description():
    """Return one simulator node and the arguments that set it up."""
    arguments = [DeclareLaunchArgument(
        'namespace', default_value='', description='namespace of the node and its topics')]
    arguments += [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, _, default, description in PARAMETERS]
    simulator = Node(
        package='closedloop_dynamics',
        executable='closedloop_simulator',
        namespace=LaunchConfiguration('namespace'),
        parameters=[{
            name: ParameterValue(LaunchConfiguration(name), value_type=kind)
            for name, kind, _, _ in PARAMETERS}],
        output='screen',
    )
    return LaunchDescription([*arguments, simulator])
