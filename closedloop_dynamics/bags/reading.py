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

"""
Read rosbag2 bags with nothing but their own type definitions, finished or not.

A recording that was killed has no ``metadata.yaml`` and no index in its last file;
everything else in it is read.

"""

from dataclasses import dataclass
from pathlib import Path
import sqlite3

from rosbags.rosbag2 import Reader, ReaderError
from rosbags.typesys import get_types_from_msg, get_typestore, Stores, TypesysError
from rosbags.typesys.store import Typestore

from .salvage import decompressed, is_finished, salvage, Topic
from .writer import METADATA_FILE

# What compressed messages begin with; others begin with a zero.
ZSTD = b'\x28\xb5\x2f\xfd'


class BagReadError(OSError):
    """A bag that cannot be read; the message says why."""


@dataclass(frozen=True)
class Serialised:
    """One message of a bag, as it was serialised."""

    topic: Topic
    time: int
    data: bytes


class Bag:
    """
    A bag opened for reading.

    Parameters
    ----------
    path : path-like
        Its directory, or one of its files.

    Attributes
    ----------
    finished : bool
        Whether the recording came to its end in order.

    Raises
    ------
    BagReadError
        If there is no bag.

    """

    def __init__(self, path):
        self.path = Path(path)
        if self.path.is_dir():
            self._files = sorted(
                (file for file in self.path.iterdir() if file.suffix in ('.mcap', '.db3')),
                key=_number)
        else:
            self._files = [self.path] if self.path.suffix in ('.mcap', '.db3') else []
        if not self._files or not self.path.exists():
            raise BagReadError(
                f'{self.path}: expected a rosbag2 bag (a directory with .mcap or .db3 files, or '
                f'one of them), got {"nothing of the kind" if self.path.exists() else "nothing"}')
        self.finished = self._is_finished(self._files[-1])
        self._store = get_typestore(Stores.EMPTY)
        self._known = {}

    def _is_finished(self, last):
        """Return whether the last file is whole, and the metadata knows of it."""
        if last.suffix == '.mcap' and not is_finished(last):
            return False
        metadata = self.path / METADATA_FILE
        return self.path.is_file() or metadata.is_file() and last.name in metadata.read_text()

    def serialised(self):
        """Yield all messages, ``Serialised``, in the order of their times in each file."""
        try:
            if self.finished:
                yield from _read(self.path)
                return
            for file in self._files:
                if file.suffix == '.db3':
                    yield from _read_database(file)
                elif is_finished(file):
                    yield from _read(file)
                else:
                    yield from (Serialised(*message) for message in salvage(file))
        except (ReaderError, sqlite3.Error) as error:
            raise BagReadError(f'{self.path}: {error}') from None

    def messages(self, wanted=None):
        """
        Yield topic name, time of reception [ns] and message, decoded.

        Parameters
        ----------
        wanted : callable, optional
            Takes a topic's name; whether its messages are to be decoded.

        """
        for message in self.serialised():
            if wanted is None or wanted(message.topic.name):
                yield message.topic.name, message.time, self._decoded(message)

    def _decoded(self, message):
        kind = message.topic.type
        if kind not in self._known:
            self._known[kind] = self._define(message.topic)
        return self._store.deserialize_cdr(message.data, kind)

    def _define(self, topic):
        try:
            define(self._store, topic)
        except TypesysError as error:
            raise BagReadError(
                f'{self.path}: the definition of {topic.type} cannot be read ({error})') from None


def define(store: Typestore, topic):
    """Make a type store know the type of a topic, by the definition in the bag."""
    if topic.type not in store.fielddefs:
        types = get_types_from_msg(topic.definition, topic.type)
        store.register({name: fields for name, fields in types.items()
                        if name not in store.fielddefs})


def _read(path):
    """Yield the messages of a finished bag or file."""
    with Reader(path) as reader:
        topics = {connection.id: Topic(
            connection.topic, connection.msgtype, connection.msgdef.data)
            for connection in reader.connections}
        for connection, nanoseconds, data in reader.messages():
            yield Serialised(topics[connection.id], nanoseconds, bytes(data))


def _read_database(path):
    """Yield the messages of a database that was perhaps not closed."""
    # Opening it for writing takes back what was not committed.
    database = sqlite3.connect(path)
    try:
        definitions = dict(database.execute(
            'SELECT topic_type, encoded_message_definition FROM message_definitions'))
        topics = {number: Topic(name, kind, definitions.get(kind, ''))
                  for number, name, kind in database.execute('SELECT id, name, type FROM topics')}
        for number, nanoseconds, data in database.execute(
                'SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id'):
            if data.startswith(ZSTD):
                data = decompressed(data, 'zstd')
            yield Serialised(topics[number], nanoseconds, data)
    finally:
        database.close()


def _number(path):
    """Return what sorts the files of a bag: NAME_10 comes after NAME_9."""
    stem, _, number = path.stem.rpartition('_')
    return (stem, int(number)) if number.isdigit() else (path.stem, -1)
