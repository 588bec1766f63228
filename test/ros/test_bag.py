# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of closedloop_dynamics.ros.bag, read back by other readers."""

import sys
from test.ros.bags import read_with_mcap, read_with_rosbags

from closedloop_dynamics.recording import writer
from closedloop_dynamics.ros.bag import BagError, BagWriter, MessageTypes, UnknownTypeError
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
import yaml

TYPES = MessageTypes()
STATE = 'sensor_msgs/msg/JointState'
VALUES = 'std_msgs/msg/Float64MultiArray'
COUNT = 2000


def state(index):
    # serialize_message() leaves eight bytes too many after an empty last array, which a
    # strict reader refuses; what comes over the wire has none.
    message = JointState(
        name=['a', 'b'], position=[index + 0.1, -index / 3.0], velocity=[1e-300, 1e300],
        effort=[0.0, -0.0])
    message.header.stamp.sec = index
    return message


def write(path, storage):
    """Write a bag that takes several chunks and return the writer, closed."""
    bag = BagWriter(path, storage, TYPES.typestore)
    bag.add_topic('/states', STATE, [QoSProfile(depth=5)])
    bag.add_topic('/values', VALUES, [
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)])
    padding = [0.5] * 100
    for index in range(COUNT):
        bag.write('/states', 10 ** 18 + index, serialize_message(state(index)))
        bag.write('/values', 10 ** 18 + index, serialize_message(
            Float64MultiArray(data=[float(index), *padding])))
    bag.close()
    assert bag.error is None
    return bag


@pytest.mark.parametrize('storage, read', [
    ('mcap', read_with_rosbags), ('mcap', read_with_mcap), ('sqlite3', read_with_rosbags)])
def test_every_message_comes_back_exactly(tmp_path, storage, read):
    path = tmp_path / 'bag'
    assert write(path, storage).written == {'/states': COUNT, '/values': COUNT}
    messages = read(path)
    assert sorted(messages) == ['/states', '/values']
    for index, (nanoseconds, message) in enumerate(messages['/states']):
        assert nanoseconds == 10 ** 18 + index
        expected = state(index)
        assert message.header.stamp.sec == index
        assert list(message.name) == expected.name
        assert list(message.position) == expected.position.tolist()
        assert list(message.velocity) == expected.velocity.tolist()
    assert [message.data[0] for _, message in messages['/values']] == list(range(COUNT))


def test_bag_tells_what_the_publishers_offered(tmp_path):
    write(tmp_path / 'bag', 'mcap')
    with Reader(tmp_path / 'bag') as reader:
        assert reader.message_count == 2 * COUNT
        offered = {each.topic: each.ext.offered_qos_profiles for each in reader.connections}
    assert offered['/states'][0].durability == QosDurability.VOLATILE
    assert offered['/states'][0].depth == 5
    assert offered['/values'][0].durability == QosDurability.TRANSIENT_LOCAL


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bag_without_messages_can_be_opened(tmp_path, storage):
    bag = BagWriter(tmp_path / 'bag', storage, TYPES.typestore)
    bag.close()
    assert bag.error is None
    assert read_with_rosbags(tmp_path / 'bag') == {}


def test_existing_bag_is_not_overwritten(tmp_path):
    (tmp_path / 'bag').mkdir()
    with pytest.raises(BagError, match='exists already, not overwriting'):
        BagWriter(tmp_path / 'bag', 'mcap', TYPES.typestore)
    assert not list((tmp_path / 'bag').iterdir())


def test_error_while_writing_is_kept_for_the_caller(tmp_path, monkeypatch):
    bag = BagWriter(tmp_path / 'bag', 'mcap', TYPES.typestore)

    def full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr('closedloop_dynamics.recording.writer.BagFiles.write', full)
    bag.add_topic('/states', STATE)
    for index in range(10):
        bag.write('/states', index, serialize_message(state(index)))
    bag.close()
    assert isinstance(bag.error, BagError)
    assert 'No space left on device' in str(bag.error)
    assert not bag.written.total()


@pytest.fixture
def own_package(tmp_path, monkeypatch):
    """Install a package with messages that rosbags does not know."""
    share = tmp_path / 'share' / 'own_test_msgs' / 'msg'
    share.mkdir(parents=True)
    (share / 'Outer.msg').write_text('Inner[] inners\ngeometry_msgs/Point place\n')
    (share / 'Inner.msg').write_text('int32 LIMIT=5\nfloat64 value\n')
    (share / 'Broken.msg').write_text('own_test_msgs/Missing what\n')
    package = tmp_path / 'lib' / 'site-packages' / 'own_test_msgs'
    package.mkdir(parents=True)
    (package / '__init__.py').write_text('')
    (package / 'msg.py').write_text('class Outer:\n    pass\n')
    monkeypatch.syspath_prepend(str(package.parent))
    yield
    for name in ('own_test_msgs', 'own_test_msgs.msg'):
        sys.modules.pop(name, None)


def test_definitions_of_other_packages_are_found_with_all_they_contain(own_package):
    types = MessageTypes()
    assert types.message_class('own_test_msgs/msg/Outer').__name__ == 'Outer'
    definition, _ = types.typestore.generate_msgdef('own_test_msgs/msg/Outer', ros_version=2)
    assert 'MSG: own_test_msgs/Inner' in definition
    assert 'MSG: geometry_msgs/Point' in definition
    assert 'LIMIT=5' in definition


@pytest.mark.parametrize('name, problem', [
    ('no_such_msgs/msg/Thing', 'package no_such_msgs is not installed'),
    ('own_test_msgs/msg/Nothing', 'no Nothing.msg'),
    ('own_test_msgs/msg/Broken', 'no Missing.msg'),
    ('own_test_msgs/msg/Inner', 'no Python messages'),
])
def test_types_that_are_not_installed_are_named(own_package, name, problem):
    with pytest.raises(UnknownTypeError, match=problem):
        MessageTypes().message_class(name)


@pytest.mark.parametrize('distribution', ['jazzy', 'kilted', 'lyrical', 'rolling'])
def test_bag_names_its_distribution_and_has_its_types(tmp_path, monkeypatch, distribution):
    monkeypatch.setenv('ROS_DISTRO', distribution)
    types = MessageTypes()
    bag = BagWriter(tmp_path / 'bag', 'mcap', types.typestore)
    bag.add_topic('/states', STATE, [QoSProfile(depth=5)])
    bag.write('/states', 5, serialize_message(state(3)))
    bag.close()
    facts = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    assert facts['rosbag2_bagfile_information']['ros_distro'] == distribution
    (time, message), = read_with_mcap(tmp_path / 'bag')['/states']
    assert (time, message.header.stamp.sec) == (5, 3)


def test_bag_names_the_wheels_where_no_distribution_is_sourced(monkeypatch):
    monkeypatch.delenv('ROS_DISTRO', raising=False)
    monkeypatch.setattr(writer, 'version', {'ros-kilted-rclpy': '9.1.2'}.__getitem__)
    monkeypatch.setattr(writer, 'PackageNotFoundError', KeyError)
    assert writer.distribution() == 'kilted'
