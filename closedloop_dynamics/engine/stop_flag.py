# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Requests to end long computations of the engine, each with an owner."""

from . import native


class StopFlag:
    """
    A request to stop, for the threads that heed it and for no others.

    They stop as well where the flag is set that was heeded by the thread that made this one. A
    computation that is stopped raises KeyboardInterrupt, its present step as not made.
    """

    def __init__(self) -> None:
        self._flag = native.stop_flag(0)

    def set(self) -> None:  # noqa: A003
        """Ask the threads that heed it to stop."""
        self._flag.set_stop(1)

    def clear(self) -> None:
        """Withdraw the request."""
        self._flag.set_stop(0)

    def heed(self) -> None:
        """Make the calling thread heed it from now on."""
        native.heed(self._flag)

    def __enter__(self) -> 'StopFlag':
        """Make the calling thread heed it in the body, in the place of another."""
        self._before = native.heed(self._flag)
        return self

    def __exit__(self, *error: object) -> None:
        native.heed(self._before)
