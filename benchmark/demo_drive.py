# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Drives of the demonstration, and the motion that they are to produce."""

from dataclasses import dataclass
from typing import Optional

from closedloop_dynamics.control.controller import per_joint, reference
from closedloop_dynamics.control.settings import FEEDBACK_MODES
from closedloop_dynamics.mechanism.config import shipped_names, shipped_path
from closedloop_dynamics.mechanism.kinematics import body_poses
from closedloop_dynamics.mechanism.mechanism import PRISMATIC
from closedloop_dynamics.ros.torque_source_parameters import TORQUE_SOURCE_PARAMETERS
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python

SIMULATOR, TORQUE_SOURCE, RECORDER = (
    'closedloop_simulator', 'closedloop_torque_source', 'closedloop_recorder')
# What the sines are to be like: a share of the weight times the size, slow.
SHARE_OF_TORQUE, SHARE_OF_WEIGHT = 0.1, 0.3
GRAVITY = 9.81
FREQUENCY = 0.5


@dataclass(frozen=True)
class Drive:
    """Parameters of the nodes that drive one scene."""

    description: str  # For people
    parameters: dict  # Of the torque source, by name; empty where nothing is actuated (dict)
    file: Optional[object] = None  # Where both nodes read theirs


@dataclass(frozen=True)
class Aim:
    """Where a drive is to lead the actuated joints."""

    #: References.Reference, references.CircularPath or references.PointToPointPath.
    reference: object
    #: Bool, shape (n,): Whose position is controlled; of the others, their speed is.
    led: np.ndarray
    circle: Optional[tuple] = None  # Point, centre and radius of a circle [m]
    #: Point, places that it is to reach, and the time of the first round [m, s].
    places: Optional[tuple] = None


def shipped_drives():
    """Return the names of the shipped scenes that a shipped controller is for, sorted."""
    return sorted(_controllers())


def _controllers():
    """Return the files of the shipped controllers, by the name of their scene."""
    # Of several for a scene, the first one.
    paths = [shipped_path('controllers', name) for name in reversed(shipped_names('controllers'))]
    return {_values(path, SIMULATOR)['scene']: path for path in paths}


def _values(path, node):
    """Return the parameters of a node in a file."""
    messages = parameter_dict_from_yaml_file(str(path), target_nodes=[f'/**/{node}'])
    return {name: parameter_value_to_python(message.value) for name, message in messages.items()}


def drive_for(scene):
    """Return the drive of a scene: that of its shipped controller, otherwise small sines."""
    path = _controllers().get(scene.name)
    if path is None or scene.path != shipped_path('scenes', scene.name):
        return _sines(scene)
    values = _values(path, TORQUE_SOURCE)
    return Drive(f'{values["mode"]}, as in config/controllers/{path.name}', values, path)


def _sines(scene):
    mechanism = scene.mechanism
    if not mechanism.actuated_joints:
        return Drive('nothing: no joint is actuated', {})
    weight = GRAVITY * sum(body.mass for body in mechanism.bodies)
    size = 2 if mechanism.planar else 3
    places = body_poses(mechanism, np.array(scene.initial.position))[:, :size]
    length = np.ptp(np.vstack([places, np.zeros(size)]), axis=0).max()
    amplitude = [
        float(f'{SHARE_OF_WEIGHT * weight if joint.type == PRISMATIC else torque:.2g}')
        for torque in [SHARE_OF_TORQUE * weight * length]
        for joint in (*mechanism.joints, *mechanism.cut_joints) if joint.actuated]
    shown = ', '.join(f'{value:g}' for value in amplitude)
    return Drive(f'sine torques of {shown} N m or N at {FREQUENCY} Hz',
                 {'mode': 'sine', 'amplitude': amplitude, 'frequency': [FREQUENCY]})


def aim_of(drive, scene):
    """Return where a drive is to lead the joints of a scene; None where it has no aim."""
    if drive.parameters.get('mode') not in FEEDBACK_MODES:
        return None
    values = {parameter.name: parameter.default for parameter in TORQUE_SOURCE_PARAMETERS}
    values.update(drive.parameters)
    joints = scene.mechanism.actuated_joints
    found = reference(values, joints, Simulation(scene))
    circle = places = None
    if values['circle_point']:
        circle = values['circle_point'], found.center, values['circle_radius']
    if values['path_point']:
        places = values['path_point'], found.places, found.period
    return Aim(found, np.array(per_joint('kp', values['kp'], joints)) != 0.0, circle, places)
