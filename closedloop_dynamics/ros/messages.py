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

"""What a simulator publishes of a state: joint states and constraint forces."""

from array import array
from functools import partial
import time

from builtin_interfaces.msg import Time
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.wire import WireMessage
from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

NANOSECONDS = 10 ** 9
# For subscribers to receive what was published: to wait at once, and all in all [s].
PATIENCE, GIVE_UP = Duration(seconds=0.02), 2.0
# A reliable subscriber that stalls for a second at 1 kHz still gets everything.
STATE_QOS = QoSProfile(depth=1000)


class StatePublisher:
    """
    Publishes one JointState and one WrenchStamped per cut joint, with one stamp.

    Parameters
    ----------
    node : rclpy.node.Node
        Publishes.
    joint_names : sequence of str
        In the order of the joint coordinates.
    cut_names : sequence of str
        In the order of the constraint forces.
    frames : sequence of str
        Frames that these refer to.

    Attributes
    ----------
    stamp : builtin_interfaces.msg.Time
        Of the latest messages.
    published : int
        Messages published so far.

    Raises
    ------
    StartError
        If the name of a cut joint cannot be part of a topic's name.

    """

    def __init__(self, node, joint_names, cut_names, frames):
        self.stamp, self.published = Time(), 0
        self._stuck_since = None
        self._names = list(joint_names)
        self._state = WireMessage(self.joint_state, 3 * [len(joint_names)])
        self._messages = [WireMessage(partial(wrench_stamped, frame), (6,)) for frame in frames]
        # Forces of all cut joints as the messages have them: force, then torque.
        self._wrenches = np.zeros((len(cut_names), 6))
        self._state_publisher = node.create_publisher(JointState, 'joint_states', STATE_QOS)
        try:
            self._force_publishers = [
                node.create_publisher(WrenchStamped, f'constraint_forces/{name}', STATE_QOS)
                for name in cut_names]
        except InvalidTopicNameException:
            raise StartError(
                'the name of a cut joint becomes part of a topic name, so it must be letters, '
                'digits and underscores, not beginning with a digit; got '
                f'{list(cut_names)}') from None

    def joint_state(self, sec, nanosec, position, velocity, effort):
        """
        Return a JointState.

        Parameters
        ----------
        sec, nanosec : int
            The stamp.
        position, velocity, effort : ndarray, shape (nv,)
            Of the joints [rad or m, and per s; N m or N].

        Returns
        -------
        sensor_msgs.msg.JointState

        """
        message = JointState(name=self._names, **{
            key: array('d', values.tobytes()) for key, values in (
                ('position', position), ('velocity', velocity), ('effort', effort))})
        message.header.stamp = Time(sec=sec, nanosec=nanosec)
        return message

    def publish(self, nanoseconds, position, velocity, effort, constraint_forces):
        """
        Publish a state.

        Parameters
        ----------
        nanoseconds : int
            The stamp.
        position, velocity, effort : ndarray, shape (nv,)
            Of the joints [rad or m, and per s; N m or N].
        constraint_forces : ndarray, shape (number of cut joints, 3)
            What body B exerts on body A: torque about z [N m], force along x and y [N].

        """
        sec, nanosec = divmod(nanoseconds, NANOSECONDS)
        self.stamp.sec, self.stamp.nanosec = sec, nanosec
        self._wrenches[:, 5] = constraint_forces[:, 0]
        self._wrenches[:, :2] = constraint_forces[:, 1:]
        # The state last: who answers it knows the forces.
        for publisher, message, wrench in zip(
                self._force_publishers, self._messages, self._wrenches):
            publisher.publish(message.filled(sec, nanosec, wrench))
        self._state_publisher.publish(
            self._state.filled(sec, nanosec, position, velocity, effort))
        self.published += 1 + len(self._force_publishers)

    def is_received(self):
        """
        Return whether reliable subscribers have received everything, waiting a little for it.

        Of one that does not answer for long, such as a process that was stopped, it is no longer
        expected.

        """
        now = time.monotonic()
        if all(publisher.wait_for_all_acked(PATIENCE)
               for publisher in (self._state_publisher, *self._force_publishers)):
            self._stuck_since = None
            return True
        self._stuck_since = self._stuck_since or now
        return now - self._stuck_since > GIVE_UP


def wrench_stamped(frame, sec, nanosec, values):
    """
    Return a WrenchStamped.

    Parameters
    ----------
    frame : str
        Its axes, and the point that its moment refers to.
    sec, nanosec : int
        The stamp.
    values : ndarray, shape (6,)
        Force along x, y, z [N], torque about them [N m].

    Returns
    -------
    geometry_msgs.msg.WrenchStamped

    """
    message = WrenchStamped()
    message.header.frame_id = frame
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = values.tolist()
    return message
