# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Bags by whichever reader is there: the Python ones, or where ROS is, its own.

The Python readers need rosbags and mcap, which distributions do not package. They read bags that
were killed or damaged, too; rosbag2_py reads those that are whole, with the messages installed.
"""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
import warnings


def open_bag(path):
    """Return a bag opened for reading; OSError if there is none, ImportError without a reader."""
    if find_spec('rosbag2_py') is not None and not (find_spec('rosbags') and find_spec('mcap')):
        return RosBag(path)
    from .reading import Bag
    return Bag(path)


class RosBag:
    """
    A bag that rosbag2_py reads; OSError if it cannot.

    ``finished``: always, as others cannot be opened; ``damages``: texts, found while reading.
    """

    finished = True

    def __init__(self, path):
        from rosbag2_py import ConverterOptions, SequentialReader, StorageOptions
        self.path, self.damages = Path(path), []
        self._reader = SequentialReader()
        try:
            self._reader.open(StorageOptions(uri=str(path), storage_id=''),
                              ConverterOptions('', ''))
        except RuntimeError as error:
            raise OSError(f'{path}: rosbag2_py cannot open it: {" ".join(str(error).split())}; '
                          'with rosbags and mcap (pip install rosbags mcap) bags that were '
                          'killed or damaged are read, too') from None

    def warn(self):
        """Warn of the damages that were found."""
        for damage in self.damages:
            warnings.warn(f'{self.path}: {damage}')

    def messages(self, wanted=None):
        """Yield topic, time of reception [ns] and message, decoded, where ``wanted(topic)``."""
        from rclpy.serialization import deserialize_message
        types = {topic.name: topic.type for topic in self._reader.get_all_topics_and_types()}
        while True:
            try:
                if not self._reader.has_next():
                    return
                name, data, time = self._reader.read_next()[:3]
            except RuntimeError as error:
                # It cannot go on behind that.
                self.damages.append(f'rosbag2_py reads no further: {" ".join(str(error).split())}')
                return
            if wanted is not None and not wanted(name):
                continue
            package, _, kind = types[name].split('/')
            try:
                message = deserialize_message(
                    data, getattr(import_module(f'{package}.msg'), kind))
            except (ImportError, AttributeError, RuntimeError) as error:
                self.damages.append(f'{name} at {time} ns: it is not a {types[name]} ({error})')
                continue
            yield name, time, message
