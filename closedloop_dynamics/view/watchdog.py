# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Stops a computation of the engine that takes longer than a page can wait."""

import threading
import time

from ..engine.stop_flag import StopFlag

# Period of checking the clock [s].
PERIOD = 0.03


class Watchdog:
    """
    Context that monitors a computation from a thread of its own.

    ``limit``: how long a computation may take [s]; ``wanted``: whether somebody waits for
    something else: then one stops that may take longer, too; ``waiting`` is called, in the thread,
    with the time that one takes longer than the limit [s].
    """

    def __init__(self, limit, wanted, waiting):
        self.limit, self._wanted, self._waiting = limit, wanted, waiting
        self._patient = False
        self._lock, self._over = threading.Lock(), threading.Event()
        self._begun, self._stopped, self._stop = None, False, StopFlag()
        self._thread = threading.Thread(target=self._watch, name='watchdog', daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._over.set()
        self._thread.join()

    def does(self, action, patient=False):
        """
        Do something that may be stopped, its steps then as not made; return whether it was done.

        ``patient``: it may take as long as nobody wants something else.
        """
        self._patient, self._begun = patient, time.monotonic()
        try:
            with self._stop:
                action()
        except KeyboardInterrupt:
            if not self._stopped:
                raise
            return False
        finally:
            with self._lock:
                self._begun = None
                self._stop.clear()
                self._stopped = False
        return True

    def _watch(self):
        while not self._over.wait(PERIOD):
            with self._lock:
                begun = self._begun
                late = begun is not None and time.monotonic() - begun > self.limit
                if late and not self._stopped and (not self._patient or self._wanted()):
                    self._stopped = True
                    self._stop.set()
            if late:
                self._waiting(time.monotonic() - begun)
