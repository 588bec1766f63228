# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Bags where only ROS reads them.

The Python package index has no rosbag2_py: a stand-in with its interface reads the bags.
"""

import importlib.util
import sys
from types import ModuleType, SimpleNamespace

from closedloop_dynamics.recording import rosbag2
from closedloop_dynamics.recording.reading import Bag
import pytest

from .sample import BagFiles, write


class Reader:
    """Reads as rosbag2_py.SequentialReader does."""

    def open(self, storage, converter):  # noqa: A003
        try:
            self._messages = list(Bag(storage.uri).serialised())
        except OSError as error:
            raise RuntimeError(str(error)) from None

    def get_all_topics_and_types(self):
        found = {message.topic.name: message.topic.type for message in self._messages}
        return [SimpleNamespace(name=name, type=kind) for name, kind in found.items()]

    def has_next(self):
        return bool(self._messages)

    def read_next(self):
        message = self._messages.pop(0)
        return message.topic.name, bytes(message.data), message.time


@pytest.fixture
def only_ros(monkeypatch):
    """Hide the Python readers from the choice, and put the stand-in there."""
    module = ModuleType('rosbag2_py')
    module.SequentialReader = Reader
    module.StorageOptions = lambda uri, storage_id: SimpleNamespace(uri=uri)
    module.ConverterOptions = lambda *formats: None
    monkeypatch.setitem(sys.modules, 'rosbag2_py', module)
    monkeypatch.setattr(rosbag2, 'find_spec', lambda name: (
        None if name in ('rosbags', 'mcap') else 'there' if name == 'rosbag2_py'
        else importlib.util.find_spec(name)))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_ros_reads_the_same_messages(only_ros, tmp_path, storage):
    files = BagFiles(tmp_path / 'bag', storage)
    write(files, 20)
    files.close()
    found = list(rosbag2.open_bag(tmp_path / 'bag').messages())
    expected = list(Bag(tmp_path / 'bag').messages())
    assert isinstance(rosbag2.open_bag(tmp_path / 'bag'), rosbag2.RosBag) and len(found) == 40
    for (topic, time, message), (name, moment, other) in zip(found, expected):
        assert (topic, time) == (name, moment)
        assert (message.data == other.data if topic == '/words'
                else message.data.tolist() == other.data.tolist())
    wanted = rosbag2.open_bag(tmp_path / 'bag').messages('/words'.__eq__)
    assert {topic for topic, *_ in wanted} == {'/words'}


def test_bag_that_ros_does_not_open_is_reported_with_a_remedy(only_ros, tmp_path):
    with pytest.raises(OSError, match='rosbag2_py cannot open it.*pip install rosbags mcap'):
        rosbag2.open_bag(tmp_path / 'nowhere')


def test_messages_before_a_damage_are_used_and_it_is_reported(only_ros, tmp_path, monkeypatch):
    files = BagFiles(tmp_path / 'bag', 'mcap')
    write(files, 20)
    files.close()
    read_next = Reader.read_next

    def damaged(reader):
        if len(reader._messages) == 10:
            raise RuntimeError('chunk is\ndamaged')
        return read_next(reader)

    monkeypatch.setattr(Reader, 'read_next', damaged)
    bag = rosbag2.open_bag(tmp_path / 'bag')
    assert len(list(bag.messages())) == 30
    with pytest.warns(UserWarning, match='rosbag2_py reads no further: chunk is damaged'):
        bag.warn()
