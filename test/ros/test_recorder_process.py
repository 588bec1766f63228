# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the recorder as a process: bags that other readers open, with nothing missing."""

import re
import resource
import signal
from test.ros.bags import read_with_mcap, read_with_rosbags
import time

from closedloop_dynamics.recording.message_numbers import stamp_of
from closedloop_dynamics.recording.reading import Bag
from geometry_msgs.msg import WrenchStamped
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

SIMULATOR = 'closedloop_simulator'
RECORDER = 'closedloop_recorder'
SOURCE = 'closedloop_torque_source'
# What is sent until it is heard: a publisher knows of a subscriber before that knows of it.
HELLO = -1.0


def counts(recorder):
    """Return the topics of a recorder's last words with what was received and written."""
    return {topic: (int(received), int(written)) for topic, received, written in re.findall(
        r'(/\S+): (\d+) received, (\d+) written', recorder.output)}


@pytest.mark.parametrize('storage, readers', [
    ('mcap', [read_with_rosbags, read_with_mcap]),
    pytest.param('sqlite3', [read_with_rosbags], marks=pytest.mark.slow)])
def test_bag_holds_what_a_subscriber_got(processes, listener, tmp_path, storage, readers):
    recorder = processes.start(RECORDER, output='bag', storage=storage).wait_until_ready()
    topics = {'/joint_states': JointState, '/constraint_forces/cut_1': WrenchStamped,
              '/constraint_forces/cut_2': WrenchStamped}
    heard = {topic: listener.listen(topic, kind) for topic, kind in topics.items()}
    commands = listener.listen('/joint_command', JointState)
    simulator = processes.start(SIMULATOR, scene='three_rrr').wait_until_ready()
    source = processes.start(SOURCE, joints='[theta_1, theta_7]', torque='[1.0, 2.0]')
    # On a busy machine it takes seconds until all have found each other.
    for topic in (*topics, '/joint_command'):
        recorder.wait_for(f'{topic}: first message')
    # What was sent before, and still waits to be heard, need not be in the bag.
    now = time.time()
    listener.wait(lambda: commands and all(
        sum(stamp_of(message) > now * 1e9 for message in each) > 100 for each in heard.values()),
        'a hundred messages')
    # First those who speak, then those who listen.
    assert source.stop() == 0
    assert simulator.stop() == 0
    assert recorder.stop() == 0
    reported = counts(recorder)
    for read in readers:
        messages = read(tmp_path / 'bag')
        assert {topic: (len(each), len(each)) for topic, each in messages.items()} == {
            topic: count for topic, count in reported.items() if count[0]}
        for topic, expected in heard.items():
            assert_same_tail(topic, [each for _, each in messages[topic]], expected)
        assert list(messages['/joint_command'][-1][1].name) == ['theta_1', 'theta_7']
    assert "topic 'torque_command' never appeared" not in recorder.output
    assert 'lost' not in recorder.output


def heard_publisher(listener, recorder, topic):
    """Return a publisher that the recorder hears, having sent it ``HELLO``, maybe twice."""
    publisher = listener.publisher(topic, Float64MultiArray)
    listener.send(publisher, Float64MultiArray(data=[HELLO]),
                  lambda: f'/{topic}: first message' in recorder.output, 'first message')
    return publisher


def without_hello(numbers):
    """Return what followed; fail if a greeting came in between."""
    first = next((k for k, number in enumerate(numbers) if number != HELLO), len(numbers))
    assert first > 0
    return numbers[first:]


def assert_same_tail(topic, recorded, heard):
    """Compare two lists of messages from the first one that both have to the last heard."""
    assert recorded
    assert heard
    # What was still on its way to this process when the publisher left is lost to it, not to the
    # recorder.
    assert key(recorded[-1]) >= key(heard[-1])
    first, last = max(key(recorded[0]), key(heard[0])), key(heard[-1])
    recorded = [each for each in recorded if first <= key(each) <= last]
    heard = [each for each in heard if key(each) >= first]
    assert len(recorded) == len(heard) > 50, topic
    for left, right in zip(recorded, heard):
        assert key(left) == key(right)
        if hasattr(right, 'position'):
            assert list(left.position) == list(right.position)
            assert list(left.velocity) == list(right.velocity)
            assert list(left.effort) == list(right.effort)
        else:
            assert left.wrench.force.x == right.wrench.force.x
            assert left.wrench.force.y == right.wrench.force.y


def key(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


@pytest.mark.parametrize('number', [
    signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_bag_is_whole_after_signals(processes, listener, tmp_path, number):
    recorder = processes.start(RECORDER, output='bag', topics='[t]').wait_until_ready()
    publisher = heard_publisher(listener, recorder, 't')
    for index in range(100):
        publisher.publish(Float64MultiArray(data=[float(index)]))
    listener.wait(publisher.wait_for_all_acked, 'acknowledgement')
    for _ in range(3):
        if recorder.popen.poll() is None:
            recorder.send(number)
    assert recorder.wait() == 0
    assert 'Traceback' not in recorder.output
    assert without_hello([message.data[0] for _, message in read_with_mcap(
        tmp_path / 'bag')['/t']]) == list(range(100))


def publish(publisher, indices, period=0.001):
    for index in indices:
        publisher.publish(Float64MultiArray(data=[float(index)] + [0.0] * 100))
        time.sleep(period)


def recorded(bag):
    return [message.data[0] for topic, _, message in bag.messages() if topic == '/t']


@pytest.mark.parametrize('storage, compression', [('mcap', 'zstd'), ('sqlite3', 'none')])
def test_all_but_the_last_moment_survives_kill(processes, listener, tmp_path, storage,
                                               compression):
    recorder = processes.start(RECORDER, output='bag', topics='[t]', storage=storage,
                               compression=compression).wait_until_ready()
    publisher = heard_publisher(listener, recorder, 't')
    publish(publisher, range(300))
    listener.wait(publisher.wait_for_all_acked, 'acknowledgement')
    # What was received reaches the file soon; then something that may be lost.
    bag = tmp_path / 'bag'
    listener.wait(lambda: recorded(Bag(bag))[-1:] == [299] if storage == 'mcap'
                  else size_of(bag) > 300 * 800, '300 messages in the file')
    publish(publisher, range(300, 310))
    recorder.send(signal.SIGKILL)
    recorder.popen.wait()
    opened = Bag(bag)
    assert not opened.finished
    numbers = without_hello(recorded(opened))
    assert len(numbers) >= 300
    assert numbers == list(range(len(numbers)))


def size_of(bag):
    return sum(path.stat().st_size for path in bag.glob('*.db3'))


def test_full_disk_is_said_and_leaves_a_whole_bag(processes, listener, tmp_path):
    recorder = processes.start(RECORDER, output='bag', topics='[t]').wait_until_ready()
    publisher = heard_publisher(listener, recorder, 't')
    publish(publisher, range(200))
    listener.wait(lambda: recorded(Bag(tmp_path / 'bag'))[-1:] == [199], 'messages in the file')
    # To the process this is what a full disk is: a write that does not succeed.
    size = (tmp_path / 'bag' / 'bag_0.mcap').stat().st_size + 60_000
    resource.prlimit(recorder.popen.pid, resource.RLIMIT_FSIZE, (size, size))
    index = 200
    while recorder.popen.poll() is None:
        publish(publisher, [index])
        index += 1
        assert index < 60_000
    assert recorder.popen.returncode == 1
    assert "cannot go on writing the bag 'bag': File too large" in recorder.output
    assert 'what was written before can be read' in recorder.output
    assert 'Traceback' not in recorder.output
    # Not even an index has room then.
    numbers = recorded(Bag(tmp_path / 'bag'))
    assert counts(recorder)['/t'][1] == len(numbers)
    numbers = without_hello(numbers)
    assert len(numbers) >= 200
    assert numbers == list(range(len(numbers)))
