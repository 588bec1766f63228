# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A node for tests: collects messages, sends some, and waits for what should happen."""

import time

from closedloop_dynamics.ros.commands import SERVICE_QOS
from closedloop_dynamics.ros.executor import build_executor
from rclpy.node import Node
from rclpy.qos import QoSProfile

# Generous: a loaded machine is slow, and a test that passes does not wait.
PATIENCE = 240.0
DEPTH = 10000
# After which a message, or a call of a service, that may have been lost is sent again [s]. Calls
# that are answered late would be obeyed twice.
REPEAT, REPEAT_CALL = 1.0, 10.0


def holds(condition):
    """Return the value of a condition; None where it asks for a message that has not come yet."""
    try:
        return condition()
    except IndexError:
        return None


class Listener:
    """
    Collect the messages of topics.

    Attributes
    ----------
    received : dict
        Topic, as it was given to ``listen``, to the list of messages.

    """

    def __init__(self, name, context):
        self.node = Node(name, context=context)
        self.received = {}
        self._executor = build_executor(context)
        self._executor.add_node(self.node)

    def add(self, node):
        """Let a node run while this one waits."""
        self._executor.add_node(node)

    def remove(self, node):
        """Let a node run no more."""
        self._executor.remove_node(node)

    def leave_alone(self, node):
        """Let no other node run any more."""
        for other in self._executor.get_nodes():
            if other not in (node, self.node):
                self.remove(other)

    def listen(self, topic, message_class):
        """Collect the messages of a topic from now on."""
        messages = self.received.setdefault(topic, [])
        self.node.create_subscription(
            message_class, topic, messages.append, QoSProfile(depth=DEPTH))
        return messages

    def publisher(self, topic, message_class):
        """Return a publisher that has found a subscriber."""
        publisher = self.node.create_publisher(message_class, topic, QoSProfile(depth=DEPTH))
        self.wait(lambda: publisher.get_subscription_count() > 0, f'a subscriber of {topic}')
        return publisher

    def wait(self, condition, what, patience=PATIENCE):
        """Spin until the condition holds and return its value; fail if it never does."""
        deadline = time.monotonic() + patience
        while not (value := holds(condition)):
            assert time.monotonic() < deadline, f'no {what} within {patience} s'
            self._executor.spin_once(timeout_sec=0.05)
        return value

    def send(self, publisher, message, condition, what):
        """
        Publish until a condition holds; return how often.

        A publisher knows of a subscriber before that knows of the publisher; what is sent in
        between is lost.
        """
        deadline, count = time.monotonic() + PATIENCE, 0
        while not holds(condition):
            assert time.monotonic() < deadline, f'no {what} within {PATIENCE} s'
            publisher.publish(message)
            count += 1
            again = time.monotonic() + REPEAT
            while time.monotonic() < again and not holds(condition):
                self._executor.spin_once(timeout_sec=0.05)
        return count

    def call(self, service_class, name, request):
        """Call a service and return the answer."""
        return self.call_all(service_class, name, [request])[0]

    def call_all(self, service_class, name, requests):
        """
        Call a service with all requests, and return the answers.

        The first one is sent again where its answer is lost (see ``send``). Once it is there,
        both sides know each other, and the others are sent at once.
        """
        for _ in range(round(PATIENCE / REPEAT_CALL)):
            client = self.node.create_client(service_class, name, qos_profile=SERVICE_QOS)
            self.wait(client.service_is_ready, f'service {name}')
            first = client.call_async(requests[0])
            again = time.monotonic() + REPEAT_CALL
            while time.monotonic() < again and not first.done():
                self._executor.spin_once(timeout_sec=0.05)
            if first.done():
                break
            self.node.destroy_client(client)
        else:
            raise AssertionError(f'no answer of {name} within {PATIENCE} s')
        futures = [first, *map(client.call_async, requests[1:])]
        self.wait(lambda: all(future.done() for future in futures), f'answers of {name}')
        self.node.destroy_client(client)
        return [future.result() for future in futures]

    def destroy(self):
        """Leave the domain."""
        self._executor.shutdown()
        self.node.destroy_node()
