# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Make a whole bag of one that was cut short or damaged."""

from dataclasses import replace

from rosbags.typesys import get_typestore, Stores

from .contents import Damage
from .metadata import normalised
from .reading import Bag, define
from .writer import BagFiles


def recover(path, output):
    """
    Copy the sound part of a bag into a new one, with index and metadata.

    Returns the numbers of messages copied, by topic, and the old Bag with its ``damages``. Raises
    OSError if there is no bag, or the new one cannot be written.
    """
    bag = Bag(path)
    store = get_typestore(Stores.EMPTY)
    files = BagFiles(output, 'mcap')
    channels = {}
    try:
        for message in bag.serialised():
            topic = message.topic
            if topic not in channels:
                channels[topic] = files.add_topic(replace(
                    topic, digest=_digest(store, topic, bag.damages),
                    profiles=normalised(topic.profiles)))
            files.write(channels[topic], message.time, message.data)
    finally:
        files.close()
    return files.counts, bag


def _digest(store, topic, damages):
    """Return the hash of a topic's type; none where its definition cannot be read."""
    try:
        return define(store, topic)
    except Exception as error:
        # Whatever garbage makes the parser raise.
        damages.append(Damage(topic.name, f'the definition of {topic.type} cannot be read '
                              f'({" ".join(str(error).split())})', 0))
        return ''
