# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Read bags with readers that know nothing of how they were written."""

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg, get_typestore, Stores


def read_with_rosbags(path):
    """
    Return the messages of a bag, decoded with nothing but its own type definitions.

    Parameters
    ----------
    path : Path
        The directory.

    Returns
    -------
    dict
        Topic to list of (time of reception in ns, message).

    """
    messages = {}
    with Reader(path) as reader:
        store = get_typestore(Stores.EMPTY)
        for connection in reader.connections:
            messages[connection.topic] = []
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            assert store.hash_rihs01(connection.msgtype) == connection.digest
        for connection, nanoseconds, data in reader.messages():
            messages[connection.topic].append(
                (nanoseconds, store.deserialize_cdr(data, connection.msgtype)))
    return messages


def read_with_mcap(path):
    """Return the same from the file of an mcap bag, through the library of its format."""
    messages = {}
    with (path / f'{path.name}_0.mcap').open('rb') as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for channel in reader.get_summary().channels.values():
            messages[channel.topic] = []
        for _, channel, raw, message in reader.iter_decoded_messages():
            messages[channel.topic].append((raw.log_time, message))
    return messages
