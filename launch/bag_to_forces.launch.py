# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The torques and joint forces that a recorded motion takes: a bag in, a bag out.

    ros2 launch closedloop_dynamics bag_to_forces.launch.py bag:=my_bag scene:=three_rrr
    ros2 launch closedloop_dynamics bag_to_forces.launch.py

Without a bag, five seconds of the 3-RRR on its circle are recorded first, into the bag motion.
doc/examples_forces.md looks at what comes out.
"""

from pathlib import Path
import signal

from ament_index_python.packages import get_package_prefix
from closedloop_dynamics.mechanism.config import config_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import EmitEvent
from launch.actions import ExecuteProcess
from launch.actions import OpaqueFunction
from launch.actions import RegisterEventHandler
from launch.actions import Shutdown
from launch.actions import TimerAction
from launch.event_handlers import OnProcessExit
from launch.event_handlers import OnProcessIO
from launch.events import matches_action
from launch.events.process import SignalProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = 'closedloop_dynamics'
DRIVE = 'three_rrr_circle'
RECORDED, DURATION = 'motion', 5.0
ARGUMENTS = (
    ('bag', '', f'with joint_states; empty: {DURATION:g} s of a motion are recorded first'),
    ('scene', 'three_rrr', 'the machine, by its name or file'),
    ('deviation', '0', 'standard deviation of a measured position [rad or m]'),
    ('output', 'forces', 'the new bag, or a file *.csv'),
)


def generate_launch_description():
    """Return the arguments, and what makes processes of them."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=description)
          for name, default, description in ARGUMENTS), OpaqueFunction(function=start)])


def start(context):
    """Return what is recorded, if anything is, and what finds the forces then."""
    bag, scene, deviation, output = (
        LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS)

    def end(event, context):
        if event.returncode != 0:
            raise RuntimeError(f'closedloop forces ended with exit code {event.returncode}')
        return Shutdown(reason=f'forces are in {output}')

    program = Path(get_package_prefix(PACKAGE)) / 'lib' / PACKAGE / 'closedloop'
    forces = ExecuteProcess(
        cmd=[str(program), 'forces', bag or RECORDED, '--scene', scene, '--deviation', deviation,
             '--output', output], output='screen', on_exit=end)
    if bag:
        return [forces]
    drive = str(config_directory() / 'controllers' / f'{DRIVE}.yaml')
    simulator, source = (
        Node(package=PACKAGE, executable=executable, parameters=[drive, values], output='screen')
        for executable, values in (('closedloop_simulator', {'wait_for_subscribers': 2}),
                                   ('closedloop_torque_source', {'wait_for_subscribers': 2})))
    recorder = Node(package=PACKAGE, executable='closedloop_recorder', output='screen',
                    parameters=[{'output': RECORDED}])
    stop = EmitEvent(event=SignalProcess(
        signal_number=signal.SIGINT, process_matcher=matches_action(recorder)))

    def begun(event):
        # Starting takes as long as it takes: the motion counts from its first state.
        if b'/joint_states: first message' in event.text:
            return TimerAction(period=DURATION, actions=[stop])
        return None

    def recorded(event, context):
        if event.returncode != 0:
            raise RuntimeError(f'closedloop_recorder ended with exit code {event.returncode}')
        return forces

    return [simulator, source, recorder,
            RegisterEventHandler(OnProcessIO(
                target_action=recorder, on_stdout=begun, on_stderr=begun)),
            RegisterEventHandler(OnProcessExit(target_action=recorder, on_exit=recorded))]
