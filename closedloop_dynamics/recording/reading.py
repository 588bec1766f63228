# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Read rosbag2 bags with nothing but their own type definitions: finished or not, sound or not.

A recording that was killed has no ``metadata.yaml`` and no index in its last file; everything
else in it is read. What is damaged is left out and reported.
"""

from collections import Counter
from contextlib import contextmanager
from pathlib import Path
import sqlite3
from tempfile import TemporaryDirectory
import warnings

from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import zstandard

from .contents import Damage, Serialised
from .mcap_file import has_end, read_mcap
from .metadata import load, METADATA_FILE, ROOT
from .sqlite_file import read_database, ZSTD

SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')
# Damages of a bag that are reported one by one.
MOST_TOLD = 5
# At once, of a compressed file [bytes].
READ_AT_ONCE = 1 << 20


class BagReadError(OSError):
    """A bag that cannot be read; the message says why."""


class Bag:
    """
    A bag opened for reading; BagReadError if there is none.

    ``finished``: whether the recording came to its end in order; ``damages`` found while reading;
    complete when all messages have been read.
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
        self._metadata_damages = []
        # Messages by topic, and by file, as the metadata has them; None without.
        self._expected = self._files_expected = None
        self._read_metadata()
        last = self._files[-1]
        self.finished = (
            (self.path.is_file() or last.name in (self._files_expected or ()))
            and (last.suffix != '.mcap' or has_end(last)))
        self.damages = []
        self._store = get_typestore(Stores.EMPTY)
        self._known = {}

    def _read_metadata(self):
        """Read which topics and messages should be in the bag."""
        file = self.path / METADATA_FILE
        if not file.is_file():
            return
        try:
            found = load(file.read_text(encoding='utf-8'))[ROOT]
            names = [Path(name).name for name in found['relative_file_paths']]
            counts = {Path(each['path']).name: int(each['message_count'])
                      for each in found.get('files', ())}
            expected = Counter()
            for each in found['topics_with_message_count']:
                expected[each['topic_metadata']['name']] += int(each['message_count'])
        except Exception as error:
            # Whatever garbage makes the parser raise.
            self._metadata_damages.append(Damage(
                METADATA_FILE, f'it cannot be read ({" ".join(str(error).split())[:100]})', 0))
            return
        self._expected, self._files_expected = expected, dict.fromkeys(names) | counts
        for name in names:
            if not (self.path / name).is_file():
                self._metadata_damages.append(
                    Damage(name, f'{METADATA_FILE} names it, but it is missing', counts.get(name)))

    @property
    def lost(self):
        """Return the number of lost messages; None where it is unknown."""
        losses = [damage.lost for damage in self.damages]
        return None if None in losses else sum(losses)

    def warn(self):
        """Warn of the damages that were found."""
        for damage in self.damages[:MOST_TOLD]:
            warnings.warn(f'{self.path}: {damage}')
        if len(self.damages) > MOST_TOLD:
            warnings.warn(f'{self.path}: {len(self.damages) - MOST_TOLD} more damages')

    def serialised(self):
        """Yield all sound messages, ``Serialised``, in the order of each file."""
        self.damages = list(self._metadata_damages)
        found = Counter()
        for file in self._files:
            first = len(self.damages)
            count = 0
            for message in self._read(file):
                found[message.topic.name] += 1
                count += 1
                yield message
            self._settle(file.name, self.damages[first:], count)
        for topic, expected in sorted((self._expected or {}).items()):
            if found[topic] != expected and not any(
                    damage.lost != 0 for damage in self.damages):
                self.damages.append(Damage(
                    METADATA_FILE, f'{expected} messages of {topic}, found {found[topic]}',
                    max(0, expected - found[topic])))

    def _settle(self, name, damages, count):
        """Return how many messages a damaged file has lost, where the metadata counts them."""
        expected = (self._files_expected or {}).get(name)
        open_ends = [damage for damage in damages if damage.lost is None]
        if open_ends and expected is not None:
            known = sum(damage.lost or 0 for damage in damages)
            for damage in open_ends:
                damage.lost = 0
            open_ends[-1].lost = max(0, expected - count - known)

    def _read(self, file):
        """Yield the messages of one file."""
        finished = self.finished or file != self._files[-1] or (
            file.name in (self._files_expected or ()))
        try:
            with _unpacked(file, self.damages) as path:
                messages = (read_database(path, file.name, self.damages)
                            if path.suffix == '.db3'
                            else read_mcap(path, file.name, self.damages, finished))
                for message in messages:
                    if message.data.startswith(ZSTD):
                        message = self._decompressed(file, message)
                    if message is not None:
                        yield message
        except (sqlite3.Error, OSError) as error:
            self.damages.append(Damage(file.name, f'it cannot be read ({error})'))

    def _decompressed(self, file, message):
        """Return a message that was compressed by itself; None where that is damaged."""
        try:
            data = zstandard.ZstdDecompressor().decompressobj().decompress(message.data)
        except zstandard.ZstdError:
            self.damages.append(Damage(file.name, 'a compressed message is damaged', 1))
            return None
        return Serialised(message.topic, message.time, data)

    def messages(self, wanted=None):
        """
        Yield topic name, time of reception [ns] and message, decoded, where ``wanted(name)``.

        Raises BagReadError where the definition of a type cannot be read.
        """
        for message in self.serialised():
            if wanted is None or wanted(message.topic.name):
                try:
                    decoded = self._decoded(message)
                except BagReadError:
                    raise
                except Exception:
                    # Whatever garbage makes the parser raise.
                    self.damages.append(Damage(
                        f'{message.topic.name} at {message.time} ns',
                        f'it is no {message.topic.type}', 1))
                    continue
                yield message.topic.name, message.time, decoded

    def _decoded(self, message):
        kind = message.topic.type
        if kind not in self._known:
            try:
                define(self._store, message.topic)
            except Exception as error:
                raise BagReadError(f'{self.path}: the definition of {kind} cannot be read '
                                   f'({" ".join(str(error).split())})') from None
            self._known[kind] = kind
        return self._store.deserialize_cdr(message.data, kind)


def define(store, topic):
    """
    Add the type of a topic to a type store, from the bag's definition; return its hash.

    Raises exceptions of many kinds where the definition is damaged or of another type than its
    hash.
    """
    if topic.type not in store.fielddefs:
        types = get_types_from_msg(topic.definition, topic.type)
        store.register({name: fields for name, fields in types.items()
                        if name not in store.fielddefs})
    digest = store.hash_rihs01(topic.type)
    if topic.digest and topic.digest != digest:
        raise ValueError('its hash is another one')
    return digest


@contextmanager
def _unpacked(file, damages):
    """Yield a file of a bag, decompressed where it was compressed as a whole."""
    if file.suffix != '.zstd':
        yield file
        return
    with TemporaryDirectory() as directory:
        path = Path(directory, file.stem)
        with open(file, 'rb') as packed, open(path, 'wb') as out:
            try:
                with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
                    while portion := reader.read(READ_AT_ONCE):
                        out.write(portion)
            except zstandard.ZstdError as error:
                damages.append(Damage(file.name, f'it cannot be decompressed to its end ({error})',
                                      0))
        yield path


def _number(path):
    """Return the sort key of a bag's files: NAME_10 comes after NAME_9."""
    stem, _, number = path.name.split('.')[0].rpartition('_')
    return (stem, int(number)) if number.isdigit() else (path.name, -1)
