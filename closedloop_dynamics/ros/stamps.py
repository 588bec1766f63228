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

"""What time messages carry: that of the node's clock, or simulated time."""

from builtin_interfaces.msg import Time
from closedloop_dynamics.ros.wire import WireMessage
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

NANOSECONDS = 10 ** 9


class Stamps:
    """
    The time for the next messages, and ``/clock``.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose clock is asked.
    simulation : Simulation
        Whose time is taken.
    simulated : bool
        Whether to stamp in simulated time.
    publish_clock : bool
        Whether to publish simulated time on ``/clock``.

    """

    def __init__(self, node, simulation, simulated, publish_clock):
        self._node, self._simulation, self.simulated = node, simulation, simulated
        self._clock = WireMessage(
            lambda sec, nanosec: Clock(clock=Time(sec=sec, nanosec=nanosec)), ())
        self._publisher = node.create_publisher(
            Clock, '/clock', QoSProfile(depth=10)) if publish_clock else None

    @property
    def simulated_nanoseconds(self):
        """Return the simulated time [ns]."""
        return round(self._simulation.time * NANOSECONDS)

    def now(self):
        """Return the stamp for what is published now [ns]."""
        if self.simulated:
            return self.simulated_nanoseconds
        return self._node.get_clock().now().nanoseconds

    def earlier(self, late, last):
        """
        Return the stamp for a state whose time has passed [ns].

        Parameters
        ----------
        late : float
            So long ago [s of the steady clock].
        last : int or None
            Stamp of the state before, which this one is not to precede [ns].

        Returns
        -------
        int

        """
        now = self.now()
        # A clock that somebody else publishes runs as it likes.
        if self.simulated or self._node.get_clock().ros_time_is_active:
            return now
        stamp = now - max(0, round(late * NANOSECONDS))
        # Unless the clock itself was set back.
        return last + 1 if last is not None and stamp <= last <= now else stamp

    def message(self):
        """Return the same as a message."""
        sec, nanosec = divmod(self.now(), NANOSECONDS)
        return Time(sec=sec, nanosec=nanosec)

    def publish(self):
        """Tell everybody the simulated time, if that was asked for."""
        if self._publisher is not None:
            self._publisher.publish(
                self._clock.filled(*divmod(self.simulated_nanoseconds, NANOSECONDS)))
