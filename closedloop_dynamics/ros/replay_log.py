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

"""The topic ``replay_log``: at which simulated time a state is, and what command led to it."""

from array import array

import numpy as np
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import MultiArrayDimension

LOG_QOS = QoSProfile(depth=1000)
# Names of the columns, before the commands by joint and the state by number.
COLUMNS = ('stamp_sec', 'stamp_nanosec', 'index', 'jumps', 'simulated_time')


# In place of the stamp, in an entry for a time at which no state was published.
NO_STATE = -1


class ReplayLog:
    """
    Publishes one entry for each state, as long as somebody subscribes.

    The stamps of states may follow the system's clock, and the efforts in them are those behind
    drives with limits and lag. What a replay needs is the simulated time, the command
    before the drives, and the whole state (``Simulation.state``), to begin there to the last bit.
    Where the command changes between two published states, an entry without a stamp
    says up to when the old one acted. ``index`` counts the entries, so that a gap is
    seen; ``jumps`` counts the resets and the states that were set from outside.

    Parameters
    ----------
    node : rclpy.node.Node
        Publishes.

    Attributes
    ----------
    index : int
        Of the last entry, from 1.

    """

    def __init__(self, node):
        self._publisher = node.create_publisher(Float64MultiArray, 'replay_log', LOG_QOS)
        self._message = Float64MultiArray()
        self._values = self._sizes = self._torque = None
        self.index = self._jumps = 0
        self._time = 0.0

    def jumped(self):
        """Note that the next state does not follow from the last by simulating."""
        self._jumps += 1

    def advancing(self, simulation, torque):
        """
        Note the command of the steps that come now.

        Parameters
        ----------
        simulation : Simulation
            About to advance.
        torque : ndarray, shape (nv,)
            The command [N m or N].

        """
        if self._torque is None:
            self._torque = torque.copy()
        elif not np.array_equal(torque, self._torque):
            if simulation.time > self._time:
                self._note(NO_STATE, NO_STATE, simulation)
            self._torque[:] = torque

    def follow(self, stamp, simulation):
        """
        Publish the entry of a state.

        Parameters
        ----------
        stamp : builtin_interfaces.msg.Time
            Of the state.
        simulation : Simulation
            Which is in that state.

        """
        self._note(stamp.sec, stamp.nanosec, simulation)

    def _note(self, second, nanosecond, simulation):
        time = simulation.time
        if time < self._time:
            self._jumps += 1
        self._time = time
        self.index += 1
        if not self._publisher.get_subscription_count():
            return
        state = simulation.state
        self._size(simulation.joint_names, len(state))
        self._values[:len(COLUMNS)] = second, nanosecond, self.index, self._jumps, time
        if self._torque is not None:
            self._values[len(COLUMNS):-len(state)] = self._torque
        self._values[-len(state):] = state
        self._publisher.publish(self._message)

    def _size(self, names, states):
        """Size the message for another mechanism or other effects, and name what is in it."""
        if (names, states) == self._sizes:
            return
        self._sizes = names, states
        columns = [*COLUMNS, *names, *(f'state.{k}' for k in range(states))]
        self._message.layout.dim = [MultiArrayDimension(
            label=' '.join(columns), size=len(columns), stride=len(columns))]
        self._message.data = array('d', bytes(8 * len(columns)))
        self._values = np.frombuffer(self._message.data)
