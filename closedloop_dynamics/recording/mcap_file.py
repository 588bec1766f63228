# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
MCAP files (mcap.dev, version 0): an end at any moment costs little, and so does damage.

``mcap`` writes. Messages are collected in a chunk, which goes to the file when it is large or
when ``flush()`` is called, whole and with its index, or not at all. Reading needs no index of the
file: chunks are checked by their checksums, and behind a damaged one the next one is looked for.
"""

from collections import Counter
from dataclasses import replace
from io import BytesIO
import mmap
import os
import re
import struct

from lz4.frame import LZ4FrameDecompressor
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import breakup_chunk
from mcap.writer import CompressionType, MCAP0_MAGIC, Writer
import zstandard

from .contents import Damage, Serialised, Topic

COMPRESSIONS = {'none': CompressionType.NONE, 'zstd': CompressionType.ZSTD,
                'lz4': CompressionType.LZ4}
PROFILES = 'offered_qos_profiles'
# A chunk goes to the file when it has become larger [bytes].
CHUNK_SIZE = 256 * 1024
# In place of unpacking more, a chunk counts as damaged [bytes].
LARGEST_CHUNK = 2 ** 31
# Records outside chunks, by their code.
KINDS = {
    Opcode.HEADER: records.Header, Opcode.SCHEMA: records.Schema, Opcode.CHANNEL: records.Channel,
    Opcode.MESSAGE: records.Message, Opcode.CHUNK: records.Chunk,
    Opcode.MESSAGE_INDEX: records.MessageIndex, Opcode.ATTACHMENT: records.Attachment,
    Opcode.METADATA: records.Metadata, Opcode.DATA_END: records.DataEnd}
# Code and size of a chunk of less than a terabyte.
CHUNK_HEAD = re.compile(b'\x06.{5}\0\0\0', re.DOTALL)


class McapFile:
    """
    One MCAP file being written, which must not exist.

    ``compression``: of the chunks, one of ``COMPRESSIONS``; ``make_room`` is called where the disk
    is full, before a second and last attempt. ``counts``: messages in the file by channel;
    ``span``: times of the first and last of them [ns].

    OSError, here and in every method: the file ends with a whole chunk then. It can still be
    finished where there was room for that; otherwise it stays without an index.
    """

    def __init__(self, path, compression, make_room):
        self.path = path
        self.counts, self.span = Counter(), (0, 0)
        self._stream = Stream(path, make_room)
        self._writer = Writer(self._stream, CHUNK_SIZE, COMPRESSIONS[compression])
        self._writer.start('ros2', 'closedloop_dynamics')
        self._stream.flush()
        self._schemas = {}
        # Channel and time of the messages that are not yet in the file, and their size.
        self._waiting, self._size = [], 0

    @property
    def size(self):
        """Return the size of the file with the buffer [bytes]."""
        return self._stream.tell() + self._size

    def add_channel(self, channel, topic):
        """Add a topic; channels are numbered from 1, in this order."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                topic.type, 'ros2msg', topic.definition.encode())
        self._writer.register_channel(
            topic.name, 'cdr', self._schemas[topic.type], {PROFILES: topic.profiles})

    def write(self, channel, nanoseconds, data):
        """Put a message into the present chunk; write that if it has become large."""
        self._writer.add_message(channel, nanoseconds, data, nanoseconds)
        self._waiting.append((channel, nanoseconds))
        self._size += len(data)
        if self._stream.waits:
            self.flush()

    def flush(self):
        """Write the present chunk, if there is anything in it."""
        self._writer.flush()
        if self._waiting:
            channels, times = zip(*self._waiting)
            known = self.span if self.counts else ()
            self.counts.update(channels)
            self.span = min(*known, *times, times[0]), max(*known, *times, times[0])
            self._waiting, self._size = [], 0
        if self._stream.failure is not None:
            raise self._stream.failure

    def finish(self, metadata):
        """Write the buffer, then the index; ``metadata()`` returns the accompanying text."""
        try:
            if self._stream.broken:
                raise self._stream.failure
            failed = self._stream.failure
            try:
                self.flush()
            except OSError as error:
                failed = error
                if self._stream.broken:
                    raise
            self._writer.add_metadata('rosbag2', {'serialized_metadata': metadata()})
            self._writer.finish()
            self._stream.flush()
            if failed or self._stream.failure:
                raise failed or self._stream.failure
        finally:
            self._stream.close()


class Stream:
    """Stream that ``mcap`` writes to: data between two flushes goes to the file as a whole."""

    def __init__(self, path, make_room):
        self._file = open(path, 'xb', buffering=0)
        self._make_room = make_room
        self._end, self.buffer = 0, bytearray()
        # The first error; whether there was no room even after room was made.
        self.failure, self.broken = None, False

    @property
    def waits(self):
        return bool(self.buffer)

    def write(self, data):
        self.buffer += data

    def tell(self):
        return self._end + len(self.buffer)

    def flush(self):
        try:
            self.put()
        except OSError as error:
            self.failure = self.failure or error
            self._make_room()
            try:
                self.put()
            except OSError:
                self.broken = True
                raise

    def close(self):
        self._file.close()

    def put(self):
        """Write all that waits, or leave the file as it was."""
        left = memoryview(self.buffer)
        try:
            while left:
                left = left[self._file.write(left):]
        except OSError:
            os.ftruncate(self._file.fileno(), self._end)
            self._file.seek(self._end)
            raise
        self._end += len(self.buffer)
        self.buffer = bytearray()


def has_end(path):
    """Return whether an MCAP file ends as a finished one does."""
    with open(path, 'rb') as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(MCAP0_MAGIC)))
        return size > len(MCAP0_MAGIC) and file.read() == MCAP0_MAGIC


def read_mcap(path, name, damages, finished):
    """Yield the sound messages of an MCAP file, in the order of the file."""
    with open(path, 'rb') as file:
        if not os.fstat(file.fileno()).st_size:
            if finished:
                damages.append(Damage(name, 'the file is empty'))
            return
        schemas, channels = _summary(file)
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            unknown = 0
            for record in _records(data, name, damages, finished):
                if isinstance(record, records.Schema):
                    schemas[record.id] = record
                elif isinstance(record, records.Channel):
                    channels[record.id] = _topic(record, schemas)
                elif isinstance(record, records.Message):
                    if record.channel_id in channels:
                        yield Serialised(channels[record.channel_id], record.log_time, record.data)
                    else:
                        unknown += 1
            if unknown:
                damages.append(Damage(name, 'the topics of messages are unknown', unknown))


def _summary(file):
    """Return schemas and topics by number as the index of a finished file has them."""
    try:
        summary = make_reader(file).get_summary()
        return dict(summary.schemas), {
            number: _topic(channel, summary.schemas)
            for number, channel in summary.channels.items()}
    except Exception:
        # There is none, or it is damaged: the chunks have them, too.
        return {}, {}


def _topic(channel, schemas):
    schema = schemas.get(channel.schema_id)
    if schema is None:
        return Topic(channel.topic, '', '')
    return Topic(channel.topic, schema.name, schema.data.decode(errors='replace'),
                 channel.metadata.get(PROFILES, ''))


def _records(data, name, damages, finished):
    """Yield the sound records of a file, from inside chunks and outside."""
    place = behind = len(MCAP0_MAGIC)
    if data[:place] != MCAP0_MAGIC:
        damages.append(Damage(name, 'it does not begin as an MCAP file does', 0))
    # A damaged chunk whose messages the index behind it still counts.
    counted = None
    while place < len(data):
        record, end = _record(data, place)
        if isinstance(record, records.DataEnd):
            return
        content = _content(record)
        if content is not None:
            if isinstance(record, records.Chunk):
                behind, counted = end, None
            elif isinstance(record, records.MessageIndex) and counted is not None:
                counted.lost = (counted.lost or 0) + len(record.records)
            yield from content
            place = end
        elif record is not None and _record(data, end)[0] is not None:
            counted = Damage(f'{name}, byte {place}', 'a chunk is damaged')
            damages.append(counted)
            place = end
        else:
            found = _next_chunk(data, behind)
            if found is None and not finished and data[place] == Opcode.MESSAGE_INDEX:
                # It was cut short behind the last messages.
                return
            damages.append(Damage(f'{name}, byte {place}', (
                f'the last {len(data) - place} bytes are no whole chunk' if found is None
                else f'no sound record up to byte {found}')))
            if found is None:
                return
            place, counted = found, None
    if finished:
        damages.append(Damage(name, 'the end of the file is missing'))


def _record(data, place):
    """Return the record at a place and where it ends; None where there is no sound one."""
    if place + 9 > len(data):
        return None, place
    code, size = struct.unpack_from('<BQ', data, place)
    end = place + 9 + size
    if code not in KINDS or end > len(data):
        return None, place
    stream = ReadDataStream(BytesIO(data[place + 9:end]))
    try:
        record = (records.Message.read(stream, size) if code == Opcode.MESSAGE
                  else KINDS[code].read(stream))
    except Exception:
        # Whatever garbage makes the parser raise.
        return None, place
    return (record, end) if stream.count == size else (None, place)


def _content(record):
    """Return the records in a chunk, or another record alone; None where it is damaged."""
    if not isinstance(record, records.Chunk):
        return None if record is None else [record]
    try:
        content = decompressed(record.data, record.compression, record.uncompressed_size)
        if len(content) != record.uncompressed_size:
            return None
        return breakup_chunk(replace(record, compression='', data=content), validate_crc=True)
    except Exception:
        # Each library has errors of its own for damaged data.
        return None


def _next_chunk(data, behind):
    """Return where the next sound chunk begins behind the last one; None where there is none."""
    for match in CHUNK_HEAD.finditer(data, behind):
        if _content(_record(data, match.start())[0]) is not None:
            return match.start()
    return None


def decompressed(data, kind, size):
    """Return data of a known size that was compressed by ``'zstd'``, ``'lz4'`` or not (``''``)."""
    if size > LARGEST_CHUNK:
        raise ValueError(size)
    if kind == 'zstd':
        return zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
    if kind == 'lz4':
        return LZ4FrameDecompressor().decompress(data, size + 1)
    if kind:
        raise ValueError(kind)
    return data
