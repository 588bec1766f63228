# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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
