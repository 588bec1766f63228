# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Messages of a state: joint states, constraint forces and the time.

Converting a message from Python takes longer than all the rest of publishing it. So messages are
serialised once, the places of their numbers among the bytes are looked up by values put there
to be found, and the numbers are written directly from then on. Where that does not work
(another middleware, another encoding), a message is converted as ever.
"""

from array import array
from functools import partial
import re
import struct
import time

from builtin_interfaces.msg import Time
from closedloop_dynamics.recording.message_numbers import NANOSECONDS
from closedloop_dynamics.ros.process import StartError
from geometry_msgs.msg import Transform
from geometry_msgs.msg import Twist
from geometry_msgs.msg import Wrench
from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from sensor_msgs.msg import MultiDOFJointState

# A stamp that is found only where it was put: seconds and nanoseconds.
_STAMP = struct.Struct('=iI')
_MARK = (0x2F3A91C5, 0x1B7D4E63)
# For subscribers to receive published messages: longest single wait, and total wait [s].
PATIENCE, GIVE_UP = Duration(seconds=0.02), 2.0
# Where the components of a wrench, moment first, are in a message, in the plane and in space.
_COMPONENTS = {3: np.array([5, 0, 1]), 6: np.array([3, 4, 5, 0, 1, 2])}
# Topics of an estimator: its states, joints with an orientation, and standard deviations.
ESTIMATED, ESTIMATED_TURNS, DEVIATIONS = (
    'estimated_joint_states', 'estimated_multi_dof_joint_states', 'estimated_joint_deviations')
# A reliable subscriber that stalls for a second at 1 kHz still gets everything.
STATE_QOS = QoSProfile(depth=1000)
# Whoever comes late gets the latest, too.
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class SerializedTemplate:
    """
    A message with stamps, in one or several headers, and blocks of numbers of some sizes.

    ``build(stamp_sec, stamp_nanosec, *blocks)`` returns the message, blocks being arrays.
    """

    def __init__(self, build, sizes):
        self._build = build
        rng = np.random.default_rng(1)
        marks = [rng.uniform(1e100, 1e101, size) for size in sizes]
        self._data = bytearray(serialize_message(build(*_MARK, *marks)))
        self._stamps = self.positions_of(_STAMP.pack(*_MARK))
        places = [self.positions_of(mark.tobytes()) for mark in marks if len(mark)]
        self.direct = bool(self._stamps) and all(len(found) == 1 for found in places)
        if self.direct:
            offsets = iter(place for place, in places)
            self._blocks = [np.frombuffer(self._data, count=size, offset=next(offsets))
                            if size else np.zeros(0) for size in sizes]
            # What was looked for is not to be published by mistake.
            self.filled(0, 0, *(np.full(size, np.nan) for size in sizes))

    def positions_of(self, mark):
        """Return where a mark is among the bytes."""
        return [match.start() for match in re.finditer(re.escape(mark), self._data)]

    def filled(self, sec, nanosec, *blocks):
        """Return the message with a stamp and blocks of numbers, ready to be published."""
        if not self.direct:
            return self._build(sec, nanosec, *blocks)
        for place in self._stamps:
            _STAMP.pack_into(self._data, place, sec, nanosec)
        for place, block in zip(self._blocks, blocks):
            place[:] = block
        return bytes(self._data)


class Stamps:
    """
    The time for the next messages: that of a node's clock, or simulated; and ``/clock``.

    ``simulated`` says which of the two, ``publish_clock`` whether simulated time is published.
    It then begins at ``period`` [s], as nodes of rclcpp take a clock at zero for one that has not
    begun. ros2_control waits for the next period, too, before it sends the first command.
    """

    def __init__(self, node, simulation, simulated, publish_clock, period):
        self._source, self._simulation, self.simulated = node.get_clock(), simulation, simulated
        self._period = round(period * NANOSECONDS) if publish_clock else 0
        self._begin = self._period
        self._clock = SerializedTemplate(
            lambda sec, nanosec: Clock(clock=Time(sec=sec, nanosec=nanosec)), ())
        self._publisher = node.create_publisher(
            Clock, '/clock', QoSProfile(depth=10)) if publish_clock else None

    @property
    def simulated_nanoseconds(self):
        """Return the stamp of the simulated time [ns]."""
        return self._begin + round(self._simulation.time * NANOSECONDS)

    def let_period_pass(self):
        """Advance the clock by a period, if there is one, but not simulated time."""
        self._begin += self._period

    def simulated_time(self, nanoseconds):
        """Return the simulated time [s] of a simulated stamp [ns]."""
        return (nanoseconds - self._begin) / NANOSECONDS

    def now(self):
        """Return the stamp of the messages published now [ns]."""
        if self.simulated:
            return self.simulated_nanoseconds
        return self._source.now().nanoseconds

    def earlier(self, late, last):
        """
        Return the stamp for a state that was due ``late`` s ago [ns].

        It does not precede ``last``, the stamp of the state before, unless the clock was set back.
        """
        now = self.now()
        # A clock that somebody else publishes runs as it likes.
        if self.simulated or self._source.ros_time_is_active:
            return now
        stamp = now - max(0, round(late * NANOSECONDS))
        # Unless the clock itself was set back.
        return last + 1 if last is not None and stamp <= last <= now else stamp

    def message(self):
        """Return the same as a message."""
        sec, nanosec = divmod(self.now(), NANOSECONDS)
        return Time(sec=sec, nanosec=nanosec)

    def publish(self):
        """Publish the simulated time, if requested."""
        if self._publisher is not None:
            self._publisher.publish(
                self._clock.filled(*divmod(self.simulated_nanoseconds, NANOSECONDS)))


class StatePublisher:
    """
    Publishes one JointState and one WrenchStamped per cut joint, and others, with one stamp.

    Joints with an orientation go into a MultiDOFJointState, where there are such. ``wrenches``:
    topics of wrenches, in their order: ``constraint_forces/CUT``; ``frames`` that these refer to;
    ``cuts``: coordinates of cut joints, which follow those of the tree; ``prefix`` of the names of
    the topics of joints; ``others``, by topic: what a JointState beside those of the joints names,
    with efforts.

    ``stamp``: of the latest messages; ``published``: messages so far. StartError if the name of a
    joint cannot be part of a topic's name.
    """

    def __init__(self, node, coordinates, wrenches, frames, cuts=None, others=None, prefix=''):
        self.stamp, self.published = Time(), 0
        self._stuck_since = None
        # Of the tree, then of the cut joints.
        self._parts = [part for part in (coordinates, cuts) if part is not None and (
            part is coordinates or part.names)]
        self._names = [name for part in self._parts for name in part.single_names]
        self._turned_names = [name for part in self._parts for name in part.with_orientation]
        self._state = SerializedTemplate(
            partial(joint_state, self._names), 3 * [len(self._names)])
        self._others = [
            (node.create_publisher(JointState, topic, STATE_QOS),
             SerializedTemplate(partial(_joint_efforts, list(names)), [len(names)]))
            for topic, names in (others or {}).items()]
        self._turned = None
        count = len(self._turned_names)
        if count:
            self._turned = SerializedTemplate(
                self.multi_dof_joint_state, [7 * count, 6 * count, 6 * count])
            self.orientation_publisher = node.create_publisher(
                MultiDOFJointState, f'{prefix}multi_dof_joint_states', STATE_QOS)
        self.templates = [
            SerializedTemplate(partial(wrench_stamped, frame), (6,)) for frame in frames]
        # All wrenches as the messages have them: force, then torque.
        self._wrenches = np.zeros((len(wrenches), 6))
        self.state_publisher = node.create_publisher(
            JointState, f'{prefix}joint_states', STATE_QOS)
        try:
            self.force_publishers = [
                node.create_publisher(WrenchStamped, topic, STATE_QOS) for topic in wrenches]
        except InvalidTopicNameException:
            raise StartError(
                'the name of a joint becomes part of a topic name, so it must be letters, '
                'digits and underscores, not beginning with a digit; got '
                f'{list(wrenches)}') from None

    def multi_dof_joint_state(self, sec, nanosec, poses, twists, wrenches):
        """Return a MultiDOFJointState of arrays of 7, 6 and 6 numbers for each joint in it."""
        message = MultiDOFJointState(joint_names=list(self._turned_names))
        message.header.stamp = Time(sec=sec, nanosec=nanosec)
        for numbers in poses.reshape(-1, 7).tolist():
            pose = Transform()
            place, turn = pose.translation, pose.rotation
            place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = numbers
            message.transforms.append(pose)
        for numbers in twists.reshape(-1, 6).tolist():
            twist = Twist()
            fill(twist.linear, twist.angular, numbers)
            message.twist.append(twist)
        for numbers in wrenches.reshape(-1, 6).tolist():
            wrench = Wrench()
            fill(wrench.force, wrench.torque, numbers)
            message.wrench.append(wrench)
        return message

    def publish(self, nanoseconds, position, velocity, effort, wrenches, cuts=(),
                *others):
        """
        Publish a state, of a stamp in nanoseconds.

        ``position``, shape (nq,) [rad or m]; ``velocity`` and ``effort``, shape (nv,) [per s; N m
        or N]; ``wrenches``, shape (number of them, 3 or 6): torque about z [N m], force along x
        and y [N], in space torque about and force along x, y and z; ``cuts``: the same three of
        the cut joints, none where there are none; ``others``: efforts of each of the other topics.
        """
        sec, nanosec = divmod(nanoseconds, NANOSECONDS)
        self.stamp.sec, self.stamp.nanosec = sec, nanosec
        self._wrenches[:, _COMPONENTS[wrenches.shape[1]]] = wrenches
        # The state last: a controller that answers it has the forces.
        for publisher, message, wrench in zip(
                self.force_publishers, self.templates, self._wrenches):
            publisher.publish(message.filled(sec, nanosec, wrench))
        for (publisher, message), efforts in zip(self._others, others):
            publisher.publish(message.filled(sec, nanosec, efforts))
        states = [(position, velocity, effort), cuts][:len(self._parts)]
        if self._turned is not None:
            self.orientation_publisher.publish(self._turned.filled(sec, nanosec, *map(
                np.concatenate, zip(*map(_turns, self._parts, states)))))
            states = list(map(_single, self._parts, states))
            self.published += 1
        position, velocity, effort = states[0] if len(states) == 1 else map(
            np.concatenate, zip(*states))
        self.state_publisher.publish(
            self._state.filled(sec, nanosec, position, velocity, effort))
        self.published += 1 + len(self.force_publishers) + len(self._others)

    @property
    def subscribers(self):
        """Return how many subscribe to joint_states."""
        return self.state_publisher.get_subscription_count()

    def is_received(self):
        """
        Return whether reliable subscribers have received everything, waiting a little for it.

        Of one that does not answer for long, such as a process that was stopped, it is no longer
        expected.
        """
        now = time.monotonic()
        turned = () if self._turned is None else (self.orientation_publisher,)
        if all(publisher.wait_for_all_acked(PATIENCE)
               for publisher in (self.state_publisher, *turned, *self.force_publishers,
                                 *(publisher for publisher, _ in self._others))):
            self._stuck_since = None
            return True
        self._stuck_since = self._stuck_since or now
        return now - self._stuck_since > GIVE_UP


def _turns(coordinates, state):
    """Return poses, twists and wrenches of the joints with an orientation, one by one."""
    position, velocity, effort = state
    return (coordinates.poses(position).ravel(), coordinates.twists(velocity).ravel(),
            coordinates.twists(effort).ravel())


def _single(coordinates, state):
    """Return positions, velocities and efforts of joints with one coordinate."""
    position, velocity, effort = state
    single = coordinates.single
    return position[coordinates.place[single]], velocity[single], effort[single]


def joint_state(names, sec, nanosec, position, velocity, effort):
    """Return a JointState of names and arrays, one number for each joint in it."""
    message = JointState(name=names, **{
        key: array('d', values.tobytes()) for key, values in (
            ('position', position), ('velocity', velocity), ('effort', effort))})
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    return message


def _joint_efforts(names, sec, nanosec, effort):
    """Return the same of efforts alone; the others are zero."""
    # Readers of bags trip over lists that are empty.
    return joint_state(names, sec, nanosec, np.zeros(len(names)), np.zeros(len(names)), effort)


def wrench_stamped(frame, sec, nanosec, values):
    """Return a WrenchStamped of force [N] and torque [N m], shape (6,), in the axes of a frame."""
    message = WrenchStamped()
    message.header.frame_id = frame
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    fill(message.wrench.force, message.wrench.torque, values.tolist())
    return message


def fill(first, second, numbers):
    """Fill two vectors of a message with six numbers."""
    first.x, first.y, first.z, second.x, second.y, second.z = numbers
