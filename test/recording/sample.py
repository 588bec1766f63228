# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Messages to fill bags with; light, for processes of their own."""

from closedloop_dynamics.recording.contents import Topic
from closedloop_dynamics.recording.writer import BagFiles
import numpy as np
from rosbags.typesys import get_typestore, Stores

__all__ = ['BagFiles']
STORE = get_typestore(Stores.ROS2_JAZZY)
VALUES = 'std_msgs/msg/Float64MultiArray'
TEXT = 'std_msgs/msg/String'
QOS = [{'history': 'keep_last', 'depth': 5, 'reliability': 'reliable', 'durability': 'volatile',
        'deadline': {'sec': 0, 'nsec': 0}, 'lifespan': {'sec': 0, 'nsec': 0},
        'liveliness': 'automatic', 'liveliness_lease_duration': {'sec': 0, 'nsec': 0},
        'avoid_ros_namespace_conventions': False}]


def add(files, topic, kind, profiles=QOS):
    definition, _ = STORE.generate_msgdef(kind, ros_version=2)
    return files.add_topic(Topic(
        topic, kind, definition, STORE.hash_rihs01(kind), tuple(profiles)))


def values(index, size=50):
    message = STORE.types[VALUES](
        layout=STORE.types['std_msgs/msg/MultiArrayLayout'](dim=[], data_offset=0),
        data=np.full(size, index / 3.0))
    return bytes(STORE.serialize_cdr(message, VALUES))


def text(index):
    return bytes(STORE.serialize_cdr(STORE.types[TEXT](data=f'gr\u00fcezi {index}'), TEXT))


def write(files, count, first=0):
    """Write count messages to each of two topics."""
    numbers, words = add(files, '/numbers', VALUES), add(files, '/words', TEXT)
    for index in range(first, first + count):
        files.write(numbers, 1000 + index, values(index))
        files.write(words, 1000 + index, text(index))
