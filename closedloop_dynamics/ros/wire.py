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
Messages serialised once, in which only numbers change from then on.

Converting a message from Python takes longer than all the rest of publishing it. So the
places of its numbers among the serialised bytes are looked up at the start, by values put there
to be found, and written directly later. Where that does not work (another
middleware, another encoding), the message is converted as ever.

"""

import re
import struct

import numpy as np
from rclpy.serialization import serialize_message

# A stamp that is found only where it was put: seconds and nanoseconds.
_STAMP = struct.Struct('=iI')
_MARK = (0x2F3A91C5, 0x1B7D4E63)


class WireMessage:
    """
    A message with a stamp, in one or several headers, and blocks of numbers.

    Parameters
    ----------
    build : callable
        ``build(stamp_sec, stamp_nanosec, *blocks)`` returns the message, blocks being arrays.
    sizes : sequence of int
        Of the blocks.

    Attributes
    ----------
    direct : bool
        Whether the numbers are written among serialised bytes.

    """

    def __init__(self, build, sizes):
        self._build = build
        rng = np.random.default_rng(1)
        marks = [rng.uniform(1e100, 1e101, size) for size in sizes]
        self._data = bytearray(serialize_message(build(*_MARK, *marks)))
        self._stamps = self._places(_STAMP.pack(*_MARK))
        places = [self._places(mark.tobytes()) for mark in marks if len(mark)]
        self.direct = bool(self._stamps) and all(len(found) == 1 for found in places)
        if self.direct:
            offsets = iter(place for place, in places)
            self._blocks = [np.frombuffer(self._data, count=size, offset=next(offsets))
                            if size else np.zeros(0) for size in sizes]
            # What was looked for is not to be published by mistake.
            self.filled(0, 0, *(np.full(size, np.nan) for size in sizes))

    def _places(self, mark):
        """Return where a mark is among the bytes."""
        return [match.start() for match in re.finditer(re.escape(mark), self._data)]

    def filled(self, sec, nanosec, *blocks):
        """
        Return the message with these numbers, ready to be published.

        Parameters
        ----------
        sec, nanosec : int
            The stamp.
        *blocks : ndarray
            Numbers, in the sizes of the blocks.

        Returns
        -------
        bytes or message

        """
        if not self.direct:
            return self._build(sec, nanosec, *blocks)
        for place in self._stamps:
            _STAMP.pack_into(self._data, place, sec, nanosec)
        for place, block in zip(self._blocks, blocks):
            place[:] = block
        return bytes(self._data)
