# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of closedloop_dynamics.ros.messages: what goes over the wire."""

from closedloop_dynamics import Joint
from closedloop_dynamics.mechanism.coordinates import Coordinates
from closedloop_dynamics.ros.messages import SerializedTemplate, Stamps, StatePublisher
from closedloop_dynamics.ros.process import StartError
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, MultiDOFJointState


class Recorder:
    """Takes what a publisher is given, as a subscriber would see it."""

    def __init__(self, kind):
        self.kind, self.messages, self.raw = kind, [], 0

    def publish(self, message):
        if isinstance(message, bytes):
            self.raw += 1
            message = deserialize_message(message, self.kind)
        self.messages.append(message)


@pytest.fixture
def publisher(make_node):
    def build(joints=('a', 'b'), cuts=('cut_1', 'cut_2'), kind='revolute'):
        publisher = StatePublisher(
            make_node(_Plain), Coordinates([
                Joint(name, kind, 'ground', name, (0.0, 0.0)) for name in joints]), cuts,
            [f'at_{cut}' for cut in cuts])
        publisher.orientation_publisher = Recorder(MultiDOFJointState)
        publisher.state_publisher = Recorder(JointState)
        publisher.force_publishers = [Recorder(WrenchStamped) for _ in cuts]
        return publisher
    return build


class _Plain(Node):

    def __init__(self, **options):
        super().__init__('plain', **options)


def check_state(publisher):
    """Publish a state twice, the second time with other numbers, and check what was sent."""
    for scale in (1.0, -3.0):
        numbers = scale * np.arange(1.0, 7.0)
        forces = scale * np.array([[0.5, 10.0, 20.0], [0.0, 30.0, 40.0]])
        publisher.publish(12_345_678_901, numbers[:2], numbers[2:4], numbers[4:], forces)
        state = publisher.state_publisher.messages[-1]
        assert state.name == ['a', 'b']
        assert [*state.position, *state.velocity, *state.effort] == numbers.tolist()
        wrenches = [each.messages[-1] for each in publisher.force_publishers]
        for each in (state, *wrenches):
            assert (each.header.stamp.sec, each.header.stamp.nanosec) == (12, 345_678_901)
        assert [each.header.frame_id for each in wrenches] == ['at_cut_1', 'at_cut_2']
        for each, (torque, x, y) in zip(wrenches, forces):
            wrench = each.wrench
            assert (wrench.torque.z, wrench.force.x, wrench.force.y) == (torque, x, y)
            assert (wrench.force.z, wrench.torque.x, wrench.torque.y) == (0.0, 0.0, 0.0)
    assert publisher.published == 6


def test_messages_carry_the_state_and_one_stamp(publisher):
    publisher = publisher()
    check_state(publisher)
    assert publisher.state_publisher.raw == 2


def test_they_carry_the_same_where_the_serialised_bytes_are_not_understood(
        publisher, monkeypatch):
    monkeypatch.setattr(SerializedTemplate, 'positions_of', lambda self, mark: [])
    publisher = publisher()
    check_state(publisher)
    assert publisher.state_publisher.raw == 0


@pytest.mark.parametrize('understood', [True, False])
def test_orientations_go_into_a_message_of_their_own(publisher, monkeypatch, understood):
    if not understood:
        monkeypatch.setattr(SerializedTemplate, 'positions_of', lambda self, mark: [])
    publisher = publisher(('a', 'b'), (), 'free')
    q, qd, tau = np.arange(14.0), np.arange(20.0, 32.0), np.arange(40.0, 52.0)
    publisher.publish(12_345_678_901, q, qd, tau, np.zeros((0, 6)))
    assert publisher.orientation_publisher.raw == understood
    message, = publisher.orientation_publisher.messages
    assert message.joint_names == ['a', 'b']
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 345_678_901)
    assert [value for pose in message.transforms for value in (
        pose.translation.x, pose.translation.y, pose.translation.z, pose.rotation.x,
        pose.rotation.y, pose.rotation.z, pose.rotation.w)] == q.tolist()
    for expected, parts in ((qd, [(one.linear, one.angular) for one in message.twist]),
                            (tau, [(one.force, one.torque) for one in message.wrench])):
        assert [value for pair in parts for part in pair
                for value in (part.x, part.y, part.z)] == expected.tolist()
    # The others have none.
    state, = publisher.state_publisher.messages
    assert not state.name and not len(state.position)
    assert state.header.stamp == message.header.stamp


def test_names_of_any_length_move_the_numbers_but_not_into_one_another(publisher):
    for length in range(1, 18):
        publisher_ = publisher(('x' * length, 'y'), ())
        publisher_.publish(5, np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([5.0, 6.0]),
                           np.zeros((0, 3)))
        state = publisher_.state_publisher.messages[-1]
        assert state.name == ['x' * length, 'y']
        assert [*state.position, *state.velocity, *state.effort] == [1, 2, 3, 4, 5, 6]


def test_clock_carries_simulated_time(make_node):
    simulation = type('Simulation', (), {'time': 3.25})()
    stamps = Stamps(make_node(_Plain), simulation, True, True, 0.01)
    stamps._publisher = Recorder(Clock)
    stamps.publish()
    clock = stamps._publisher.messages[0].clock
    # From one period on: zero would be no time at all.
    assert (clock.sec, clock.nanosec) == (3, 260_000_000)
    assert stamps.simulated_time(stamps.now()) == 3.25


def test_cut_joint_that_cannot_be_a_topic_is_refused(publisher):
    with pytest.raises(StartError, match='letters, digits and underscores'):
        publisher(cuts=('cut 1',))
