# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Handling of termination signals, for all programs of the package.

This module is light on purpose: a program begins to watch for signals before it imports rclpy
and LLVM, which take a while.
"""

from contextlib import contextmanager
import os
import signal
import threading

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# How long a program may take to end by itself [s], at what it checks for signals between.
PATIENCE = 1.5


class Interrupted(KeyboardInterrupt):
    """Termination by a signal; its number is the argument."""


class SignalWatch:
    """
    The reaction of this process to signals: the latest one that was set up and is not over.

    The first one, ``leave(number)``, ends the process, which has nothing to close yet.
    """

    def __init__(self, leave, numbers=STOP_SIGNALS):
        self._numbers = numbers
        self._reactions = [leave]
        # A handler may interrupt its own thread while that holds the lock.
        self._lock = threading.RLock()

    def install(self):
        """React in the main thread, between two of its bytecodes, from now on."""
        self._handle_with(lambda number, frame: self._react(number))

    def install_thread(self):
        """
        React in a thread of its own from now on.

        So a signal is noticed at once, even while the main thread waits in DDS or compiles.
        """
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        # First, so that no signal is lost in between. Python needs a handler for the descriptor to
        # be written.
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        self._handle_with(lambda number, frame: None)
        threading.Thread(
            target=self._read, args=(reader,), name='signal_watch', daemon=True).start()

    def ignore(self):
        """Make the process immune for its last moments, the interpreter's end included."""
        self._handle_with(signal.SIG_IGN)

    @contextmanager
    def reacting(self, reaction):
        """Call ``reaction(number)`` on a signal while the body runs."""
        with self._lock:
            depth = len(self._reactions)
            self._reactions.append(reaction)
        try:
            yield
        finally:
            with self._lock:
                del self._reactions[depth:]

    @contextmanager
    def interrupting(self):
        """Raise ``Interrupted`` in the body at the first signal; then react as before it."""
        def interrupt(number):
            self._reactions.pop()
            raise Interrupted(number)

        with self.reacting(interrupt):
            yield

    @contextmanager
    def noting(self):
        """
        Yield a list to which the first signal is appended; then react as before the body.

        A body that does not end by itself for ``PATIENCE`` seconds gets the signal once more.
        """
        received, timers = [], []

        def note(number):
            self._reactions.pop()
            received.append(number)
            timers.append(threading.Timer(
                PATIENCE, signal.pthread_kill, (threading.main_thread().ident, number)))
            timers[0].daemon = True
            timers[0].start()

        try:
            with self.reacting(note):
                yield received
        finally:
            for timer in timers:
                timer.cancel()

    def _handle_with(self, handler):
        for number in self._numbers:
            signal.signal(number, handler)

    def _react(self, number):
        with self._lock:
            self._reactions[-1](number)

    def _read(self, reader):
        while True:
            for number in os.read(reader, 64):
                if number in self._numbers:
                    self._react(number)


def leave(number):
    """End the process at once, with the exit code that shells give to a signal."""
    os._exit(128 + number)


program_watch = SignalWatch(leave)
