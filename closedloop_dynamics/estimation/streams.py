# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Measurements in messages and in columns of files, by the sensors that they are of.

Messages of rclpy and of bags have the same attributes; nothing of ROS is imported here.
"""

import math

from .sensors import (
    ForceSensor, ImuSensor, JointSensor, PointSensor, PoseSensor, POSITION, RATE, TORQUE,
    WrenchSensor)
from ..mechanism.checks import ROUNDED_NORM
from ..mechanism.fields import FieldError
from ..mechanism.mechanism import REVOLUTE
from ..recording.message_numbers import constraint_force, stamp_of, vector

STATE, IMU, POSE, WRENCH = (
    'sensor_msgs/msg/JointState', 'sensor_msgs/msg/Imu', 'geometry_msgs/msg/PoseStamped',
    'geometry_msgs/msg/WrenchStamped')
STATES = 'joint_states'
TURN = 2.0 * math.pi
MESSAGES = {JointSensor: STATE, ImuSensor: IMU, PointSensor: POSE, PoseSensor: POSE,
            ForceSensor: WRENCH, WrenchSensor: WRENCH}
# Where a JointState has the quantities of a joint.
FIELDS = {POSITION: 'position', RATE: 'velocity', TORQUE: 'effort'}


def topics_of(setup):
    """Return the topics of sensors by their names: as given, or as they are where none is."""
    return {one.name: setup.topics.get(one.name, STATES if MESSAGES[type(one)] == STATE
                                       else one.name) for one in setup.sensors}


class StreamError(ValueError):
    """A message that cannot be used; the message says why."""


class Streams:
    """
    Finds measurements and torques in messages.

    Parameters
    ----------
    setup : setup_file.Setup
    mechanism : mechanism.mechanism.Mechanism

    Attributes
    ----------
    topics : dict of str to str
        Types of messages by the topics that they come on.
    sensors : dict of str to list of sensors.Sensor
        Those that are read from a topic.

    """

    def __init__(self, setup, mechanism):
        self._names, self._planar = setup.names, mechanism.planar
        self._driven = frozenset(mechanism.actuated_joints)
        self._turning = frozenset(joint.name for joint in (
            *mechanism.joints, *mechanism.cut_joints) if joint.type == REVOLUTE)
        self.sensors, self.topics, topics = {}, {STATES: STATE}, topics_of(setup)
        for sensor in setup.sensors:
            topic, kind = topics[sensor.name], MESSAGES[type(sensor)]
            if not topic.strip('/') or self.topics.get(topic, kind) != kind:
                raise FieldError(f'a topic of {kind} alone', repr(topic), '',
                                 ('topics', sensor.name))
            self.sensors.setdefault(topic, []).append(sensor)
            self.topics[topic] = kind
        self._latest, self._angles = {}, {}

    def begin(self, angles):
        """Begin a run; ``angles``: by joint, next to which angles are taken [rad]."""
        self._latest, self._angles = {}, dict(angles)

    def measurements(self, topic, message):
        """
        Return names of sensors and their values in a message, as ``Estimator.measure`` takes them.

        Of a message that comes again with its stamp there is nothing. StreamError where the
        message makes no sense.
        """
        return self.taken(topic, stamp_of(message), self.readings(topic, message))

    def readings(self, topic, message):
        """
        Return sensors and their values in a message, which changes nothing yet.

        What is NaN was not measured. StreamError where the message makes no sense.
        """
        sensors = self.sensors.get(topic, ())
        if self.topics[topic] == STATE:
            found = self._of_joints(sensors, message)
        else:
            found = [(sensor, self._finite(sensor, READERS[type(sensor)](
                message, self._planar))) for sensor in sensors]
        return [(sensor, values) for sensor, values in found if not any(map(math.isnan, values))]

    def taken(self, topic, stamp, readings):
        """Return names and values of readings with a stamp, as ``measurements`` does."""
        if not readings or self._latest.get(topic) == stamp:
            return []
        self._latest[topic] = stamp
        return [(sensor.name, self.unwound(sensor, *values) if isinstance(
            sensor, JointSensor) else values)
                for sensor, values in readings]

    def _of_joints(self, sensors, message):
        places = self._places(message)
        if sensors and not any(sensor.joint in places for sensor in sensors):
            raise StreamError(
                f"it names none of {', '.join(sensor.joint for sensor in sensors)}, but "
                f"{', '.join(message.name) or 'nothing'}")
        found = []
        for sensor in sensors:
            values = getattr(message, FIELDS[sensor.quantity])
            if sensor.joint in places and len(values):
                found.append((sensor, self._finite(sensor, (values[places[sensor.joint]],))))
        return found

    def unwound(self, sensor, value):
        """Return a reading of a joint; of an angle what is next to the reading before."""
        if sensor.quantity != POSITION or sensor.joint not in self._turning:
            return (value,)
        before = self._angles.get(sensor.joint, value)
        value -= TURN * round((value - before) / TURN)
        self._angles[sensor.joint] = value
        return (value,)

    @staticmethod
    def _finite(sensor, values):
        if any(map(math.isinf, values)):
            raise StreamError(f'{sensor.name}: expected finite numbers, or NaN where nothing is '
                              f'measured, got {list(values)}')
        return tuple(map(float, values))

    def torques(self, message):
        """Return the efforts of actuated joints in a JointState by name, without NaN."""
        found = {name: float(message.effort[place])
                 for name, place in self._places(message).items()
                 if name in self._driven and len(message.effort)}
        for name, value in found.items():
            if math.isinf(value):
                raise StreamError(f"the effort of '{name}' is {value}, not a finite number")
        return {name: value for name, value in found.items() if not math.isnan(value)}

    def _places(self, message):
        """Return where each joint is in a JointState; StreamError where it makes no sense."""
        names = [self._names.get(name, name) for name in message.name]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise StreamError(f"'{twice}' is named twice")
        for key in ('position', 'velocity', 'effort'):
            count = len(getattr(message, key))
            if count not in (0, len(names)):
                raise StreamError(f'expected no {key}, or one per name, got {count} for '
                                  f'{len(names)} names')
        return {name: place for place, name in enumerate(names)}


def _of_imu(message, planar):
    spin, force = vector(message.angular_velocity), vector(message.linear_acceleration)
    return (spin[2], *force[:2]) if planar else (*spin, *force)


def _of_pose(message, planar):
    place, turn = message.pose.position, message.pose.orientation
    quaternion = *vector(turn), turn.w
    if not abs(math.hypot(*quaternion) - 1.0) <= ROUNDED_NORM and not math.isnan(turn.w):
        raise StreamError(f'expected a unit quaternion, got {list(quaternion)}')
    if planar:
        return place.x, place.y, 2.0 * math.atan2(turn.z, turn.w)
    return *vector(place), *quaternion


READERS = {
    ImuSensor: _of_imu,
    PointSensor: lambda message, planar: vector(message.pose.position)[:2 if planar else 3],
    PoseSensor: _of_pose,
    ForceSensor: lambda message, planar: vector(message.wrench.force)[:2 if planar else 3],
    WrenchSensor: lambda message, planar: constraint_force(message.wrench, planar)}


def columns(sensor, planar):
    """Return the names of the columns of a sensor's readings in CSV files."""
    if isinstance(sensor, JointSensor):
        return (f'{FIELDS[sensor.quantity]}.{sensor.joint}',)
    parts = sensor.components(planar)
    if isinstance(sensor, PoseSensor) and not planar:
        parts = 'x', 'y', 'z', 'qx', 'qy', 'qz', 'qw'
    # Points and forces as `closedloop simulate` calls them.
    of = (f'point.{sensor.point}' if isinstance(sensor, PointSensor) else
          f'force.{sensor.joint}' if isinstance(sensor, ForceSensor) else sensor.name)
    return tuple(f'{of}.{part.replace("moment", "torque")}' for part in parts)
