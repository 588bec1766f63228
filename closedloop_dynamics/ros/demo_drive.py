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

"""What drives a scene in the demonstration, and where that was to lead it."""

from dataclasses import dataclass

from closedloop_dynamics.config import config_directory, shipped_path
from closedloop_dynamics.mechanism.mechanism import PRISMATIC
from closedloop_dynamics.ros.torque_source_parameters import closed_loop
from closedloop_dynamics.ros.torque_source_parameters import TORQUE_SOURCE_PARAMETERS
from closedloop_dynamics.studies.motion import body_poses
import numpy as np
from rclpy.parameter import parameter_dict_from_yaml_file
from rclpy.parameter import parameter_value_to_python

SIMULATOR, TORQUE_SOURCE, RECORDER = (
    'closedloop_simulator', 'closedloop_torque_source', 'closedloop_recorder')
FEEDBACK_MODES = ('pd', 'computed_torque')
# For scenes without a drive of their own: sines of this share of the torque that holds the
# whole weight at the length of the mechanism, or of the weight.
SHARE_OF_TORQUE, SHARE_OF_WEIGHT = 0.1, 0.3
GRAVITY = 9.81
FREQUENCY = 0.5


@dataclass(frozen=True)
class Drive:
    """
    Parameters of the nodes that drive one scene.

    Attributes
    ----------
    description : str
        For people.
    parameters : dict
        Of the torque source, by name; empty where nothing is actuated.
    arguments : tuple of str
        The same, as ROS arguments of the torque source.
    simulator_arguments : tuple of str
        Those of the simulator.

    """

    description: str
    parameters: dict
    arguments: tuple = ()
    simulator_arguments: tuple = ()


def shipped_drives():
    """Return the names of the scenes that have a drive of their own, sorted."""
    return sorted(path.stem for path in (config_directory() / 'drives').glob('*.yaml'))


def drive_for(scene):
    """
    Return the drive of a scene: its own if it is a shipped one, otherwise small sines.

    Parameters
    ----------
    scene : scene.Scene
        What is to be driven.

    Returns
    -------
    Drive

    """
    path = shipped_path('drives', scene.name)
    if scene.path != shipped_path('scenes', scene.name) or not path.is_file():
        return _sines(scene)
    messages = parameter_dict_from_yaml_file(str(path), target_nodes=[f'/**/{TORQUE_SOURCE}'])
    values = {name: parameter_value_to_python(message.value)
              for name, message in messages.items()}
    # The file has a part for each of them.
    arguments = ('--params-file', str(path))
    return Drive(f'{values["mode"]}, as in config/drives/{path.name}', values, arguments,
                 arguments)


def _sines(scene):
    mechanism = scene.mechanism
    if not mechanism.actuated_joints:
        return Drive('nothing: no joint is actuated', {})
    weight = GRAVITY * sum(body.mass for body in mechanism.bodies)
    places = body_poses(mechanism, np.array(scene.initial.position))[:, :2]
    length = np.ptp(np.vstack([places, (0.0, 0.0)]), axis=0).max()
    amplitude = [
        float(f'{SHARE_OF_WEIGHT * weight if joint.type == PRISMATIC else torque:.2g}')
        for torque in [SHARE_OF_TORQUE * weight * length]
        for joint in mechanism.joints if joint.actuated]
    shown = ', '.join(f'{value:g}' for value in amplitude)
    values = {'mode': 'sine', 'amplitude': amplitude, 'frequency': [FREQUENCY]}
    arguments = [part for name, value in values.items() for part in ('-p', f'{name}:={value}')]
    return Drive(f'sine torques of {shown} N m or N at {FREQUENCY} Hz', values, tuple(arguments),
                 ('-p', 'wait_for_command:=true'))


def aim_of(drive, joints):
    """
    Return where a drive was to lead the joints.

    Parameters
    ----------
    drive : Drive
        Of the scene.
    joints : sequence of str
        The actuated ones.

    Returns
    -------
    torque_laws.ProportionalDerivative or None
        The law with its reference; None where it has no aim.

    """
    if drive.parameters.get('mode') not in FEEDBACK_MODES:
        return None
    values = {parameter.name: parameter.default for parameter in TORQUE_SOURCE_PARAMETERS}
    return closed_loop({**values, **drive.parameters}, joints)
