# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A rosbag2 bag with the definitions of its types.

It is written from a thread of its own, so that a disk that is slow for a while stalls no callback:
messages wait in memory, none is lost, and other topics go on.
"""

from collections import Counter
from importlib import import_module
import math
from pathlib import Path
from queue import Empty
from queue import SimpleQueue
from threading import Event
from threading import Thread
import time

from closedloop_dynamics.mechanism.extras import of_an_extra
from closedloop_dynamics.recording.contents import Topic
from closedloop_dynamics.recording.message_numbers import NANOSECONDS
from closedloop_dynamics.recording.writer import BagFiles, distribution

with of_an_extra():
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import get_types_from_msg
    from rosbags.typesys import get_typestore
    from rosbags.typesys import Stores
    from rosbags.typesys import TypesysError

# What was received is in the file after this time [s]: so much is lost if the process is killed.
FLUSH_PERIOD = 0.1
# Messages that may wait for the disk, and what each takes beside its data [bytes].
CACHE_SIZE, OVERHEAD = 100e6, 200
# For writing what waits when the bag is closed, and for its index after that [s]. With the
# recorder's last call, these are shorter than the 5 s after which a launch loses its patience.
PATIENCE, INDEX_PATIENCE = 1.5, 2.0


class BagError(OSError):
    """A bag that cannot be written; the message says why."""


class BagWriter:
    """
    Write serialised messages into a bag without keeping the caller waiting.

    Arguments are those of ``recording.writer.BagFiles``, the ``typestore`` that the definitions of
    the types are taken from, and ``cache_size``: further messages are dropped while so much waits
    for the disk [bytes]. ``written``: messages in the bag, by topic; complete when it is closed;
    ``dropped``: number of messages that are left out because the disk is too slow; ``error``: why
    the bag is not complete, a BagError or None; after one of writing, nothing more is written.
    BagError if the bag exists or cannot be created.
    """

    def __init__(self, path, storage, typestore, compression='none', max_size=0.0,
                 cache_size=CACHE_SIZE):
        self.path = Path(path)
        self.written, self.dropped = Counter(), 0
        self.error = None
        self._arguments = storage, compression, max_size
        self._typestore, self._cache_size = typestore, cache_size
        self._queue = SimpleQueue()
        # Sizes of all messages that entered the queue, changed by the caller alone, and of all
        # that left it, changed by the thread alone.
        self._entered = self._left = 0
        # What still waits then is dropped.
        self._deadline = math.inf
        self._opened = Event()
        # sqlite3 wants all calls from one thread, so the bag lives in there.
        self._thread = Thread(target=self._work, name='bag_writer', daemon=True)
        self._thread.start()
        self._opened.wait()
        if self.error is not None:
            raise self.error

    def add_topic(self, topic, type_name, profiles=()):
        """
        Add a topic by its full name; to be called once, before its first message.

        ``type_name`` is known to the typestore; ``profiles`` are those that the publishers offer.
        """
        definition, _ = self._typestore.generate_msgdef(type_name, ros_version=2)
        self._queue.put(Topic(
            topic, type_name, definition, self._typestore.hash_rihs01(type_name),
            tuple(_offered(profile) for profile in profiles)))

    def write(self, topic, nanoseconds, data):
        """Put one message, as it was serialised, into the bag, soon; received at a time [ns]."""
        waiting, size = self._entered - self._left, len(data) + OVERHEAD
        if waiting and waiting + size > self._cache_size:
            self.dropped += 1
        else:
            self._entered += size
            self._queue.put((topic, nanoseconds, data))

    def close(self):
        """Write what waits for ``PATIENCE``, then the index; errors end up in ``error``."""
        self._deadline = time.monotonic() + PATIENCE
        self._queue.put(None)
        self._thread.join(PATIENCE + INDEX_PATIENCE)
        if self._thread.is_alive():
            self._fail('the disk does not answer')
        elif self.dropped and self.error is None:
            self.error = BagError(
                f"{self.dropped} messages are not in the bag '{self.path}': they came faster than "
                'the disk took them')

    def _work(self):
        try:
            files = BagFiles(self.path, *self._arguments)
        except Exception as error:
            # An error of any kind would leave the caller with a bag that nobody writes.
            reason = ('it exists already, not overwriting' if isinstance(error, FileExistsError)
                      else _reason(error))
            self.error = BagError(f"cannot create the bag '{self.path}': {reason}")
            return
        finally:
            self._opened.set()
        for step in (self._drain, BagFiles.close):
            try:
                step(files)
            except Exception as error:
                self._fail(_reason(error))
        self.written = Counter(files.counts)

    def _fail(self, reason):
        if self.error is None:
            self.error = BagError(
                f"cannot go on writing the bag '{self.path}': {reason}; what was written before "
                'can be read')

    def _drain(self, files):
        channels = {}
        due = time.monotonic() + FLUSH_PERIOD
        while True:
            try:
                item = self._queue.get(timeout=max(0.0, due - time.monotonic()))
            except Empty:
                item = ()
            if item is None:
                return
            now = time.monotonic()
            if isinstance(item, Topic):
                channels[item.name] = files.add_topic(item)
            elif item and now > self._deadline:
                self.dropped += 1
            elif item:
                topic, nanoseconds, data = item
                files.write(channels[topic], nanoseconds, data)
                self._left += len(data) + OVERHEAD
            if now >= due:
                files.flush()
                self.written = Counter(files.counts)
                due = time.monotonic() + FLUSH_PERIOD


def _reason(error):
    """Return what an exception says, with its kind where that is not an error of the system."""
    if isinstance(error, OSError):
        return error.strerror or error
    return f'{type(error).__name__}: {error}'


def _offered(profile):
    """Return a quality of service of rclpy as the metadata of a bag has it."""
    return {
        'history': profile.history.name.lower(), 'depth': profile.depth,
        'reliability': profile.reliability.name.lower(),
        'durability': profile.durability.name.lower(),
        'deadline': _duration(profile.deadline), 'lifespan': _duration(profile.lifespan),
        'liveliness': profile.liveliness.name.lower(),
        'liveliness_lease_duration': _duration(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
    }


def _duration(duration):
    seconds, nanoseconds = divmod(duration.nanoseconds, NANOSECONDS)
    return {'sec': seconds, 'nsec': nanoseconds}


class UnknownTypeError(LookupError):
    """A message type that is not installed here."""


class MessageTypes:
    """
    Message types by name: their Python classes and their definitions, in a ``typestore``.

    The definitions of the distribution's own messages come with ``rosbags``; others are read from
    the ``.msg`` files installed with their package.
    """

    def __init__(self):
        # Those of a distribution that it does not know are of the newest that it does.
        self.typestore = get_typestore(
            getattr(Stores, f'ROS2_{distribution().upper()}', Stores.LATEST))

    def message_class(self, name):
        """
        Return the class of a type, ``package/msg/Type``, and make sure of its definition.

        Raises UnknownTypeError if the type, or one it is made of, is not installed here.
        """
        self._define(name)
        package, _, type_name = name.split('/')
        try:
            return getattr(import_module(f'{package}.msg'), type_name)
        except (ImportError, AttributeError) as error:
            raise UnknownTypeError(f'{name} has no Python messages here ({error})') from None

    def _define(self, name):
        if name in self.typestore.fielddefs:
            return
        try:
            types = get_types_from_msg(_definition_path(name).read_text(), name)
        except (OSError, TypesysError) as error:
            raise UnknownTypeError(f'{name} has no readable definition ({error})') from None
        self.typestore.register(types)
        for _, fields in types.values():
            for _, description in fields:
                self._define_nested(description)

    def _define_nested(self, description):
        kind, detail = description
        if kind == Nodetype.NAME:
            self._define(detail)
        elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            self._define_nested(detail[0])


def _definition_path(name):
    """Return the ``.msg`` file of a type, in share/ of the prefix its Python package is in."""
    package, _, type_name = name.split('/')
    try:
        module = Path(import_module(package).__file__).resolve()
    except ImportError:
        raise UnknownTypeError(f'{name}: package {package} is not installed here') from None
    for prefix in module.parents:
        path = prefix / 'share' / package / 'msg' / f'{type_name}.msg'
        if path.is_file():
            return path
    raise UnknownTypeError(f'{name}: no {type_name}.msg in share/{package} above {module.parent}')
