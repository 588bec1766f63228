# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the recorder node in this process."""

from test.ros.bags import read_with_rosbags

from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.recorder_node import RecorderNode
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import String


@pytest.fixture
def make_recorder(make_node, context, tmp_path, monkeypatch):
    """Return a function that creates a recorder, with an executor that is shut down."""
    monkeypatch.chdir(tmp_path)
    executor = SingleThreadedExecutor(context=context)

    def make(namespace=None, **parameters):
        recorder = make_node(RecorderNode, namespace, output='bag', **parameters)
        executor.add_node(recorder)
        return recorder

    yield make
    executor.shutdown()


def wait(listener, recorder, condition, what):
    """Let the recorder work until a condition holds."""
    def spin():
        recorder.executor.spin_once(timeout_sec=0.01)
        return condition()

    listener.wait(spin, what)


def test_messages_are_recorded_as_they_were_sent(make_recorder, listener, tmp_path):
    recorder = make_recorder(topics=['numbers', '/words'])
    numbers = listener.node.create_publisher(Float64MultiArray, 'numbers', 10)
    words = listener.node.create_publisher(String, 'words', 10)
    for publisher in (numbers, words):
        wait(listener, recorder, publisher.get_subscription_count, 'subscription')
    for index in range(5):
        numbers.publish(Float64MultiArray(data=[float(index), index / 3]))
    words.publish(String(data='grüezi'))
    wait(listener, recorder, lambda: recorder.received.total() == 6, 'messages')
    recorder.close()
    messages = read_with_rosbags(tmp_path / 'bag')
    assert [list(each.data) for _, each in messages['/numbers']] == [
        [float(index), index / 3] for index in range(5)]
    assert [each.data for _, each in messages['/words']] == ['grüezi']
    times = [nanoseconds for nanoseconds, _ in messages['/numbers']]
    assert times == sorted(times)
    assert recorder.exit_code is None


def test_patterns_are_relative_to_the_namespace(make_recorder, listener):
    recorder = make_recorder(namespace='/cell', topics=['forces/*', '/all/?', 'state'])
    publishers = [
        listener.node.create_publisher(String, topic, 10)
        for topic in ('/cell/forces/a', '/cell/forces/b/c', '/forces/d', '/all/e', '/all/ff',
                      '/cell/state', '/state')]
    subscribed = [publishers[index] for index in (0, 1, 3, 5)]
    wait(listener, recorder,
         lambda: all(each.get_subscription_count() for each in subscribed), 'subscriptions')
    assert [each.get_subscription_count() for each in publishers] == [1, 1, 0, 1, 0, 1, 0]
    recorder.close()


def test_best_effort_publisher_is_heard_though_it_comes_second(make_recorder, listener):
    recorder = make_recorder(topics=['mixed'])
    reliable = listener.node.create_publisher(String, 'mixed', 10)
    wait(listener, recorder, reliable.get_subscription_count, 'subscription')
    reliable.publish(String(data='first'))
    wait(listener, recorder, lambda: recorder.received['/mixed'] == 1, 'message')
    best_effort = listener.node.create_publisher(
        String, 'mixed', QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    wait(listener, recorder, best_effort.get_subscription_count, 'subscription')

    def heard():
        best_effort.publish(String(data='second'))
        return recorder.received['/mixed'] > 1

    wait(listener, recorder, heard, 'message')
    recorder.close()


def test_latched_message_is_recorded_though_it_was_sent_before(make_recorder, listener):
    publisher = listener.node.create_publisher(
        String, 'latched', QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    publisher.publish(String(data='once'))
    recorder = make_recorder(topics=['latched'])
    wait(listener, recorder, lambda: recorder.received['/latched'] == 1, 'message')
    recorder.close()


def test_topic_of_two_types_is_named_and_not_recorded(make_recorder, monkeypatch, capfd):
    recorder = make_recorder(topics=['double'])
    monkeypatch.setattr(recorder, 'get_topic_names_and_types', lambda: [
        ('/double', ['std_msgs/msg/Float64MultiArray', 'std_msgs/msg/String'])])
    recorder.poll_topics()
    recorder.poll_topics()
    assert not list(recorder.subscriptions)
    recorder.close()
    told = capfd.readouterr().err
    assert told.count('/double is not recorded: it has several types') == 1


@pytest.mark.parametrize('parameters, problem', [
    ({'storage': 'rosbag1'}, "'storage': expected one of mcap, sqlite3"),
    ({'topics': ['two words']}, "'two words' is not the name of a topic"),
    ({'max_duration': -1.0}, 'max_duration'),
    ({'compression': 'gzip'}, "'compression': expected one of none, zstd, lz4"),
    ({'compression': 'lz4', 'storage': 'sqlite3'}, 'none, zstd with storage sqlite3'),
])
def test_bad_parameters_are_named(make_recorder, parameters, problem, tmp_path):
    with pytest.raises(StartError, match=problem):
        make_recorder(**parameters)
    assert not (tmp_path / 'bag').exists()


def test_existing_bag_is_not_overwritten(make_recorder, tmp_path):
    (tmp_path / 'bag').mkdir()
    with pytest.raises(StartError, match='exists already'):
        make_recorder()
