# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A database file of rosbag2's sqlite3 storage (schema version 4).

What was committed by ``flush()`` survives whatever ends the process: sqlite3 takes back the
rest when the file is opened the next time. The storage has no checksums; ours are a column that
other readers do not look at.
"""

from collections import Counter
from contextlib import suppress
import sqlite3
from urllib.parse import quote
import zlib

import zstandard

from .contents import Damage, Serialised, Topic

COMPRESSIONS = ('none', 'zstd')
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
    data BLOB NOT NULL, crc32 INTEGER);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
METADATA_VERSION = 9
# Room in the file beside the messages, roughly [bytes].
OVERHEAD = 64
# What compressed messages begin with; others begin with a zero.
ZSTD = b'\x28\xb5\x2f\xfd'
# So many unreadable rows in a row, and the rest is given up.
MOST_UNREADABLE = 10_000


class SqliteFile:
    """
    One database file being written; to be used from one thread.

    ``counts``: messages in the file by channel; what was not committed goes when it is closed;
    ``span``: times of the first and last of them [ns]. OSError, here and in every method; what was
    committed before stays.
    """

    def __init__(self, path, compression, distribution):
        self.path, self.size = path, 0
        self.counts, self.span = Counter(), (0, 0)
        self._compress = (zstandard.ZstdCompressor().compress if compression == 'zstd' else bytes)
        self._committed = Counter(), (0, 0)
        self._database = sqlite3.connect(path)
        self._do(self._database.executescript, SCHEMA)
        self._do(self._database.execute, 'INSERT INTO schema VALUES (4, ?)', (distribution,))
        self.flush()

    def add_channel(self, channel, topic):
        """Add a topic; channels are numbered from 1, in this order."""
        self._do(self._database.execute, 'INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)', (
            channel, topic.name, topic.type, 'cdr', topic.profiles, topic.digest))
        self._do(
            self._database.execute,
            'INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition, '
            'type_description_hash) SELECT ?1, ?2, ?3, ?4 WHERE NOT EXISTS ('
            'SELECT 1 FROM message_definitions WHERE topic_type = ?1)',
            (topic.type, 'ros2msg', topic.definition, topic.digest))

    def write(self, channel, nanoseconds, data):
        """Put a message into the file, to be committed later."""
        data = self._compress(bytes(data))
        self._do(
            self._database.execute,
            'INSERT INTO messages (topic_id, timestamp, data, crc32) VALUES (?, ?, ?, ?)',
            (channel, nanoseconds, data, _checksum(channel, nanoseconds, data)))
        known = self.span if self.counts else (nanoseconds,)
        self.span = min(*known, nanoseconds), max(*known, nanoseconds)
        self.counts[channel] += 1
        self.size += len(data) + OVERHEAD

    def flush(self):
        """Commit all messages so far."""
        self._do(self._database.commit)
        self._committed = self.counts.copy(), self.span

    def finish(self, metadata):
        """Commit and close; ``metadata()`` returns the text of the file's metadata."""
        try:
            self.flush()
            self._do(self._database.execute,
                     'INSERT INTO metadata (metadata_version, metadata) VALUES (?, ?)',
                     (METADATA_VERSION, metadata()))
            self._do(self._database.commit)
        finally:
            self._take_back()
            self._database.close()

    def _do(self, action, *arguments):
        try:
            return action(*arguments)
        except sqlite3.Error as error:
            # On a full disk, sqlite3 has rolled back uncommitted data by itself.
            self._take_back()
            raise OSError(str(error)) from None

    def _take_back(self):
        with suppress(sqlite3.Error):
            self._database.rollback()
        counts, self.span = self._committed
        self.counts = counts.copy()


def read_database(path, name, damages):
    """
    Yield the sound messages of a database, in the order in which they were written.

    sqlite3.Error where it is no database, or its topics cannot be read.
    """
    database = sqlite3.connect(f'file:{quote(str(path))}?mode=rw', uri=True)
    try:
        topics = _topics(database)
        checked = any(column[1] == 'crc32' for column in database.execute(
            'PRAGMA table_info(messages)'))
        last = 0
        for number, *row, checksum in _rows(database, 'crc32' if checked else 'NULL'):
            if number > last + 1:
                damages.append(Damage(f'{name}, message {last + 1}', 'messages are missing',
                                      number - last - 1))
            last = number
            message = _message(topics, *row, checksum)
            if message is None:
                damages.append(Damage(f'{name}, message {number}', 'it is damaged', 1))
            else:
                yield message
        problem = _problem(database)
        if problem:
            damages.append(Damage(name, f'the database is damaged ({problem})'))
    finally:
        database.close()


def _topics(database):
    definitions = dict(database.execute(
        'SELECT topic_type, encoded_message_definition FROM message_definitions'))
    return {number: Topic(name, kind, str(definitions.get(kind, '')), str(profiles), str(digest))
            for number, name, kind, profiles, digest in database.execute(
                'SELECT id, name, type, offered_qos_profiles, type_description_hash FROM topics')}


def _rows(database, checksum):
    """Yield the rows of the messages that can be read, by their number."""
    last, failures = 0, 0
    while failures < MOST_UNREADABLE:
        try:
            for row in database.execute(
                    f'SELECT id, topic_id, timestamp, data, {checksum} FROM messages '
                    'WHERE id > ? ORDER BY id', (last,)):
                if row[0] <= last:
                    # A damaged page leads back to pages that were read: this would never end.
                    raise sqlite3.DatabaseError
                yield row
                last, failures = row[0], 0
            return
        except sqlite3.DatabaseError:
            # A page is damaged: behind it there may be others.
            last, failures = last + 1, failures + 1


def _message(topics, channel, nanoseconds, data, checksum):
    """Return a row as a message; None where it is damaged."""
    if not (channel in topics and isinstance(nanoseconds, int) and isinstance(data, bytes)):
        return None
    if checksum is not None and checksum != _checksum(channel, nanoseconds, data):
        return None
    return Serialised(topics[channel], nanoseconds, data)


def _problem(database):
    """Return the fault in the file's structure that sqlite3 finds, or None."""
    try:
        (found,), *_ = database.execute('PRAGMA quick_check(1)')
    except sqlite3.DatabaseError as error:
        return str(error)
    return None if found == 'ok' else found.splitlines()[-1]


def _checksum(channel, nanoseconds, data):
    return zlib.crc32(data, zlib.crc32(b'%d %d' % (channel, nanoseconds)))
