# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Exchange between the thread that computes and the thread that serves pages."""

from collections import deque
import json
from queue import Empty, Full, Queue
import struct
import threading

import numpy as np

from .messages import read
from ..mechanism.fields import FieldError

# Queue length for messages of pages; further ones are refused.
MOST_WAITING = 1000
# So many notes on refusals and faults are kept for pages that ask late.
MOST_NOTES = 5
# Before the row of a frame: its number, how many samples follow the row, its time [s].
HEADER = struct.Struct('<IId')
# Samples that are kept for pages that are slow.
MOST_SAMPLES = 4000


class Feed:
    """
    One mechanism that is shown: messages to its pages, and their requests.

    Of the controls there are the newest only, and a slow page shows the newest frame only. States
    that paths and plots need reach every page as samples: those between frames, and those of the
    frames that it has missed.

    ``description`` and ``controls`` are JSON, which change, counted by ``described`` and
    ``version``; ``number`` is that of the newest frame; ``pages`` are open, ``refused`` messages
    were not followed.
    """

    def __init__(self, description):
        self.description, self.described = '', 0
        self._describe(description)
        # The frame: its number among the samples, its time and its bytes.
        self.controls, self._frame = '', (0, 0.0, b'')
        # Number of each sample since the last reset, its time and its bytes.
        self._samples, self._sampled = deque(maxlen=MOST_SAMPLES), 0
        self.number = self.version = self.pages = self.refused = 0
        self._sent, self._notes, self._note = {}, deque(maxlen=MOST_NOTES), 0
        self._inbox, self._lock = Queue(MOST_WAITING), threading.Lock()
        self.on_change = []

    def _describe(self, description):
        self.description = json.dumps({'type': 'scene', **description}, allow_nan=False)
        self.described += 1

    # The computing side.

    def describe(self, description, time, row):
        """Change the description of the pages, from a frame of it on."""
        with self._lock:
            self._describe(description)
            self._samples.clear()
            self._put(time, row)
        self._changed()

    def show(self, time, row):
        """Send a row, float32, as described, of a time of the motion [s]."""
        with self._lock:
            self._put(time, row)
        self._changed()

    def _put(self, time, row):
        self._add(time, row)
        self.number = (self.number + 1) % 2 ** 32
        self._frame = self._samples[-1]

    def sample(self, time, row):
        """Add a state between frames: a row as of frames."""
        with self._lock:
            self._add(time, row)

    def _add(self, time, row):
        if self._samples and self._samples[-1][1] > time:
            # Those of another run, where time goes back.
            self._samples.clear()
        self._sampled += 1
        self._samples.append((self._sampled, time, row.tobytes()))

    def send_controls(self, **controls):
        """Send the state of the controls to the pages, if it has changed."""
        with self._lock:
            if {**self._sent, **controls} == self._sent and self.version:
                return
            self._sent.update(controls)
            self._write()
        self._changed()

    def log(self, text):
        """Send a message to the pages."""
        with self._lock:
            self._note += 1
            self._notes.append({'number': self._note, 'text': text})
            self._write()
        self._changed()

    def refuse(self, error):
        """Count a refused message, and send the reason."""
        self.refused += 1
        self.log(str(error))

    def is_waiting(self):
        """Return whether a page has sent a request since."""
        return not self._inbox.empty()

    def messages(self):
        """Yield the requests of pages since the last call: page and message."""
        while True:
            try:
                yield self._inbox.get_nowait()
            except Empty:
                return

    def _write(self):
        self.version += 1
        self.controls = json.dumps({
            'type': 'controls', **self._sent, 'notes': list(self._notes),
            'refused': self.refused})

    def _changed(self):
        for wake in tuple(self.on_change):
            wake()

    # The serving side.

    def frame(self, sampled=None):
        """
        Return the newest frame, its number, and the number of the last sample in it.

        The frame is bytes: header, row, and each sample behind number ``sampled`` with its time
        before the frame's [s]; None: no samples.
        """
        with self._lock:
            last, time, row = self._frame
            chosen = [] if sampled is None else [
                np.float32(at - time).tobytes() + sample
                for number, at, sample in self._samples if sampled < number < last]
            return (HEADER.pack(self.number, len(chosen), time) + row + b''.join(chosen),
                    self.number, last)

    def accept(self, page, text):
        """
        Check the message of a page, named by its identity, and hand it over.

        Returns the number of the frame that it has got to, where that is what it says, or None.
        """
        try:
            if isinstance(text, bytes):
                raise FieldError('text', 'bytes')
            message = read(text)
            if message['do'] == 'seen':
                return message['frame']
            self._inbox.put_nowait((page, message))
        except FieldError as error:
            self.refuse(error)
        except Full:
            self.refuse(FieldError('fewer messages', 'more than can be followed'))
        return None

    def leave(self, page):
        """Release the point that a closed page holds; never refused."""
        try:
            self._inbox.put_nowait((page, {'do': 'release'}))
        except Full:
            # What is held is released when the page that holds it is found missing.
            pass
