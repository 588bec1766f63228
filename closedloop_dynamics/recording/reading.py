# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Read rosbag2 bags with nothing but their own type definitions, finished or not.

A recording that was killed has no ``metadata.yaml`` and no index in its last file; everything
else in it is read. Of a file that is damaged, what is behind the damage is left out and reported.
(The reader of ``rosbags`` refuses MCAP files without an index, and opens databases in a way that
shows what a killed process had not committed.)
"""

from collections import Counter
from contextlib import closing, contextmanager
from dataclasses import replace
import os
from pathlib import Path
import sqlite3
from tempfile import TemporaryDirectory
from urllib.parse import quote
import warnings

from .contents import load, METADATA_FILE, ROOT, Serialised, Topic
from .errors import BagReadError
from .writer import checksum
from ..mechanism.extras import of_an_extra

with of_an_extra():
    from mcap import records
    from mcap.stream_reader import StreamReader
    from mcap.writer import MCAP0_MAGIC
    from rosbags.typesys import get_types_from_msg, get_typestore, Stores
    import zstandard

SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')
# Damages of a bag that are reported one by one.
MOST_TOLD = 5
# What compressed messages begin with; others begin with a zero.
ZSTD = b'\x28\xb5\x2f\xfd'


class Bag:
    """
    A bag opened for reading; BagReadError if there is none.

    ``finished``: whether the recording came to its end in order; ``damages``: texts, found while
    reading; complete when all messages have been read.
    """

    def __init__(self, path):
        self.path = Path(path)
        files = self.path.iterdir() if self.path.is_dir() else [self.path]
        self._files = sorted(
            (file for file in files if file.name.endswith(SUFFIXES)), key=_number)
        if not self._files or not self.path.exists():
            raise BagReadError(
                f'{self.path}: expected a rosbag2 bag (a directory with files *.mcap or *.db3, or '
                'one of them; with .zstd behind it where compressed), got '
                f'{"nothing of the kind" if self.path.exists() else "nothing"}')
        # Names of the files and numbers of messages by topic, as the metadata have them.
        self._names, self._expected, self._metadata_damages = (), Counter(), []
        if self.path.is_dir() and (self.path / METADATA_FILE).is_file():
            self._read_metadata()
        last = self._files[-1]
        self.finished = self.path.is_file() or last.name in self._names
        if last.suffix == '.mcap' and self.finished:
            with open(last, 'rb') as file:
                file.seek(-min(len(MCAP0_MAGIC), last.stat().st_size), os.SEEK_END)
                self.finished = file.read() == MCAP0_MAGIC
        self.damages = []
        self._store, self._known = get_typestore(Stores.EMPTY), set()

    def _read_metadata(self):
        try:
            found = load((self.path / METADATA_FILE).read_text(encoding='utf-8'))[ROOT]
            self._names = [Path(name).name for name in found['relative_file_paths']]
            for each in found['topics_with_message_count']:
                self._expected[each['topic_metadata']['name']] += int(each['message_count'])
        except Exception as error:
            # Whatever garbage makes the parser raise.
            self._metadata_damages = [
                f'{METADATA_FILE}: it cannot be read ({" ".join(str(error).split())[:100]})']
        else:
            self._metadata_damages = [
                f'{name}: {METADATA_FILE} names it, but it is missing' for name in self._names
                if not (self.path / name).is_file()]

    def warn(self):
        """Warn of the damages that were found."""
        for damage in self.damages[:MOST_TOLD]:
            warnings.warn(f'{self.path}: {damage}')
        if len(self.damages) > MOST_TOLD:
            warnings.warn(f'{self.path}: {len(self.damages) - MOST_TOLD} more damages')

    def serialised(self):
        """Yield all messages, ``Serialised``, in the order of each file up to its first damage."""
        self.damages = list(self._metadata_damages)
        found = Counter()
        for file in self._files:
            try:
                with _unpacked(file) as path:
                    whole = self.finished or file != self._files[-1] or file.name in self._names
                    for message in (_database_messages(path) if path.suffix == '.db3'
                                    else _mcap_messages(path, whole)):
                        if message.data.startswith(ZSTD):
                            data = zstandard.ZstdDecompressor().decompressobj().decompress(
                                message.data)
                            message = replace(message, data=data)
                        found[message.topic.name] += 1
                        yield message
            except Exception as error:
                # Each library has errors of its own for damaged data.
                self.damages.append(
                    f'{file.name}: {" ".join(str(error).split()) or type(error).__name__}; what '
                    'follows in this file is left out'
                    + ('; `mcap recover` brings back what is sound' if '.mcap' in file.name
                       else ''))
        # The last file of a recording that was killed is not yet counted.
        if self._expected and (
                found != self._expected if self.finished else not found >= self._expected):
            self.damages.append(f'{METADATA_FILE}: it counts {self._expected.total()} messages, '
                                f'found {found.total()}')

    def messages(self, wanted=None):
        """
        Yield topic name, time of reception [ns] and message, decoded, where ``wanted(name)``.

        Raises BagReadError where the definition of a type cannot be read.
        """
        for message in self.serialised():
            topic = message.topic
            if wanted is None or wanted(topic.name):
                self._define(topic)
                try:
                    decoded = self._store.deserialize_cdr(message.data, topic.type)
                except Exception:
                    # Whatever garbage makes the parser raise.
                    self.damages.append(
                        f'{topic.name} at {message.time} ns: it is no {topic.type}')
                    continue
                yield topic.name, message.time, decoded

    def _define(self, topic):
        """Add the type of a topic to the type store, from the bag's definition."""
        if topic.type in self._known:
            return
        try:
            types = get_types_from_msg(topic.definition, topic.type)
            self._store.register({name: fields for name, fields in types.items()
                                  if name not in self._store.fielddefs})
            if topic.digest not in ('', self._store.hash_rihs01(topic.type)):
                raise ValueError('its hash is another one')
        except Exception as error:
            # Whatever garbage makes the parser raise.
            raise BagReadError(f'{self.path}: the definition of {topic.type} cannot be read '
                               f'({" ".join(str(error).split())})') from None
        self._known.add(topic.type)


def _mcap_messages(path, whole):
    """Yield the messages of an MCAP file; one that is not ``whole`` may end behind any record."""
    schemas, topics = {}, {}
    # Messages, those that indices behind the chunks name, and where the last sound record ends.
    found, indexed, sound = 0, 0, 0
    with open(path, 'rb') as file:
        size = os.fstat(file.fileno()).st_size
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                if isinstance(record, records.Schema):
                    schemas[record.id] = record
                elif isinstance(record, records.Channel):
                    schema = schemas[record.schema_id]
                    topics[record.id] = Topic(record.topic, schema.name, schema.data.decode())
                elif isinstance(record, records.Message):
                    found += 1
                    yield Serialised(topics[record.channel_id], record.log_time, record.data)
                elif isinstance(record, records.MessageIndex):
                    indexed += len(record.records)
                elif isinstance(record, records.DataEnd):
                    break
                sound = file.tell()
        except Exception as error:
            # Whatever garbage makes the parser raise.
            if whole or sound < size:
                raise BagReadError(f'byte {sound} of {size}: a record is cut off or damaged '
                                   f'({type(error).__name__}: {error})') from None
    if indexed > found:
        raise BagReadError(f'{indexed - found} messages that its indices name are missing')


def _database_messages(path):
    """Yield the messages of a database; without what was not committed when it was killed."""
    with closing(sqlite3.connect(f'file:{quote(str(path))}?mode=rw', uri=True)) as database:
        definitions = dict(database.execute(
            'SELECT topic_type, encoded_message_definition FROM message_definitions'))
        topics = {number: Topic(name, kind, definitions[kind], digest)
                  for number, name, kind, digest in database.execute(
                      'SELECT id, name, type, type_description_hash FROM topics')}
        ours = any(column[1] == 'crc32' for column in database.execute(
            'PRAGMA table_info(messages)'))
        last = 0
        for number, channel, nanoseconds, data, crc in database.execute(
                f'SELECT id, topic_id, timestamp, data, {"crc32" if ours else "NULL"} '
                'FROM messages ORDER BY id'):
            if number != last + 1:
                raise BagReadError(f'message {last + 1} is missing')
            last = number
            if crc not in (None, checksum(channel, nanoseconds, data)):
                raise BagReadError(f'message {number} is damaged')
            yield Serialised(topics[channel], nanoseconds, data)
        (fault,), *_ = database.execute('PRAGMA quick_check(1)')
        if fault != 'ok':
            raise BagReadError(f'the database is damaged ({fault.splitlines()[-1]})')


@contextmanager
def _unpacked(file):
    """Yield a file of a bag, decompressed where it was compressed as a whole."""
    if file.suffix != '.zstd':
        yield file
        return
    with TemporaryDirectory() as directory:
        path = Path(directory, file.stem)
        with open(file, 'rb') as packed, open(path, 'wb') as out:
            zstandard.ZstdDecompressor().copy_stream(packed, out)
        yield path


def _number(path):
    """Return the sort key of a bag's files: NAME_10 comes after NAME_9."""
    stem, _, number = path.name.split('.')[0].rpartition('_')
    return (stem, int(number)) if number.isdigit() else (path.name, -1)
