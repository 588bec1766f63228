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

"""Make a whole bag of one whose recording was cut short."""

from rosbags.typesys import get_typestore, Stores

from .reading import Bag, define
from .writer import BagFiles


def recover(path, output):
    """
    Copy whatever can be read of a bag into a new one, with index and metadata.

    Parameters
    ----------
    path : pathlib.Path
        The bag that was cut short, or one of its files.
    output : pathlib.Path
        Directory of the new bag, MCAP; must not exist.

    Returns
    -------
    dict of str to int
        Messages by topic.

    Raises
    ------
    OSError
        If there is no bag, or the new one cannot be written.

    """
    bag = Bag(path)
    store = get_typestore(Stores.EMPTY)
    files = BagFiles(output, 'mcap')
    channels = {}
    try:
        for message in bag.serialised():
            topic = message.topic
            if topic not in channels:
                define(store, topic)
                channels[topic] = files.add_topic(
                    topic.name, topic.type, topic.definition, store.hash_rihs01(topic.type), [])
            files.write(channels[topic], message.time, message.data)
    finally:
        files.close()
    return files.counts
