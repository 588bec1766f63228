# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Simulate a scene, and drive, record and show it if asked to.

    ros2 launch closedloop_dynamics simulate.launch.py scene:=four_bar
    ros2 launch closedloop_dynamics simulate.launch.py drive:=three_rrr_circle rviz:=true

``ros2 launch closedloop_dynamics simulate.launch.py --show-args`` lists all arguments.
"""

from pathlib import Path

from ament_index_python.packages import get_package_prefix
from ament_index_python.packages import PackageNotFoundError
from closedloop_dynamics.mechanism.config import config_directory
# Names only: this runs in the Python of ros2, which may lack what the nodes compute with.
from closedloop_dynamics.ros.simulator_parameters import SIMULATOR_PARAMETERS
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import OpaqueFunction
from launch.actions import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
import yaml

PACKAGE = 'closedloop_dynamics'
# Modes of the torque source that look at no states.
OPEN_LOOP = {'constant', 'sine'}
# Name, default and meaning of what is not a parameter of the simulator.
ARGUMENTS = (
    ('drive', '', 'what drives it: a name in config/controllers, or the path of a '
     'parameter file for both nodes, which then says the scene, too; empty: nothing'),
    ('record', 'false',
     'true: record into a bag named by the time; or the directory of a new bag'),
    ('rviz', 'false', 'true: show it in RViz; needs rviz2'),
    ('publish_tf', 'false', 'true: broadcast the frames of all links on /tf'),
    ('rate', '', 'short for publish_rate [Hz]'),
    ('namespace', '', 'of the nodes and their topics'),
    ('frame_prefix', '', 'in front of the names of frames, where several machines are shown: RViz '
     'and the places of their worlds, by tf2_ros, are then left to whoever includes this'),
    ('marker_frame', 'world', 'frame of the markers'),
)


def generate_launch_description():
    """Return the arguments, and what makes nodes of them."""
    declared = [DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS]
    # Not given: what the parameter file of the drive says, or the node's own default.
    declared += [DeclareLaunchArgument(
        parameter.name, default_value='',
        description=f'{parameter.description} Default: {parameter.default!r}.')
        for parameter in SIMULATOR_PARAMETERS]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def start(context):
    """Return the nodes that the arguments ask for."""
    values = {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    given = {parameter.name: LaunchConfiguration(parameter.name).perform(context)
             for parameter in SIMULATOR_PARAMETERS}
    given['publish_rate'] = given['publish_rate'] or values['rate']
    files = []
    if values['drive']:
        files.append(str(drive_file(values['drive'])))
    elif not given['scene']:
        given['scene'] = 'three_rrr'
    overrides = {parameter.name: converted(parameter, given[parameter.name])
                 for parameter in SIMULATOR_PARAMETERS if given[parameter.name]}
    overrides['marker_frame'] = values['marker_frame']
    overrides['frame_prefix'] = values['frame_prefix']
    shown = values['rviz'].lower() == 'true'
    if shown:
        # Looked for before anything starts, so that nothing is left running.
        require('rviz:=true', 'rviz2', *(['tf2_ros'] if values['frame_prefix'] else []))
    if shown or values['publish_tf'].lower() == 'true':
        overrides['publish_tf'] = True
    recorded = values['record'].lower() != 'false'
    if recorded:
        # The recorder is to miss no motion, and no command.
        overrides.setdefault('wait_for_subscribers', 1 + listens(files))
    nodes = [node('closedloop_simulator', values, [*files, overrides])]
    if values['drive']:
        of_source = {'scene': given['scene']} if given['scene'] else {}
        if recorded:
            of_source['wait_for_subscribers'] = 2
        nodes.append(node('closedloop_torque_source', values, [*files, of_source]))
    if recorded:
        output = '' if values['record'].lower() == 'true' else values['record']
        nodes.append(node('closedloop_recorder', values, [{'output': output}]))
    if shown and not values['frame_prefix']:
        nodes.append(Node(
            package='rviz2', executable='rviz2', namespace=values['namespace'], output='screen',
            arguments=['-d', str(config_directory() / 'rviz' / 'mechanism.rviz')]))
    return nodes


def require(argument, *packages):
    """Raise where packages that an argument needs are not installed."""
    for package in packages:
        try:
            get_package_prefix(package)
        except PackageNotFoundError:
            raise RuntimeError(
                f"{argument} needs the package '{package}', which is not installed") from None


def converted(parameter, text):
    """Return the value of an argument in the type of its parameter: 200 serves as 200.0."""
    kind = type(parameter.default)
    try:
        if kind is list:
            value = yaml.safe_load(text)
            if not isinstance(value, list):
                raise ValueError
            return value
        return {'true': True, 'false': False}[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError, yaml.YAMLError):
        expected = {bool: 'true or false', list: 'a list (write [name_1, name_2])'}
        raise RuntimeError(f"{parameter.name}: expected {expected.get(kind, 'a number')}, got "
                           f"'{text}'") from None


def node(executable, values, parameters):
    """Return one of the package's nodes, with which the launch ends."""
    def end(event, context):
        # What is left is of no use without it, and nobody would notice. An exception is how a
        # launch ends with an exit code other than 0.
        if event.returncode != 0:
            raise RuntimeError(f'{executable} ended with exit code {event.returncode}')
        return Shutdown(reason=f'{executable} ended')

    return Node(package=PACKAGE, executable=executable, namespace=values['namespace'],
                parameters=parameters, output='screen', on_exit=end)


def listens(files):
    """Return whether a torque source with parameters in files subscribes to joint_states."""
    modes = [values['ros__parameters']['mode'] for path in files
             for name, values in yaml.safe_load(Path(path).read_text()).items()
             if name.endswith('torque_source') and 'mode' in values['ros__parameters']]
    return bool(set(modes) - OPEN_LOOP)


def drive_file(name):
    """Return the parameter file that a drive names."""
    if name.endswith(('.yaml', '.yml')):
        return Path(name)
    folder = config_directory() / 'controllers'
    if (folder / f'{name}.yaml').is_file():
        return folder / f'{name}.yaml'
    known = sorted(path.stem for path in folder.glob('*.yaml'))
    raise RuntimeError(f"drive: expected one of {', '.join(known)}, or the path of a parameter "
                       f"file (.yaml); got '{name}'")
