# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A rosbag2 bag being written: files of a limited size, their metadata, and full disks."""

from collections import Counter
from contextlib import suppress
import os
from pathlib import Path

from . import mcap_file, sqlite_file
from .mcap_file import CHUNK_SIZE, McapFile
from .metadata import distribution, dump, metadata, METADATA_FILE, ROOT
from .sqlite_file import SqliteFile

SUFFIXES = {'mcap': '.mcap', 'sqlite3': '.db3'}
# What each storage can be compressed with.
COMPRESSIONS = {'mcap': tuple(mcap_file.COMPRESSIONS), 'sqlite3': sqlite_file.COMPRESSIONS}
# Kept free for the last chunk, the index and the metadata, should the disk be full [bytes].
RESERVE_FILE, RESERVE = '.reserve', 4 * CHUNK_SIZE


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
        # Name, channels' counts and span of the files that were finished.
        self._ended = []
        self.path.mkdir(parents=True)
        with suppress(OSError), open(self.path / RESERVE_FILE, 'xb') as file:
            os.posix_fallocate(file.fileno(), 0, RESERVE)
        self._file = None
        self._open()

    @property
    def counts(self):
        """Return the number of messages in the files by topic; exact after a flush."""
        files = [*self._ended, *filter(None, [self._file])]
        counts = sum((file.counts for file in files), Counter())
        return {topic.name: counts[channel] for channel, topic in enumerate(self._topics, 1)}

    def add_topic(self, topic):
        """Register a topic; return its number for ``write``."""
        self._topics.append(topic)
        self._file.add_channel(len(self._topics), topic)
        return len(self._topics)

    def write(self, channel, nanoseconds, data):
        """Write a message."""
        if self._max_size and self._in_file and self._file.size > self._max_size:
            self._finish()
            self._write_metadata()
            self._open()
        self._in_file = True
        self._file.write(channel, nanoseconds, data)

    def flush(self):
        """Bring everything so far into the file."""
        self._file.flush()

    def close(self):
        """Finish the files and their metadata."""
        self._make_room()
        try:
            self._finish()
        finally:
            self._write_metadata()

    def _open(self):
        self._in_file = False
        path = self.path / f'{self.path.name}_{len(self._ended)}{SUFFIXES[self._storage]}'
        self._file = (McapFile(path, self._compression, self._make_room)
                      if self._storage == 'mcap'
                      else SqliteFile(path, self._compression, distribution()))
        for channel, topic in enumerate(self._topics, 1):
            self._file.add_channel(channel, topic)

    def _finish(self):
        """Finish the present file, and store its contents."""
        file, self._file = self._file, None
        if file is not None:
            self._ended.append(file)
            file.finish(lambda: dump(self._metadata([file])))

    def _metadata(self, files):
        counts = sum((file.counts for file in files), Counter())
        compressed = self._storage == 'sqlite3' and self._compression != 'none'
        return metadata(
            self._storage, self._compression if compressed else '',
            [(topic, counts[channel]) for channel, topic in enumerate(self._topics, 1)],
            [(file.path.name, *file.span, file.counts.total()) for file in files])

    def _write_metadata(self):
        """Replace the file at once, so that there is always a whole one."""
        text = dump({ROOT: self._metadata(self._ended)})
        draft = self.path / f'.{METADATA_FILE}'
        draft.write_text(text + '\n', encoding='utf-8')
        draft.replace(self.path / METADATA_FILE)

    def _make_room(self):
        """Release the space kept free."""
        with suppress(OSError):
            (self.path / RESERVE_FILE).unlink()
