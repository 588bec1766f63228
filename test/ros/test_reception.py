# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the subscriptions of closedloop_dynamics.ros.commands."""

import time

from closedloop_dynamics.ros.commands import SequenceGaps, subscribe
from closedloop_dynamics.ros.executor import build_executor, VARIABLE
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray

PATIENCE = 240.0


@pytest.mark.parametrize('numbers, publishers, missing', [
    ([7, 8, 9], 1, [0, 0, 0]),
    ([1, 2, 5, 6, 10], 1, [0, 0, 2, 0, 3]),
    ([1, 100, 2, 101, 3, 105, 4, 6], 2, [0, 0, 0, 0, 0, 3, 0, 1]),
])
def test_missing_numbers_are_counted(numbers, publishers, missing):
    gaps = SequenceGaps()
    assert [gaps.missing(number, lambda: publishers) for number in numbers] == missing


def test_nothing_is_missing_from_a_publisher_that_is_new():
    gaps = SequenceGaps()
    assert gaps.missing(3, lambda: 1) == 0
    gaps.forget()
    assert gaps.missing(90, lambda: 1) == 0


@pytest.mark.parametrize('executor_kind', ['events', 'single'])
@pytest.mark.parametrize(
    'reliability', [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
def test_what_was_sent_is_received_or_lost(context, monkeypatch, executor_kind, reliability):
    monkeypatch.setenv(VARIABLE, executor_kind)
    node, received, lost = Node('taker', context=context), [], []
    qos = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)
    subscribe(node, Float64MultiArray, 'numbers', received.append, qos, lost.append)
    publisher = node.create_publisher(
        Float64MultiArray, 'numbers', QoSProfile(depth=20, reliability=reliability))
    executor = build_executor(context)
    executor.add_node(node)

    def spin_until(done):
        deadline = time.monotonic() + PATIENCE
        while not done():
            assert time.monotonic() < deadline
            executor.spin_once(timeout_sec=0.05)

    def send(number):
        publisher.publish(Float64MultiArray(data=[float(number)]))

    try:
        spin_until(publisher.get_subscription_count)
        send(0)
        spin_until(lambda: received)
        for number in range(1, 101):
            send(number)
        spin_until(lambda: received[-1].data[0] == 100.0)
        assert 0 < sum(lost) == 101 - len(received)
    finally:
        executor.shutdown()
        node.destroy_node()
