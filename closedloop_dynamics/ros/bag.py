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

"""A rosbag2 bag, written from a thread of its own."""

from collections import Counter
from pathlib import Path
from queue import SimpleQueue
import sqlite3
from threading import Event
from threading import Thread

from rosbags.interfaces import Qos
from rosbags.interfaces import QosDurability
from rosbags.interfaces import QosHistory
from rosbags.interfaces import QosLiveliness
from rosbags.interfaces import QosReliability
from rosbags.interfaces import QosTime
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer
from rosbags.rosbag2 import WriterError

STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
FORMAT_VERSION = 9
NANOSECONDS = 10 ** 9


class BagError(OSError):
    """A bag that cannot be written; the message says why."""


class BagWriter:
    """
    Write serialised messages into a bag without keeping the caller waiting.

    Parameters
    ----------
    path : path-like
        Directory of the bag; must not exist.
    storage : str
        ``'mcap'`` or ``'sqlite3'``.
    typestore : rosbags.typesys.store.Typestore
        Where the definitions of the types are taken from.

    Attributes
    ----------
    written : Counter
        Messages in the bag, by topic.
    error : BagError or None
        What ended the writing early; from then on nothing is written.

    Raises
    ------
    BagError
        If the bag exists or cannot be created.

    """

    def __init__(self, path, storage, typestore):
        self.path = Path(path)
        self.written = Counter()
        self.error = None
        self._plugin = STORAGES[storage]
        self._typestore = typestore
        self._queue = SimpleQueue()
        self._opened = Event()
        # sqlite3 wants all calls from one thread, so the bag lives in there.
        self._thread = Thread(target=self._work, name='bag_writer', daemon=True)
        self._thread.start()
        self._opened.wait()
        if self.error is not None:
            raise self.error

    def add_topic(self, topic, type_name, profiles=()):
        """
        Make a topic known; to be called once, before its first message.

        Parameters
        ----------
        topic : str
            Full name.
        type_name : str
            ``package/msg/Type``, known to the typestore.
        profiles : sequence of rclpy.qos.QoSProfile
            What the publishers offer.

        """
        offered = [_offered(profile) for profile in profiles]
        self._queue.put(lambda writer, connections: connections.update({
            topic: writer.add_connection(
                topic, type_name, typestore=self._typestore, offered_qos_profiles=offered)}))

    def write(self, topic, nanoseconds, data):
        """
        Put one message into the bag, soon.

        Parameters
        ----------
        topic : str
            Made known by ``add_topic``.
        nanoseconds : int
            Time of reception.
        data : bytes
            The message as it was serialised.

        """
        self._queue.put((topic, nanoseconds, data))

    def close(self):
        """Write everything that waits, then the index; an error ends up in ``error``."""
        self._queue.put(None)
        self._thread.join()

    def _work(self):
        try:
            with Writer(self.path, version=FORMAT_VERSION, storage_plugin=self._plugin) as writer:
                self._opened.set()
                self._drain(writer)
        except (WriterError, OSError, sqlite3.Error) as error:
            self.error = BagError(f"cannot write the bag '{self.path}': {error}")
        finally:
            self._opened.set()

    def _drain(self, writer):
        connections = {}
        while (item := self._queue.get()) is not None:
            if callable(item):
                item(writer, connections)
                continue
            topic, nanoseconds, data = item
            writer.write(connections[topic], nanoseconds, data)
            self.written[topic] += 1


def _offered(profile):
    """Translate a quality of service from rclpy's words into those of the bag."""
    return Qos(
        QosHistory[profile.history.name], profile.depth,
        QosReliability[profile.reliability.name], QosDurability[profile.durability.name],
        _duration(profile.deadline), _duration(profile.lifespan),
        QosLiveliness[profile.liveliness.name], _duration(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions)


def _duration(duration):
    return QosTime(*divmod(duration.nanoseconds, NANOSECONDS))
