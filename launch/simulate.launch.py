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
Simulate a scene, and drive, record and show it if asked to.

    ros2 launch closedloop_dynamics simulate.launch.py scene:=four_bar
    ros2 launch closedloop_dynamics simulate.launch.py drive:=three_rrr_circle rviz:=true

``ros2 launch closedloop_dynamics simulate.launch.py --show-args`` tells all arguments.

"""

from pathlib import Path

from closedloop_dynamics.config import config_directory
from closedloop_dynamics.mechanism.mechanism import MechanismError
from closedloop_dynamics.ros.simulator_parameters import SIMULATOR_PARAMETERS
from closedloop_dynamics.scene import load_scene
from closedloop_dynamics.scene import SceneError
from closedloop_dynamics.urdf import urdf
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import LogInfo
from launch.actions import OpaqueFunction
from launch.actions import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = 'closedloop_dynamics'
# Name, default and meaning of what is no parameter of the simulator.
ARGUMENTS = (
    ('drive', '', 'what drives it: a name in config/controllers or config/drives, or the path of '
     'a parameter file for both nodes, which then says the scene, too; empty: nothing'),
    ('record', 'false',
     'true: record into a bag named by the time; or the directory of a new bag'),
    ('rviz', 'false', 'true: show it in RViz; needs rviz2 and robot_state_publisher'),
    ('rate', '', 'short for publish_rate [Hz]'),
    ('namespace', '', 'of the nodes and their topics'),
    ('frame_prefix', '', 'in front of the names of frames, where several machines are shown'),
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
    nodes = [node('closedloop_simulator', values, [*files, overrides], on_exit=Shutdown())]
    if values['drive']:
        of_source = {'scene': given['scene']} if given['scene'] else {}
        nodes.append(node('closedloop_torque_source', values, [*files, of_source]))
    if values['record'].lower() != 'false':
        output = '' if values['record'].lower() == 'true' else values['record']
        nodes.append(node('closedloop_recorder', values, [{'output': output}]))
    if values['rviz'].lower() == 'true':
        nodes += shown(values, given['scene'] or scene_of(files[0]))
    return nodes


def converted(parameter, text):
    """Return the value of an argument in the type of its parameter: 200 serves as 200.0."""
    kind = type(parameter.default)
    try:
        return {'true': True, 'false': False}[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError):
        raise RuntimeError(
            f"{parameter.name}: expected {'true or false' if kind is bool else 'a number'}, got "
            f"'{text}'") from None


def node(executable, values, parameters, **options):
    """Return one of the package's nodes."""
    return Node(package=PACKAGE, executable=executable, namespace=values['namespace'],
                parameters=parameters, output='screen', **options)


def drive_file(name):
    """Return the parameter file that a drive names."""
    if name.endswith(('.yaml', '.yml')):
        return Path(name)
    places = [config_directory() / folder / f'{name}.yaml' for folder in ('controllers', 'drives')]
    for place in places:
        if place.is_file():
            return place
    known = sorted({path.stem for place in places for path in place.parent.glob('*.yaml')})
    raise RuntimeError(f"drive: expected one of {', '.join(known)}, or the path of a parameter "
                       f"file (.yaml); got '{name}'")


def scene_of(path):
    """Return the scene that a parameter file names."""
    from rclpy.parameter import parameter_dict_from_yaml_file
    parameters = parameter_dict_from_yaml_file(path, target_nodes=['/**/closedloop_simulator'])
    return parameters['scene'].value.string_value if 'scene' in parameters else 'three_rrr'


def shown(values, scene):
    """Return what shows a scene in RViz."""
    try:
        description = urdf(load_scene(scene).mechanism)
    except (SceneError, MechanismError, ValueError) as error:
        return [LogInfo(msg=f'not shown in RViz: {error}')]
    prefix = values['frame_prefix']
    publisher = Node(
        package='robot_state_publisher', executable='robot_state_publisher',
        namespace=values['namespace'], output='screen', parameters=[{
            'robot_description': ParameterValue(description, value_type=str),
            'frame_prefix': prefix}])
    viewer = Node(
        package='rviz2', executable='rviz2', namespace=values['namespace'], output='screen',
        arguments=['-d', str(config_directory() / 'rviz' / 'mechanism.rviz')])
    return [publisher] if prefix else [publisher, viewer]
