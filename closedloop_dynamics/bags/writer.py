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

"""A rosbag2 bag being written: files of a limited size, their metadata, and full disks."""

from contextlib import suppress
import os
from pathlib import Path

from .mcap_file import McapFile
from .metadata import as_yaml, distribution, metadata
from .sqlite_file import SqliteFile

SUFFIXES = {'mcap': '.mcap', 'sqlite3': '.db3'}
# What each storage can be compressed with.
COMPRESSIONS = {'mcap': ('none', 'zstd', 'lz4'), 'sqlite3': ('none', 'zstd')}
METADATA_FILE = 'metadata.yaml'
# Kept free for the metadata, should the disk be full [bytes].
RESERVE_FILE, RESERVE = '.reserve', 64 * 1024


class BagFiles:
    """
    Write messages into the files of one bag.

    Parameters
    ----------
    path : pathlib.Path
        Directory of the bag; must not exist.
    storage : str
        ``'mcap'`` or ``'sqlite3'``.
    compression : str
        One of ``COMPRESSIONS[storage]``. Of whole chunks in MCAP, of single messages in sqlite3.
    max_size : float
        A file that has become larger is followed by another one [bytes]; 0: never.

    Raises
    ------
    OSError
        Here and in every method. After it, ``close()`` keeps what is in the files.

    """

    def __init__(self, path, storage, compression='none', max_size=0.0):
        self.path = Path(path)
        self._storage, self._max_size = storage, max_size
        self._compression = '' if compression == 'none' else compression
        self._compress = compressor(compression)
        self._topics = []
        self._ended = []
        self.path.mkdir(parents=True)
        self._reserve()
        self._file = None
        self._open()

    @property
    def counts(self):
        """Return the number of messages in the finished files, by topic."""
        return {topic: sum(counts.values()) for topic, *_, counts in self._topics}

    def add_topic(self, topic, type_name, definition, digest, profiles):
        """
        Make a topic known.

        Parameters
        ----------
        topic, type_name, definition, digest : str
            Full name, ``package/msg/Type``, the text of its definition, its hash.
        profiles : list of dict
            Offered qualities of service, as in the metadata of a bag.

        Returns
        -------
        int
            What ``write`` wants to know.

        """
        self._topics.append((topic, type_name, definition, digest, profiles, {}))
        self._add_channel(len(self._topics))
        return len(self._topics)

    def write(self, channel, nanoseconds, data):
        """
        Write a message.

        Parameters
        ----------
        channel : int
            From ``add_topic``.
        nanoseconds : int
            Time of reception.
        data : bytes
            As it was serialised.

        """
        if self._max_size and self._in_file and self._file.size > self._max_size:
            self._next_file()
        self._in_file = True
        if self._storage == 'sqlite3' and self._compression:
            data = self._compress(bytes(data))
        self._file.write(channel, nanoseconds, data)

    def flush(self):
        """Bring everything so far into the file."""
        self._file.flush()

    def close(self):
        """Finish the files and their metadata."""
        failure = None
        try:
            self._finish()
        except OSError as error:
            failure = error
        with suppress(OSError):
            (self.path / RESERVE_FILE).unlink()
        self._write_metadata()
        if failure is not None:
            raise failure

    def _next_file(self):
        self._finish()
        self._write_metadata()
        self._open()
        for channel in range(1, len(self._topics) + 1):
            self._add_channel(channel)

    def _open(self):
        self._in_file = False
        path = self.path / f'{self.path.name}_{len(self._ended)}{SUFFIXES[self._storage]}'
        if self._storage == 'mcap':
            self._file = McapFile(path, self._compression, self._compress)
        else:
            self._file = SqliteFile(path, distribution())

    def _add_channel(self, channel):
        topic, type_name, definition, digest, profiles, _ = self._topics[channel - 1]
        arguments = channel, topic, type_name, definition, as_yaml(profiles)
        if self._storage == 'sqlite3':
            arguments += (digest,)
        self._file.add_channel(*arguments)

    def _finish(self):
        """Finish the present file, and note what is in it."""
        file, self._file = self._file, None
        if file is None:
            return
        try:
            file.finish(lambda: as_yaml(self._metadata(file)))
        finally:
            for channel, count in file.counts.items():
                self._topics[channel - 1][-1][file.path] = count
            self._ended.append((file.path.name, *file.span, sum(file.counts.values())))

    def _metadata(self, file=None):
        """Return the metadata of the ended files, or of one that is being finished."""
        if file is not None:
            topics = [(name, kind, digest, profiles, file.counts.get(channel, 0))
                      for channel, (name, kind, _, digest, profiles, _)
                      in enumerate(self._topics, 1)]
            files = [(file.path.name, *file.span, sum(file.counts.values()))]
        else:
            topics = [(name, kind, digest, profiles, sum(counts.values()))
                      for name, kind, _, digest, profiles, counts in self._topics]
            files = self._ended
        compression = self._compression if self._storage == 'sqlite3' else ''
        return metadata(self._storage, compression, topics, files)

    def _write_metadata(self):
        """Replace the file at once, so that there is always a whole one."""
        text = as_yaml({'rosbag2_bagfile_information': self._metadata()})
        draft = self.path / f'.{METADATA_FILE}'
        draft.write_text(text + '\n', encoding='utf-8')
        draft.replace(self.path / METADATA_FILE)

    def _reserve(self):
        with suppress(OSError), open(self.path / RESERVE_FILE, 'xb') as file:
            os.posix_fallocate(file.fileno(), 0, RESERVE)


def compressor(name):
    """Return a function that compresses bytes in one of the ways of ``COMPRESSIONS``."""
    if name == 'zstd':
        try:
            from compression import zstd
        except ImportError:
            from backports import zstd
        return zstd.compress
    if name == 'lz4':
        from lz4 import frame
        return frame.compress
    return bytes
