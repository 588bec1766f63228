# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A mechanism as hardware of ros2_control: description, control node, broadcaster and trajectories.

    ros2 launch closedloop_dynamics ros2_control.launch.py
    ros2 launch closedloop_dynamics ros2_control.launch.py scene:=delta_robot real_time_factor:=1

Writes the C of the scene, compiles it, and has closedloop_hardware simulate it within the
controller manager. The actuated joints follow joint_trajectory_controller by position, without
gains. It needs closedloop_hardware, ros2_control and ros2_controllers, and a C compiler (cc).
"""

from pathlib import Path
import shutil
import subprocess
from xml.etree import ElementTree

from ament_index_python.packages import get_package_prefix
from ament_index_python.packages import PackageNotFoundError
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
import yaml

PACKAGE = 'closedloop_dynamics'
NEEDED = ('closedloop_hardware', 'controller_manager', 'joint_state_broadcaster',
          'joint_trajectory_controller', 'robot_state_publisher')
BROADCASTER, CONTROLLER = 'joint_state_broadcaster', 'joint_trajectory_controller'
COMPILER = ('cc', '-std=c99', '-O3', '-ffp-contract=fast', '-march=native', '-fPIC', '-shared')
ARGUMENTS = (
    ('scene', 'three_rrr', 'the machine, by its name or file'),
    ('update_rate', '500', 'cycles of the controller manager per second [Hz]'),
    ('controllers', '', f'parameter file of the controllers {BROADCASTER} and {CONTROLLER}; '
     'empty: one is written, for positions of the actuated joints'),
    ('real_time_factor', '', 'simulated seconds per second: the simulation publishes /clock, '
     'which all nodes follow; empty: it follows the clock of the controller manager'),
    ('sensors', 'false', 'true: forces of the cut joints are state interfaces'),
    ('folder', '~/.ros/closedloop_dynamics', 'where C, library and description are written'),
)


def generate_launch_description():
    """Return the arguments, and what makes nodes of them."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=description)
          for name, default, description in ARGUMENTS), OpaqueFunction(function=start)])


def start(context):
    """Return the nodes that the arguments ask for."""
    scene, rate, controllers, factor, sensors, folder = (
        LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS)
    for package in NEEDED:
        try:
            get_package_prefix(package)
        except PackageNotFoundError:
            raise RuntimeError(f"this needs the package '{package}', which is not installed"
                               ) from None
    if shutil.which(COMPILER[0]) is None:
        raise RuntimeError(f"this needs a C compiler, called '{COMPILER[0]}': apt install gcc")
    folder = Path(folder).expanduser()
    folder.mkdir(parents=True, exist_ok=True)
    robot = described(scene, sensors.lower() == 'true', folder)
    if factor:
        hardware = robot.find('ros2_control/hardware')
        for name, value in (('period', 1.0 / float(rate)), ('real_time_factor', factor)):
            ElementTree.SubElement(hardware, 'param', name=name).text = f'{value}'
    if not controllers:
        controllers = folder / f'{Path(scene).stem}.controllers.yaml'
        controllers.write_text(yaml.safe_dump(parameters(robot, int(rate)), sort_keys=False))
    clock = {'use_sim_time': bool(factor)}
    return [
        Node(package='robot_state_publisher', executable='robot_state_publisher', output='screen',
             parameters=[{'robot_description': ElementTree.tostring(robot, 'unicode')}, clock]),
        Node(package='controller_manager', executable='ros2_control_node', output='screen',
             parameters=[str(controllers), clock]),
        Node(package='controller_manager', executable='spawner', output='screen',
             arguments=[BROADCASTER, CONTROLLER, '--param-file', str(controllers)])]


def described(scene, sensors, folder):
    """Return the robot description of a scene whose C is compiled in a folder."""
    program = Path(get_package_prefix(PACKAGE)) / 'lib' / PACKAGE / 'closedloop'
    model, library, description = (
        folder / f'{Path(scene).stem}.{ending}' for ending in ('c', 'so', 'urdf'))
    run(program, 'export', scene, '--output', model, '--overwrite')
    run(*COMPILER, '-o', library, model, '-lm')
    run(program, 'urdf', scene, '--hardware', library, *['--sensors'] * sensors, '--output',
        description, '--overwrite')
    return ElementTree.parse(description).getroot()


def run(*command):
    """Run a command; raise with what it wrote where it fails."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f'{" ".join(map(str, command))}: {done.stderr.strip()}')


def parameters(robot, rate):
    """Return parameters of the controllers that lead all joints by their positions."""
    joints = [joint.get('name') for joint in robot.findall('ros2_control/joint')
              if joint.find('command_interface') is not None]
    return {
        'controller_manager': {'ros__parameters': {
            'update_rate': rate,
            BROADCASTER: {'type': f'{BROADCASTER}/JointStateBroadcaster'},
            CONTROLLER: {'type': f'{CONTROLLER}/JointTrajectoryController'}}},
        CONTROLLER: {'ros__parameters': {
            'joints': joints, 'command_interfaces': ['position'],
            'state_interfaces': ['position', 'velocity']}}}
