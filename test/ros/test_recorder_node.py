# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the recorder node in this process."""

from test.ros.bags import read_with_mcap, read_with_rosbags
from threading import Event

from closedloop_dynamics.recording.reading import Bag
from closedloop_dynamics.recording.writer import BagFiles
from closedloop_dynamics.ros import bag
from closedloop_dynamics.ros.process import StartError
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, String


def test_messages_are_recorded_as_they_were_sent(record, listener, tmp_path):
    recorder = record(topics=['numbers', '/words'])
    numbers = listener.node.create_publisher(Float64MultiArray, 'numbers', 10)
    words = listener.node.create_publisher(String, 'words', 10)
    for publisher in (numbers, words):
        listener.wait(publisher.get_subscription_count, 'subscription')
    for index in range(5):
        numbers.publish(Float64MultiArray(data=[float(index), index / 3]))
    words.publish(String(data='grüezi'))
    listener.wait(lambda: recorder.received.total() == 6, 'messages')
    recorder.close()
    messages = read_with_rosbags(tmp_path / 'bag')
    assert [list(each.data) for _, each in messages['/numbers']] == [
        [float(index), index / 3] for index in range(5)]
    assert [each.data for _, each in messages['/words']] == ['grüezi']
    times = [nanoseconds for nanoseconds, _ in messages['/numbers']]
    assert times == sorted(times)
    assert recorder.exit_code is None


def test_patterns_are_relative_to_the_namespace(record, listener):
    recorder = record('/cell', topics=['forces/*', '/all/?', 'state'])
    publishers = [
        listener.node.create_publisher(String, topic, 10)
        for topic in ('/cell/forces/a', '/cell/forces/b/c', '/forces/d', '/all/e', '/all/ff',
                      '/cell/state', '/state')]
    subscribed = [publishers[index] for index in (0, 1, 3, 5)]
    listener.wait(
        lambda: all(each.get_subscription_count() for each in subscribed), 'subscriptions')
    assert [each.get_subscription_count() for each in publishers] == [1, 1, 0, 1, 0, 1, 0]
    recorder.close()


def test_best_effort_publisher_is_heard_though_it_comes_second(record, listener):
    recorder = record(topics=['mixed'])
    reliable = listener.node.create_publisher(String, 'mixed', 10)
    listener.wait(reliable.get_subscription_count, 'subscription')
    reliable.publish(String(data='first'))
    listener.wait(lambda: recorder.received['/mixed'] == 1, 'message')
    best_effort = listener.node.create_publisher(
        String, 'mixed', QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    listener.wait(best_effort.get_subscription_count, 'subscription')

    def heard():
        best_effort.publish(String(data='second'))
        return recorder.received['/mixed'] > 1

    listener.wait(heard, 'message')
    recorder.close()


def test_latched_message_is_recorded_though_it_was_sent_before(record, listener):
    publisher = listener.node.create_publisher(
        String, 'latched', QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    publisher.publish(String(data='once'))
    recorder = record(topics=['latched'])
    listener.wait(lambda: recorder.received['/latched'] == 1, 'message')
    recorder.close()


def test_topic_of_two_types_is_named_and_not_recorded(record, monkeypatch, capfd):
    recorder = record(topics=['double'])
    monkeypatch.setattr(recorder, 'get_topic_names_and_types', lambda: [
        ('/double', ['std_msgs/msg/Float64MultiArray', 'std_msgs/msg/String'])])
    recorder.poll_topics()
    recorder.poll_topics()
    assert not list(recorder.subscriptions)
    recorder.close()
    reported = capfd.readouterr().err
    assert reported.count('/double is not recorded: it has several types') == 1


@pytest.mark.parametrize('parameters, problem', [
    ({'storage': 'rosbag1'}, "'storage': expected one of mcap, sqlite3"),
    ({'topics': ['two words']}, "'two words' is not the name of a topic"),
    ({'max_duration': -1.0}, 'max_duration'),
    ({'compression': 'gzip'}, "'compression': expected one of none, zstd, lz4"),
    ({'compression': 'lz4', 'storage': 'sqlite3'}, 'none, zstd with storage sqlite3'),
])
def test_bad_parameters_are_named(record, parameters, problem, tmp_path):
    with pytest.raises(StartError, match=problem):
        record(**parameters)
    assert not (tmp_path / 'bag').exists()


def test_existing_bag_is_not_overwritten(record, tmp_path):
    (tmp_path / 'bag').mkdir()
    with pytest.raises(StartError, match='exists already'):
        record()


@pytest.fixture
def numbers(record, listener):
    """
    Return a function that creates a recorder, whose ``send(NUMBERS)`` publishes messages on /t.

    ``recorded()`` are the numbers in its bag; ``counts()`` of what was received and written.
    """
    def make(**parameters):
        recorder = record(topics=['t'], **parameters)
        publisher = listener.publisher('t', Float64MultiArray)

        def send(sent):
            for number in sent:
                publisher.publish(Float64MultiArray(data=[float(number)] + [0.0] * 100))
            listener.wait(lambda: recorder.received['/t'] > sent[-1], 'messages')

        recorder.send = send
        recorder.recorded = lambda: [
            message.data[0] for topic, _, message in Bag(recorder.bag.path).messages()]
        recorder.counts = lambda: (recorder.received['/t'], recorder.bag.written['/t'])
        return recorder

    return make


def test_no_message_of_a_quick_publisher_is_missing(numbers, tmp_path):
    recorder = numbers()
    # All at once would overrun the buffers of the network.
    for begin in range(0, 4000, 100):
        recorder.send(range(begin, begin + 100))
    recorder.close()
    assert [message.data[0] for _, message in read_with_mcap(tmp_path / 'bag')['/t']] == list(
        range(4000))
    assert recorder.counts() == (4000, 4000)


def test_recording_ends_by_itself(record, listener, tmp_path, capfd):
    recorder = record(max_duration=0.5, topics=['nothing', 'forces/*'])
    listener.wait(lambda: recorder.exit_code == 0, 'end')
    recorder.close()
    output = capfd.readouterr().err
    for topic in 'nothing', 'forces/*':
        assert f"topic '{topic}' never appeared" in output
    assert read_with_rosbags(tmp_path / 'bag') == {}


def test_large_recordings_are_split(numbers, tmp_path):
    recorder = numbers(max_size=0.05)
    recorder.send(range(300))
    recorder.close()
    assert len(list((tmp_path / 'bag').glob('*.mcap'))) > 4  # Of more than 240 kB
    assert [message.data[0] for _, message in read_with_rosbags(tmp_path / 'bag')['/t']] == list(
        range(300))


def fails_with(error):
    def fail(*_):
        raise error
    return fail


@pytest.mark.parametrize('storage, error', [
    ('mcap', ValueError('no such chunk')), ('sqlite3', ImportError('no such library')),
    ('mcap', RuntimeError('two\nlines'))])
def test_errors_of_any_kind_end_the_recording(
        numbers, listener, monkeypatch, capfd, storage, error):
    recorder = numbers(storage=storage)
    recorder.send([0])
    listener.wait(lambda: recorder.recorded() == [0.0], 'message in the file')
    monkeypatch.setattr(BagFiles, 'write', fails_with(error))
    recorder.send([1])
    listener.wait(lambda: recorder.exit_code == 1, 'end')
    recorder.close()
    output = capfd.readouterr().err
    assert 'cannot go on writing the bag' in output and f'{type(error).__name__}: ' in output
    assert '2 received, 1 written, 1 dropped' in output
    assert recorder.recorded() == [0.0]


def test_error_at_the_beginning_is_reported(numbers, monkeypatch):
    monkeypatch.setattr(BagFiles, '__init__', fails_with(ImportError('no such library')))
    with pytest.raises(StartError, match='cannot create the bag .*: ImportError: no such libr'):
        numbers()


def test_error_at_the_end_is_reported(numbers, monkeypatch, capfd):
    monkeypatch.setattr(BagFiles, 'close', fails_with(KeyError('index')))
    recorder = numbers()
    recorder.send([0])
    recorder.close()
    assert recorder.exit_code == 1 and "KeyError: 'index'" in capfd.readouterr().err


# A disk that hangs for ever from the second message on, and one that takes a minute for what comes
# in a few seconds.
@pytest.mark.parametrize('pause, storage', [(None, 'mcap'), (0.05, 'sqlite3')])
def test_slow_disk_drops_messages_and_does_not_delay_the_end(
        numbers, listener, monkeypatch, capfd, pause, storage):
    recorder, write, answer = numbers(storage=storage, max_cache_size=0.1), BagFiles.write, Event()
    recorder.send([0])
    listener.wait(lambda: recorder.recorded() == [0.0], 'message in the file')
    monkeypatch.setattr(BagFiles, 'write', lambda *arguments: (
        answer.wait(pause), write(*arguments)))
    monkeypatch.setattr(bag, 'PATIENCE', 0.3)
    monkeypatch.setattr(bag, 'INDEX_PATIENCE', 0.3)
    # A tenth of a megabyte is some hundred of these.
    recorder.send(range(1, 300))
    listener.wait(lambda: 'messages come faster than the disk takes them' in
                  capfd.readouterr().err, 'a warning')
    recorder.close()
    output, (received, written) = capfd.readouterr().err, recorder.counts()
    assert recorder.exit_code == 1 and received == 300
    dropped = received - written
    assert f'300 received, {written} written, {dropped} dropped' in output
    assert ('the disk does not answer' if pause is None else
            f'{dropped} messages are not in the bag') in output
    # The hundred that waited in the end would have taken the slow disk 5 s.
    assert recorder.recorded() == list(range(written)) and written < 50
    answer.set()
