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
Read MCAP files that were not finished: whole chunks, up to where the file ends or is damaged.

Finished files are read as well, without their index. Every chunk is checked by its
checksum.

"""

from dataclasses import dataclass
import struct
import zlib

from .mcap_file import CHANNEL, CHUNK, MAGIC, MESSAGE, SCHEMA


@dataclass(frozen=True)
class Topic:
    """One topic of a bag: its name, type, and the text of the type's definition."""

    name: str
    type: str  # noqa: A003
    definition: str


def is_finished(path):
    """Return whether an MCAP file has its end."""
    with open(path, 'rb') as file:
        file.seek(0, 2)
        if file.tell() < 2 * len(MAGIC):
            return False
        file.seek(-len(MAGIC), 2)
        return file.read() == MAGIC


def salvage(path):
    """
    Yield the messages of an MCAP file, finished or not.

    Parameters
    ----------
    path : pathlib.Path
        Of the file.

    Yields
    ------
    (Topic, int, bytes)
        Topic, time [ns] and message as it was serialised.

    """
    schemas, channels = {}, {}
    with open(path, 'rb') as file:
        if file.read(len(MAGIC)) != MAGIC:
            return
        for code, content in _records(file.read):
            if code == CHUNK:
                unpacked = _unpacked(content)
                if unpacked is None:
                    return
                position = 0

                def take(size):
                    nonlocal position
                    position += size
                    return unpacked[position - size:position]

                for record in _records(take):
                    yield from _message(record, schemas, channels)
            else:
                yield from _message((code, content), schemas, channels)


def _message(record, schemas, channels):
    """Yield the message of a record if it is one; note schemas and channels."""
    code, content = record
    if code == SCHEMA:
        number, = struct.unpack_from('<H', content)
        name, place = _text(content, 2)
        _, place = _text(content, place)
        schemas[number] = name, _text(content, place)[0]
    elif code == CHANNEL:
        number, schema = struct.unpack_from('<HH', content)
        channels[number] = Topic(_text(content, 4)[0], *schemas.get(schema, ('', '')))
    elif code == MESSAGE:
        number, _, nanoseconds = struct.unpack_from('<HIQ', content)
        if number in channels:
            yield channels[number], nanoseconds, bytes(content[22:])


def _records(take):
    """Yield code and content of every record that is there whole."""
    while len(head := take(9)) == 9:
        code, size = struct.unpack('<BQ', head)
        content = take(size) if size < 2 ** 40 else b''
        if len(content) < size:
            return
        yield code, content


def _unpacked(content):
    """Return the records of a chunk; None if it is damaged."""
    size, checksum = struct.unpack_from('<QI', content, 16)
    kind, place = _text(content, 28)
    packed = content[place + 8:]
    try:
        unpacked = decompressed(packed, kind)
    except Exception:
        # Each library has errors of its own for data that is not what it should be.
        return None
    if len(unpacked) != size or checksum and zlib.crc32(unpacked) != checksum:
        return None
    return unpacked


def decompressed(data, kind):
    """Return data that was compressed by ``'zstd'``, ``'lz4'`` or not at all (``''``)."""
    if kind == 'zstd':
        try:
            from compression import zstd
        except ImportError:
            from backports import zstd
        return zstd.decompress(data)
    if kind == 'lz4':
        from lz4 import frame
        return frame.decompress(data)
    if kind:
        raise ValueError(kind)
    return data


def _text(content, place):
    """Return a text and where it ends."""
    size, = struct.unpack_from('<I', content, place)
    place += 4
    return bytes(content[place:place + size]).decode(), place + size
