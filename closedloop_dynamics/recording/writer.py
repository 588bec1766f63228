# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A rosbag2 bag (format version 9) being written, so that an end at any moment costs little.

The libraries' own writers do not do that: killed, that of ``rosbags`` leaves an MCAP file without
its last megabyte, and no message at all in a database.
"""

from collections import Counter
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
import os
from pathlib import Path
import sqlite3
import zlib

from .contents import dump, METADATA_FILE, ROOT
from ..mechanism.extras import of_an_extra

with of_an_extra():
    from mcap.writer import CompressionType, Writer
    import zstandard

FORMAT_VERSION = 9
# Distributions of ROS, newest first.
DISTRIBUTIONS = ('lyrical', 'kilted', 'jazzy')
# What each storage can be compressed with.
COMPRESSIONS = {'mcap': ('none', 'zstd', 'lz4'), 'sqlite3': ('none', 'zstd')}
# A chunk of an MCAP file is written when it has become larger [bytes].
CHUNK_SIZE = 256 * 1024
# Kept free for the last chunk, the index and the metadata, should the disk be full [bytes].
RESERVE_FILE, RESERVE = '.reserve', 4 * CHUNK_SIZE
# Room in a database beside the data of a message, roughly [bytes].
OVERHEAD = 64
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


class BagFiles:
    """
    Write messages into the files of one bag, a directory that must not exist.

    ``storage``: ``'mcap'`` or ``'sqlite3'``; ``compression``: one of ``COMPRESSIONS[storage]``, of
    whole chunks in MCAP, of single messages in sqlite3; a file that has become larger than
    ``max_size`` is followed by another one [bytes]; 0: never. OSError, here and in every method;
    after it, ``close()`` keeps what is in the files.
    """

    def __init__(self, path, storage, compression='none', max_size=0.0):
        self.path = Path(path)
        self._storage, self._compression, self._max_size = storage, compression, max_size
        self._topics = []
        # All of them, and the present one, which is not finished.
        self._files, self._file = [], None
        self.path.mkdir(parents=True)
        with suppress(OSError), open(self.path / RESERVE_FILE, 'xb') as file:
            os.posix_fallocate(file.fileno(), 0, RESERVE)
        self._open()

    @property
    def counts(self):
        """Return the number of messages in the files by topic; exact after a flush."""
        counts = sum((file.counts for file in self._files), Counter())
        return {topic.name: counts[channel] for channel, topic in enumerate(self._topics, 1)}

    def add_topic(self, topic):
        """Register a topic; return its number for ``write``."""
        self._topics.append(topic)
        self._file.add_channel(len(self._topics), topic)
        return len(self._topics)

    def write(self, channel, nanoseconds, data):
        """Write a message."""
        if self._max_size and self._file.size > self._max_size:
            self._finish()
            self._open()
        self._file.write(channel, nanoseconds, data)
        self._file.check()

    def flush(self):
        """Bring everything so far into the file."""
        self._file.flush()
        self._file.check()

    def close(self):
        """Finish the files and their metadata."""
        self._make_room()
        self._finish()

    def _open(self):
        kind, suffix = {'mcap': (McapFile, '.mcap'), 'sqlite3': (SqliteFile, '.db3')}[
            self._storage]
        path = self.path / f'{self.path.name}_{len(self._files)}{suffix}'
        self._file = kind(path, self._compression, self._make_room)
        self._files.append(self._file)
        for channel, topic in enumerate(self._topics, 1):
            self._file.add_channel(channel, topic)

    def _finish(self):
        """Finish the present file, then name it in the metadata, which are replaced at once."""
        file, self._file = self._file, None
        try:
            if file is not None:
                file.finish(lambda: dump(self._metadata([file])))
                file.check()
        finally:
            draft = self.path / f'.{METADATA_FILE}'
            draft.write_text(dump({ROOT: self._metadata(self._files)}), encoding='utf-8')
            draft.replace(self.path / METADATA_FILE)

    def _make_room(self):
        """Release the space kept free."""
        with suppress(OSError):
            (self.path / RESERVE_FILE).unlink()

    def _metadata(self, files):
        counts = sum((file.counts for file in files), Counter())
        spans = [file.span for file in files if file.counts]
        start, end = (min(first for first, _ in spans), max(last for _, last in spans)) if (
            spans) else (0, 0)
        by_message = self._storage == 'sqlite3' and self._compression != 'none'
        return {
            'version': FORMAT_VERSION,
            'storage_identifier': self._storage,
            'duration': {'nanoseconds': end - start},
            'starting_time': {'nanoseconds_since_epoch': start},
            'message_count': counts.total(),
            'topics_with_message_count': [{
                'topic_metadata': {
                    'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                    'offered_qos_profiles': list(topic.profiles),
                    'type_description_hash': topic.digest},
                'message_count': counts[channel],
            } for channel, topic in enumerate(self._topics, 1)],
            'compression_format': self._compression if by_message else '',
            'compression_mode': 'message' if by_message else '',
            'relative_file_paths': [file.path.name for file in files],
            'files': [{
                'path': file.path.name,
                'starting_time': {'nanoseconds_since_epoch': file.span[0]},
                'duration': {'nanoseconds': file.span[1] - file.span[0]},
                'message_count': file.counts.total(),
            } for file in files],
            'custom_data': None,
            'ros_distro': distribution(),
        }


class _File:
    """
    One file of a bag, which must not exist; to be used from one thread.

    ``make_room`` is called where the disk is full, before a second and last attempt. ``counts``:
    messages that are safely in the file, by channel; ``span``: times of the first and last of them
    [ns]; ``size``: of the file with what waits to be written [bytes]. Channels are numbered from
    1, in the order in which they are added. OSError in every method; what is counted stays.
    """

    def __init__(self, path, make_room):
        self.path, self.size, self._make_room = path, 0, make_room
        self.counts, self.span = Counter(), (0, 0)
        self._waiting = []
        self._failure = None

    def check(self):
        """Raise the error that writing met, even if there was room for the second attempt."""
        if self._failure is not None:
            raise self._failure

    def _keep(self):
        """Count the messages that waited as safe."""
        if self._waiting:
            channels, times = zip(*self._waiting)
            times += self.span if self.counts else ()
            self.counts.update(channels)
            self.span = min(times), max(times)
            self._waiting = []


class _Buffer(BytesIO):
    """What the library for MCAP writes to: data that are not yet in the file."""

    start = 0

    def tell(self):
        """Return the place in the file."""
        return self.start + super().tell()


class McapFile(_File):
    """
    A file in MCAP (mcap.dev, version 0) that ends with a whole chunk whenever that is.

    A chunk goes to the file when it is large or when ``flush()`` is called, whole and with its
    index, or not at all.
    """

    def __init__(self, path, compression, make_room):
        super().__init__(path, make_room)
        self._file, self.buffer = open(path, 'xb', buffering=0), _Buffer()
        self._writer = Writer(self.buffer, CHUNK_SIZE, CompressionType[compression.upper()])
        self._writer.start('ros2', 'closedloop_dynamics')
        self._schemas = {}
        self._put()

    def add_channel(self, channel, topic):
        """Add a topic."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                topic.type, 'ros2msg', topic.definition.encode())
        self._writer.register_channel(topic.name, 'cdr', self._schemas[topic.type], {
            'offered_qos_profiles': dump(list(topic.profiles))})

    def write(self, channel, nanoseconds, data):
        """Put a message into the present chunk; write that if it has become large."""
        self._writer.add_message(channel, nanoseconds, data, nanoseconds)
        self._waiting.append((channel, nanoseconds))
        self.size += len(data)
        if self.buffer.getbuffer():
            self._put()

    def flush(self):
        """Write the present chunk, if there is anything in it."""
        self._writer.flush()
        self._put()

    def finish(self, metadata):
        """Write what waits, then the index; ``metadata()`` returns the accompanying text."""
        try:
            self.flush()
            self._writer.add_metadata('rosbag2', {'serialized_metadata': metadata()})
            self._writer.finish()
            self._put()
        finally:
            self._file.close()

    def _put(self):
        try:
            self.put_once()
        except OSError as error:
            self._failure = self._failure or error
            self._make_room()
            self.put_once()
        self._keep()

    def put_once(self):
        """Write the buffer to the file, or leave the file as it was."""
        left = memoryview(self.buffer.getvalue())
        try:
            while left:
                left = left[self._file.write(left):]
        except OSError:
            os.ftruncate(self._file.fileno(), self.buffer.start)
            self._file.seek(self.buffer.start)
            raise
        self.size = self._file.tell()
        self.buffer.seek(0)
        self.buffer.truncate()
        self.buffer.start = self.size


class SqliteFile(_File):
    """
    A database of rosbag2's sqlite3 storage (schema version 4).

    What was committed by ``flush()`` survives whatever ends the process: sqlite3 takes back the
    rest when the file is opened the next time. The storage has no checksums; ours are a column
    that other readers do not look at.
    """

    def __init__(self, path, compression, make_room):
        super().__init__(path, make_room)
        self._compress = zstandard.ZstdCompressor().compress if compression == 'zstd' else bytes
        self._database = sqlite3.connect(path)
        with self._errors():
            self._database.executescript(SCHEMA)
            self._insert('schema', 4, distribution())
        self.flush()

    def add_channel(self, channel, topic):
        """Add a topic."""
        with self._errors():
            self._insert('topics', channel, topic.name, topic.type, 'cdr',
                         dump(list(topic.profiles)), topic.digest)
            if not self._database.execute('SELECT 1 FROM message_definitions WHERE topic_type = ?',
                                          (topic.type,)).fetchone():
                self._insert('message_definitions', None, topic.type, 'ros2msg', topic.definition,
                             topic.digest)

    def write(self, channel, nanoseconds, data):
        """Put a message into the file, to be committed later."""
        data = self._compress(bytes(data))
        with self._errors():
            self._insert('messages', None, channel, nanoseconds, data,
                         checksum(channel, nanoseconds, data))
        self._waiting.append((channel, nanoseconds))
        self.size += len(data) + OVERHEAD

    def flush(self):
        """Commit all messages so far."""
        with self._errors():
            self._database.commit()
        self._keep()

    def finish(self, metadata):
        """Commit and close; ``metadata()`` returns the text of the file's metadata."""
        try:
            self.flush()
            with self._errors():
                self._insert('metadata', None, FORMAT_VERSION, metadata())
                self._database.commit()
        finally:
            self._database.close()

    def _insert(self, table, *values):
        self._database.execute(
            f'INSERT INTO {table} VALUES ({", ".join("?" * len(values))})', values)

    @contextmanager
    def _errors(self):
        """Take back what was not committed where the body fails, with an OSError."""
        try:
            yield
        except sqlite3.Error as error:
            self._waiting = []
            # On a full disk, sqlite3 has rolled it back by itself.
            with suppress(sqlite3.Error):
                self._database.rollback()
            raise OSError(str(error)) from None


def checksum(channel, nanoseconds, data):
    """Return what the database has beside a message."""
    return zlib.crc32(data, zlib.crc32(b'%d %d' % (channel, nanoseconds)))


def distribution():
    """Return the distribution of ROS that is sourced, or whose wheels are installed."""
    return os.environ.get('ROS_DISTRO') or next(
        (name for name in DISTRIBUTIONS if _is_installed(f'ros-{name}-rclpy')), DISTRIBUTIONS[-1])


def _is_installed(package):
    try:
        return bool(version(package))
    except PackageNotFoundError:
        return False
