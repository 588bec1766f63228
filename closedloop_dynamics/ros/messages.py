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

"""Messages of the simulator: sized once, refilled at every tick."""

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
import numpy as np
from sensor_msgs.msg import JointState

WORLD_FRAME = 'world'
NANOSECONDS = 10 ** 9


class StateMessages:
    """
    One JointState and one WrenchStamped per cut joint, sharing one stamp.

    Parameters
    ----------
    joint_names : sequence of str
        In the order of the joint coordinates.
    cut_names : sequence of str
        In the order of the constraint forces.

    Attributes
    ----------
    stamp : builtin_interfaces.msg.Time
    joint_state : sensor_msgs.msg.JointState
    wrenches : tuple of geometry_msgs.msg.WrenchStamped
        What body B exerts on body A of each cut joint, in world axes.

    """

    def __init__(self, joint_names, cut_names):
        self.stamp = Time()
        self.joint_state = JointState()
        self.joint_state.header.stamp = self.stamp
        self.joint_state.name = list(joint_names)
        self._position = self._sized('position')
        self._velocity = self._sized('velocity')
        self._effort = self._sized('effort')
        self.wrenches = tuple(WrenchStamped() for _ in cut_names)
        for wrench in self.wrenches:
            wrench.header.stamp = self.stamp
            wrench.header.frame_id = WORLD_FRAME

    def _sized(self, field):
        """Size an array field and return a view to fill it through."""
        setattr(self.joint_state, field, [math.nan] * len(self.joint_state.name))
        return np.frombuffer(getattr(self.joint_state, field))

    def fill(self, nanoseconds, position, velocity, effort, constraint_forces):
        """
        Write a state into the messages.

        Parameters
        ----------
        nanoseconds : int
            The stamp.
        position, velocity, effort : ndarray, shape (nv,)
            Of the joints [rad or m, and per s; N m or N].
        constraint_forces : ndarray, shape (number of cut joints, 3)
            Torque about z [N m] and force along x and y [N].

        """
        self.stamp.sec, self.stamp.nanosec = divmod(nanoseconds, NANOSECONDS)
        self._position[:] = position
        self._velocity[:] = velocity
        self._effort[:] = effort
        for message, (torque, force_x, force_y) in zip(
                self.wrenches, constraint_forces.tolist()):
            message.wrench.torque.z = torque
            message.wrench.force.x = force_x
            message.wrench.force.y = force_y
