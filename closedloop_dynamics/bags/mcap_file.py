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
An MCAP file (mcap.dev, version 0) written so that an end at any moment costs little.

Messages are collected in a chunk, which goes to the file whole, unbuffered, when it
is large or when ``flush()`` is called. A file that was not finished lacks its index and
perhaps a part of its last chunk; ``salvage`` reads the rest. Where the disk is full, what
does not fit is cut off and the file is finished with what does.

"""

from dataclasses import dataclass, field
import os
import struct
import zlib

MAGIC = b'\x89MCAP0\r\n'
(HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, STATISTICS,
 METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END) = (
    1, 2, 3, 4, 5, 6, 7, 8, 0x0b, 0x0c, 0x0d, 0x0e, 0x0f)
# A chunk goes to the file when it has become larger [bytes].
CHUNK_SIZE = 768 * 1024
MESSAGE_HEAD = struct.Struct('<BQHIQQ')
BEGIN_OF_TIME, END_OF_TIME = 0, 2 ** 63 - 1


@dataclass
class Chunk:
    """Messages that go to the file together."""

    content: bytearray = field(default_factory=bytearray)
    # Times and places of the messages, by channel.
    index: dict = field(default_factory=dict)
    start: int = END_OF_TIME
    end: int = BEGIN_OF_TIME


@dataclass(frozen=True)
class Written:
    """What is kept of a chunk that is in the file."""

    offset: int
    summary: bytes
    counts: dict
    start: int
    end: int


class McapFile:
    """
    One MCAP file being written.

    Parameters
    ----------
    path : pathlib.Path
        Must not exist.
    compression : str
        ``''``, ``'zstd'`` or ``'lz4'``: of the chunks.
    compress : callable
        Compresses bytes in that way.

    Raises
    ------
    OSError
        Here and in every method: the file ends with the last whole chunk then, and can
        still be finished.

    """

    def __init__(self, path, compression, compress):
        self.path = path
        self._compression, self._compress = compression, compress
        self._file = open(path, 'xb', buffering=0)
        self._schemas, self._channels = [], []
        self._chunks = []
        self._chunk = Chunk()
        # Where the next record goes.
        self._end = 0
        self._put(MAGIC + _record(HEADER, _text('ros2') + _text('closedloop_dynamics')))

    @property
    def size(self):
        """Return the size of the file, with what waits to be written [bytes]."""
        return self._end + len(self._chunk.content)

    @property
    def counts(self):
        """Return the number of messages in the file by channel."""
        return _summed(self._chunks)

    @property
    def span(self):
        """Return the times of the first and last message in the file [ns]."""
        return _span(self._chunks)

    def add_channel(self, channel, topic, type_name, definition, profiles):
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

        """
        record = _record(SCHEMA, struct.pack('<H', channel) + _text(type_name)
                         + _text('ros2msg') + _text(definition))
        self._schemas.append(record)
        self._chunk.content += record
        record = _record(CHANNEL, struct.pack('<HH', channel, channel) + _text(topic)
                         + _text('cdr') + _sized(_text('offered_qos_profiles') + _text(profiles)))
        self._channels.append(record)
        self._chunk.content += record

    def write(self, channel, nanoseconds, data):
        """Put a message into the present chunk; write that if it has become large."""
        chunk = self._chunk
        chunk.index.setdefault(channel, []).append((nanoseconds, len(chunk.content)))
        chunk.start, chunk.end = min(chunk.start, nanoseconds), max(chunk.end, nanoseconds)
        chunk.content += MESSAGE_HEAD.pack(
            MESSAGE, 22 + len(data), channel, 0, nanoseconds, nanoseconds)
        chunk.content += data
        if len(chunk.content) > CHUNK_SIZE:
            self.flush()

    def flush(self):
        """Write the present chunk, if there is anything in it."""
        chunk, self._chunk = self._chunk, Chunk()
        if not chunk.content:
            return
        content = bytes(chunk.content)
        packed = self._compress(content)
        start = chunk.start if chunk.index else 0
        times = struct.pack('<QQ', start, chunk.end)
        kind = _text(self._compression)
        record = _record(CHUNK, times + struct.pack('<QI', len(content), zlib.crc32(content))
                         + kind + struct.pack('<Q', len(packed)) + packed)
        offset, places, indices = self._end + len(record), [], b''
        for channel, entries in chunk.index.items():
            places.append((channel, offset + len(indices)))
            indices += _record(MESSAGE_INDEX, struct.pack('<H', channel) + _sized(
                b''.join(struct.pack('<QQ', *entry) for entry in entries)))
        summary = _record(
            CHUNK_INDEX, times + struct.pack('<QQ', self._end, len(record)) + _sized(
                b''.join(struct.pack('<HQ', *place) for place in places))
            + struct.pack('<Q', len(indices)) + kind
            + struct.pack('<QQ', len(packed), len(content)))
        written = Written(self._end, summary, {
            channel: len(entries) for channel, entries in chunk.index.items()}, start, chunk.end)
        self._put(record + indices)
        self._chunks.append(written)

    def finish(self, metadata):
        """
        Write what waits, then the index; leave out the last chunks where it does not fit.

        Parameters
        ----------
        metadata : callable
            Returns the text of the bag's metadata, from what is in the file by then.

        Raises
        ------
        OSError
            Where a part of what was written before did not fit, or not even the index alone.

        """
        try:
            failure = None
            try:
                self.flush()
            except OSError as error:
                failure = error
            while True:
                try:
                    self._put(self._summary(metadata()))
                    break
                except OSError as error:
                    failure = failure or error
                    if not self._chunks:
                        raise
                    self._end = self._chunks.pop().offset
                    self._cut()
            if failure is not None:
                raise failure
        finally:
            self._file.close()

    def abandon(self):
        """Close the file as it is."""
        self._file.close()

    def _summary(self, metadata):
        """Return everything behind the last chunk."""
        record = _record(METADATA, _text('rosbag2') + _sized(
            _text('serialized_metadata') + _text(metadata)))
        data = record + _record(DATA_END, struct.pack('<I', 0))
        start = self._end + len(data)
        counts, (first, last) = _summed(self._chunks), _span(self._chunks)
        groups = (
            (SCHEMA, b''.join(self._schemas)), (CHANNEL, b''.join(self._channels)),
            (CHUNK_INDEX, b''.join(chunk.summary for chunk in self._chunks)),
            (METADATA_INDEX, _record(METADATA_INDEX, struct.pack(
                '<QQ', self._end, len(record)) + _text('rosbag2'))),
            (STATISTICS, _record(STATISTICS, struct.pack(
                '<QHIIIIQQ', sum(counts.values()), len(self._schemas), len(self._channels), 0, 1,
                len(self._chunks), first, last) + _sized(b''.join(
                    struct.pack('<HQ', *count) for count in sorted(counts.items()))))))
        summary, offsets = b'', b''
        for code, records in groups:
            if records:
                offsets += _record(SUMMARY_OFFSET, struct.pack(
                    '<BQQ', code, start + len(summary), len(records)))
                summary += records
        footer = _record(FOOTER, struct.pack('<QQI', start, start + len(summary), 0))
        return data + summary + offsets + footer + MAGIC

    def _put(self, data):
        """Write all of it, or leave the file as it was."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left):]
        except OSError:
            self._cut()
            raise
        self._end += len(data)

    def _cut(self):
        os.ftruncate(self._file.fileno(), self._end)
        self._file.seek(self._end)


def _record(code, content):
    return struct.pack('<BQ', code, len(content)) + content


def _text(text):
    return _sized(text.encode())


def _sized(data):
    return struct.pack('<I', len(data)) + data


def _summed(chunks):
    counts = {}
    for chunk in chunks:
        for channel, count in chunk.counts.items():
            counts[channel] = counts.get(channel, 0) + count
    return counts


def _span(chunks):
    chunks = [chunk for chunk in chunks if chunk.counts]
    return (min((chunk.start for chunk in chunks), default=0),
            max((chunk.end for chunk in chunks), default=0))
