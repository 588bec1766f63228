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

"""Subscriptions that count the messages that were sent and did not arrive."""

import inspect

from rclpy.event_handler import SubscriptionEventCallbacks


class SequenceGaps:
    """Counts the messages of a topic that were sent and did not arrive, by their numbers."""

    def __init__(self):
        # Latest number of each publisher, the least recent first: who sent a message is not told.
        self._latest = []

    def forget(self):
        """Begin anew: publishers have come or gone."""
        self._latest.clear()

    def missing(self, number, publishers):
        """
        Return how many messages are missing before one.

        Parameters
        ----------
        number : int
            Of the message, among those of its publisher; consecutive.
        publishers : callable
            Returns how many there are; asked where it matters.

        Returns
        -------
        int

        """
        latest = self._latest
        if number - 1 in latest:
            latest.remove(number - 1)
            latest.append(number)
            return 0
        # A publisher that was not heard before, or one of those whose number is lower.
        before = max((one for one in latest if one < number), default=None)
        if before is None or len(latest) < publishers():
            latest.append(number)
            return 0
        latest.remove(before)
        latest.append(number)
        return number - before - 1


def subscribe(node, kind, topic, callback, qos, on_lost):
    """
    Subscribe to a topic, and tell of messages that were lost on the way.

    Parameters
    ----------
    node : rclpy.node.Node
        Subscribes.
    kind : type
        Of the messages.
    topic : str
        Its name.
    callback : callable
        Takes a message.
    qos : rclpy.qos.QoSProfile
        Of the subscription.
    on_lost : callable
        Takes the number of messages that were lost before the present one, before that is
        handed over. Never called where the middleware does not number messages.

    Returns
    -------
    rclpy.subscription.Subscription

    """
    gaps = SequenceGaps()

    def received(*arguments):
        # rclpy's events executor hands over message and information as one.
        message, info = arguments if len(arguments) == 2 else arguments[0]
        number = info['publication_sequence_number']
        missing = gaps.missing(number, subscription.get_publisher_count) if number else 0
        if missing:
            on_lost(missing)
        callback(message)

    # What rclpy looks at to find out whether the information is wanted.
    received.__signature__ = inspect.signature(lambda message, info: None)
    subscription = node.create_subscription(
        kind, topic, received, qos,
        event_callbacks=SubscriptionEventCallbacks(matched=lambda change: gaps.forget()))
    return subscription
