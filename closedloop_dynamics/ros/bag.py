# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A rosbag2 bag with the definitions of its types, written from a thread of its own."""

from collections import Counter
from importlib import import_module
from pathlib import Path
from queue import Empty
from queue import SimpleQueue
from threading import Event
from threading import Thread
import time

from closedloop_dynamics.recording.contents import Topic
from closedloop_dynamics.recording.message_numbers import NANOSECONDS
from closedloop_dynamics.recording.metadata import dump
from closedloop_dynamics.recording.writer import BagFiles
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores
from rosbags.typesys import TypesysError

# What was received is in the file after this time [s]: so much is lost if the process is killed.
FLUSH_PERIOD = 1.0


class BagError(OSError):
    """A bag that cannot be written; the message says why."""


class BagWriter:
    """
    Write serialised messages into a bag without keeping the caller waiting.

    Arguments are those of ``recording.writer.BagFiles``, and the ``typestore`` that the
    definitions of the types are taken from. ``written``: messages in the bag, by topic; known when
    it is closed; ``error``: what ended the writing early, a BagError or None; from then on nothing
    is written. BagError if the bag exists or cannot be created.
    """

    def __init__(self, path, storage, typestore, compression='none', max_size=0.0):
        self.path = Path(path)
        self.written = Counter()
        self.error = None
        self._arguments = storage, compression, max_size
        self._typestore = typestore
        self._queue = SimpleQueue()
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
            topic, type_name, definition, dump([_offered(profile) for profile in profiles]),
            self._typestore.hash_rihs01(type_name)))

    def write(self, topic, nanoseconds, data):
        """Put one message, as it was serialised, into the bag, soon; received at a time [ns]."""
        self._queue.put((topic, nanoseconds, data))

    def close(self):
        """Write everything that waits, then the index; an error ends up in ``error``."""
        self._queue.put(None)
        self._thread.join()

    def _work(self):
        try:
            files = BagFiles(self.path, *self._arguments)
        except OSError as error:
            reason = ('it exists already, not overwriting' if isinstance(error, FileExistsError)
                      else error.strerror or error)
            self.error = BagError(f"cannot create the bag '{self.path}': {reason}")
            return
        finally:
            self._opened.set()
        try:
            self._drain(files)
        except OSError as error:
            self._fail(error)
        try:
            files.close()
        except OSError as error:
            self._fail(error)
        self.written.update(files.counts)

    def _fail(self, error):
        if self.error is None:
            self.error = BagError(
                f"cannot go on writing the bag '{self.path}': {error.strerror or error}; what "
                'was written before can be read')

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
            if isinstance(item, Topic):
                channels[item.name] = files.add_topic(item)
            elif item:
                topic, nanoseconds, data = item
                files.write(channels[topic], nanoseconds, data)
            if time.monotonic() >= due:
                files.flush()
                due = time.monotonic() + FLUSH_PERIOD


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

    The definitions of Jazzy's own messages come with ``rosbags``; others are read from the
    ``.msg`` files installed with their package.
    """

    def __init__(self):
        self.typestore = get_typestore(Stores.ROS2_JAZZY)

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
