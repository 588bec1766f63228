# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Background computation beside a run: tasks longer than a frame, such as code generation."""

from concurrent.futures import ThreadPoolExecutor


class Background:
    """
    Compute one thing at a time on a thread of its own, while a machine moves.

    ``busy``: whether something is computed, or waits to be taken.
    """

    def __init__(self):
        self._pool = ThreadPoolExecutor(1)
        self._future = self._take = None

    @property
    def busy(self):
        """Return whether something is computed, or waits to be taken."""
        return self._future is not None

    def start(self, compute, take):
        """
        Start a computation; an earlier one is dropped.

        ``compute`` touches nothing that the run does; ``take`` is called by ``tick`` with a
        function that returns the result, or raises the error.
        """
        self._future, self._take = self._pool.submit(compute), take

    def drop(self):
        """Drop the present computation."""
        self._future = self._take = None

    def tick(self):
        """Hand over the result of a finished computation."""
        if self._future is not None and self._future.done():
            future, take = self._future, self._take
            self.drop()
            take(future.result)
