# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A machine and its live twin: an unknown load, found from encoders with noise and delay.

    ros2 launch closedloop_dynamics estimation.launch.py
    ros2 launch closedloop_dynamics estimation.launch.py rviz:=true

The simulator stands for the machine: a 3-RRR on its circle with a part in its gripper that the
estimator's scene does not have, and encoders with noise, steps and a delay. The estimator, in the
namespace twin, finds the part's weight. A browser shows both: closedloop_viewer logs the address.
doc/estimation.md explains what is seen.
"""

from pathlib import Path

from ament_index_python.packages import get_package_prefix
from closedloop_dynamics.mechanism.config import config_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import IncludeLaunchDescription
from launch.actions import OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE, TWIN = 'closedloop_dynamics', 'twin'
ONE = Path(__file__).resolve().parent / 'simulate.launch.py'
FOLDER = config_directory() / 'estimation'
ARGUMENTS = (
    ('machine', str(FOLDER / 'three_rrr_machine.yaml'),
     'scene of the machine, with its true loads and the errors of its encoders'),
    ('scene', 'three_rrr', 'scene that the estimator knows'),
    ('sensors', str(FOLDER / 'three_rrr_sensors.yaml'), 'sensors and unknowns of the estimator'),
    ('drive', 'three_rrr_circle', 'what drives the machine, as in simulate.launch.py'),
    ('mode', 'realtime', 'realtime or lockstep, of simulator and estimator'),
    ('record', 'false', 'true: record into a bag named by the time; or a new directory'),
    ('view', 'true', 'false: no page for a browser'),
    ('rviz', 'false', 'true: show both machines in RViz; needs rviz2'),
)


def generate_launch_description():
    """Return the arguments, and what makes nodes of them."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=description)
          for name, default, description in ARGUMENTS), OpaqueFunction(function=start)])


def start(context):
    """Return the machine, its estimator, and what shows both."""
    values = {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    shown, viewed = (values[name].lower() == 'true' for name in ('rviz', 'view'))
    if shown:
        # Looked for before anything starts, so that nothing is left running.
        get_package_prefix('rviz2')
    entities = [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(ONE)), launch_arguments={
                'scene': values['machine'], 'drive': values['drive'], 'mode': values['mode'],
                'record': values['record']}.items()),
        Node(package=PACKAGE, executable='closedloop_estimator', namespace=TWIN, output='screen',
             parameters=[{key: values[key] for key in ('scene', 'sensors', 'mode')}],
             remappings=[(topic, f'/{topic}') for topic in (
                 'joint_states', 'multi_dof_joint_states', 'torque_command', 'joint_command')])]
    if viewed:
        entities.append(Node(
            package=PACKAGE, executable='closedloop_viewer', output='screen',
            parameters=[{'nodes': ['/closedloop_simulator'],
                         'estimator': f'/{TWIN}/closedloop_estimator'}]))
    if shown:
        entities.append(Node(
            package='rviz2', executable='rviz2', output='screen',
            arguments=['-d', str(config_directory() / 'rviz' / 'estimation.rviz')]))
    return entities
