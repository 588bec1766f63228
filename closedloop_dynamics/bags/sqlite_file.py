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
A database file of rosbag2's sqlite3 storage (schema version 4).

What was committed by ``flush()`` survives whatever ends the process: sqlite3 takes back the
rest when the file is opened the next time.

"""

import sqlite3

SCHEMA = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(
    id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(
    id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
    serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
    type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(
    id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
    encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(
    id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
    data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
METADATA_VERSION = 9
# Room in the file beside the messages, roughly [bytes].
OVERHEAD = 64


class SqliteFile:
    """
    One database file being written; to be used from one thread.

    Parameters
    ----------
    path : pathlib.Path
        Must not exist.
    distribution : str
        Of ROS.

    Raises
    ------
    OSError
        Here and in every method. What was committed before stays.

    """

    def __init__(self, path, distribution):
        self.path = path
        self.size = 0
        self.counts = {}
        self._committed = {}, (0, 0)
        self._span = None
        self._database = sqlite3.connect(path)
        self._do(lambda: self._database.executescript(SCHEMA))
        self._do(lambda: self._database.execute(
            'INSERT INTO schema VALUES (4, ?)', (distribution,)))
        self.flush()

    @property
    def span(self):
        """Return the times of the first and last message in the file [ns]."""
        return self._span or (0, 0)

    def add_channel(self, channel, topic, type_name, definition, profiles, digest):
        """
        Make a topic known.

        Parameters
        ----------
        channel : int
            Number of the topic, from 1.
        topic, type_name, definition : str
            Full name, ``package/msg/Type``, and the text of its definition.
        profiles : str
            Offered qualities of service, as YAML.
        digest : str
            Of the type.

        """
        def add():
            self._database.execute('INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)', (
                channel, topic, type_name, 'cdr', profiles, digest))
            known = self._database.execute(
                'SELECT 1 FROM message_definitions WHERE topic_type = ?', (type_name,)).fetchone()
            if not known:
                self._database.execute(
                    'INSERT INTO message_definitions (topic_type, encoding, '
                    'encoded_message_definition, type_description_hash) VALUES (?, ?, ?, ?)',
                    (type_name, 'ros2msg', definition, digest))

        self._do(add)

    def write(self, channel, nanoseconds, data):
        """Put a message into the file, to be committed later."""
        self._do(lambda: self._database.execute(
            'INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)',
            (channel, nanoseconds, data)))
        self.counts[channel] = self.counts.get(channel, 0) + 1
        first, last = self._span or (nanoseconds, nanoseconds)
        self._span = min(first, nanoseconds), max(last, nanoseconds)
        self.size += len(data) + OVERHEAD

    def flush(self):
        """Commit all messages so far."""
        self._do(self._database.commit)
        self._committed = dict(self.counts), self._span

    def finish(self, metadata):
        """
        Commit and close.

        Parameters
        ----------
        metadata : callable
            Returns the text of the bag's metadata, from what is in the file by then.

        """
        try:
            self.flush()
            self._do(lambda: self._database.execute(
                'INSERT INTO metadata (metadata_version, metadata) VALUES (?, ?)',
                (METADATA_VERSION, metadata())))
            self._do(self._database.commit)
        finally:
            self.abandon()

    def abandon(self):
        """Close without what was not committed."""
        self.counts, self._span = dict(self._committed[0]), self._committed[1]
        self._database.close()

    def _do(self, action):
        try:
            return action()
        except sqlite3.Error as error:
            raise OSError(str(error)) from None
