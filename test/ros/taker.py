# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A reliable subscriber that takes serialised messages without an executor, and misses nothing."""

from collections import Counter

from closedloop_dynamics.scene.loading import load_scene
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

DEPTH = 10000


class Taker:
    """
    Takes states and forces of a scene, and finds gaps in the publishers' own numbering.

    Parameters
    ----------
    node : rclpy.node.Node
        In no executor: its messages are polled for.
    scene : str
        Whose cut joints are listened to.

    Attributes
    ----------
    received, lost : Counter
        By topic.
    sent : list of int
        When joint states were sent, as DDS says [ns], if ``keep_times``.

    """

    def __init__(self, node, scene, keep_times=False):
        self.received, self.lost, self._last = Counter(), Counter(), {}
        self.sent, self._keep_times = [], keep_times
        topics = {f'constraint_forces/{cut.name}': WrenchStamped
                  for cut in load_scene(scene).mechanism.cut_joints}
        self._subscriptions = {
            topic: node.create_subscription(
                kind, topic, lambda message: None, QoSProfile(depth=DEPTH), raw=True)
            for topic, kind in {'joint_states': JointState, **topics}.items()}

    def take(self):
        """Take all that has arrived."""
        for topic, subscription in self._subscriptions.items():
            with subscription.handle:
                while taken := subscription.handle.take_message(subscription.msg_type, True):
                    self._note(topic, *taken)

    def _note(self, topic, data, info):
        number = info['publication_sequence_number']
        self.lost[topic] += max(0, number - self._last.get(topic, number - 1) - 1)
        self._last[topic] = number
        self.received[topic] += 1
        if self._keep_times and topic == 'joint_states':
            self.sent.append(info['source_timestamp'])

    def clear(self):
        """Count from here on."""
        self.sent.clear()
        self.received.clear()
        self.lost.clear()
