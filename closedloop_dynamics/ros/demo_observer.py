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

"""A node that sees when the others have found each other, and when they move."""

from collections import Counter
import time

from closedloop_dynamics.ros.demo_processes import DemoError
from geometry_msgs.msg import WrenchStamped
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

# Between two looks whether all processes still run [s].
LOOK = 0.1


class Observer:
    """
    Listens in a namespace and waits for what is to happen there.

    Parameters
    ----------
    namespace : str
        Of the other nodes.
    cuts : sequence of str
        Names of the cut joints.
    check : callable
        Raises if one of the processes has ended; called again and again.

    Attributes
    ----------
    seen : Counter
        Messages that have come, by topic relative to the namespace.

    """

    NAME = 'closedloop_demo'

    def __init__(self, namespace, cuts, check):
        self._check = check
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node(
            self.NAME, namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.seen = Counter()
        self._subscriptions = [
            self._node.create_subscription(kind, topic, self._note(topic), 10)
            for topic, kind in {
                'joint_states': JointState, 'torque_command': Float64MultiArray,
                **{f'constraint_forces/{cut}': WrenchStamped for cut in cuts}}.items()]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def is_followed_by(self, name):
        """Return whether the node of that name subscribes to every topic listened to."""
        return all(
            name in {info.node_name for info in
                     self._node.get_subscriptions_info_by_topic(subscription.topic_name)}
            for subscription in self._subscriptions)

    def stop_listening(self):
        """Leave the processor to the others; only their processes are watched from now on."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []

    def wait(self, condition, what, patience):
        """
        Spin until a condition holds.

        Parameters
        ----------
        condition : callable
            Asked after every message, and some times a second.
        what : str
            What is waited for.
        patience : float
            [s].

        Raises
        ------
        DemoError
            If it takes longer.

        """
        deadline = time.monotonic() + patience
        while not condition():
            self._check()
            if time.monotonic() > deadline:
                raise DemoError(f'{what} did not happen within {patience:g} s')
            self._executor.spin_once(timeout_sec=LOOK)

    def _note(self, topic):
        def on_message(message):
            self.seen[topic] += 1

        return on_message
