# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The Delta robot picks and places: on a path of its own, or as MoveIt plans.

    ros2 launch closedloop_dynamics delta_pick_and_place.launch.py
    ros2 launch closedloop_dynamics delta_pick_and_place.launch.py moveit:=true

With moveit:=true the simulator stands for the hardware of ros2_control, and move_group plans for
the driven joints; it needs MoveIt and ros2_controllers. Other arguments are those of
simulate.launch.py. doc/examples_moveit.md states what MoveIt is given.
"""

from pathlib import Path

from ament_index_python.packages import get_package_prefix
from ament_index_python.packages import PackageNotFoundError
from closedloop_dynamics.mechanism.config import config_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import IncludeLaunchDescription
from launch.actions import OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ONE = Path(__file__).resolve().parent / 'simulate.launch.py'
NEEDED = ('moveit_ros_move_group', 'controller_manager', 'joint_trajectory_controller',
          'joint_state_topic_hardware_interface')
CONTROLLER = 'joint_trajectory_controller'


def generate_launch_description():
    """Return the simulator, and what leads it."""
    return LaunchDescription([
        DeclareLaunchArgument('moveit', default_value='false', description='true: MoveIt plans, '
                              'ros2_control follows; false: the torque source follows its path'),
        OpaqueFunction(function=start)])


def start(context):
    """Return what the arguments ask for."""
    if LaunchConfiguration('moveit').perform(context).lower() != 'true':
        return [simulate(drive='delta_robot_pick_and_place')]
    for package in NEEDED:
        try:
            get_package_prefix(package)
        except PackageNotFoundError:
            raise RuntimeError(
                f"moveit:=true needs the package '{package}', which is not installed") from None
    folder = config_directory() / 'moveit'
    controllers = str(folder / 'delta_robot_controllers.yaml')
    # robot_description comes from the simulator, as a topic.
    return [
        simulate(scene='delta_robot', publish_rate='500', wait_for_command='true',
                 publish_tf='true'),
        Node(package='controller_manager', executable='ros2_control_node', output='screen',
             parameters=[controllers]),
        Node(package='controller_manager', executable='spawner', output='screen',
             arguments=[CONTROLLER, '--param-file', controllers]),
        Node(package='moveit_ros_move_group', executable='move_group', output='screen',
             parameters=[str(folder / 'delta_robot_move_group.yaml'), {
                 'robot_description_semantic': (folder / 'delta_robot.srdf').read_text()}])]


def simulate(**arguments):
    """Return the simulator, with launch arguments."""
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(ONE)), launch_arguments=arguments.items())
