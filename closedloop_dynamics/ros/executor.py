# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The executor of the nodes, and the waiting for what has to be done in time.

rclpy's events executor takes a third of the processor time of the single-threaded one (0.1 ms for
each message against 0.3 ms), which rebuilds its wait set for every message, and a seventh of that
of the one with several threads and callback groups (0.7 ms). Its ``spin()`` does not work in every
build of rclpy, and neither does ``spin_once()`` without a timeout; with one it does. Its timers
and timeouts wake up a thread of its own first, and that one the caller: what has to happen in time
is slept for here.

A step of a simulation may take long: next to a singular position, or while code for one is
compiled. It is made outside the executor, which is not reentrant. While that takes long, a thread
of this file runs the callbacks, so that services answer that the simulation is busy. Callback
groups could do so only in rclpy's executor with several threads, as rclpy does not divide a node's
groups among executors: a message to a node with two groups takes 1.7 to 6 ms of processor time
there, and 0.02 to 0.03 ms in the events executor. Beats in a thread of their own would have to
wake it up each time; this one looks ten times a second whether a beat has lasted for long.
"""

from contextlib import ExitStack, nullcontext
import math
import os
from threading import Event, Lock, Thread
import time

# Which executor: anything else than 'events' means the single-threaded one.
VARIABLE = 'CLOSEDLOOP_EXECUTOR'
# A wait is interrupted by whatever happens; this is for the case that nothing does [s].
LONGEST_WAIT = 0.1
# Nearer to a beat than this, what happens waits for it; further, the executor waits until a
# little before it [s].
NEAR, BEFORE = 0.004, 0.002
# After a beat longer than this, another thread runs the callbacks; it checks so often,
# and gives the executor back after so long [s].
LONG_BEAT, POLL, TURN = 0.5, 0.1, 0.02


def build_executor(context=None):
    """Return the quickest executor that this rclpy has, in a context or the default one."""
    from rclpy.executors import SingleThreadedExecutor
    if os.environ.get(VARIABLE, 'events') == 'events':
        try:
            from rclpy.experimental.events_executor import EventsExecutor
            return EventsExecutor(context=context)
        except ImportError:
            # An older rclpy.
            pass
    return SingleThreadedExecutor(context=context)


def spin(executor, over, beat=None):
    """
    Run callbacks as they become due.

    ``over()`` is called after every callback: whether to end. ``beat`` is something to be done in
    time: ``take_over()`` is called once where this is possible, ``due()`` gives when (of the
    steady clock [s]; -inf: at once; None: not now), ``act()`` does it. While ``act()`` takes long,
    callbacks run in another thread.
    """
    from rclpy.executors import SingleThreadedExecutor
    with ExitStack() as limits:
        meanwhile = nullcontext()
        if beat is not None and not isinstance(executor, SingleThreadedExecutor):
            beat.take_over()
            meanwhile = _Substitute(executor)
            limits.callback(meanwhile.close)
        while not over():
            due = beat.due() if beat is not None else None
            ahead = due - time.monotonic() if due is not None else LONGEST_WAIT + BEFORE
            if ahead > NEAR:
                executor.spin_once(timeout_sec=min(ahead - BEFORE, LONGEST_WAIT))
                continue
            if ahead > 0.0:
                time.sleep(ahead)
            # A callback's request comes before other callbacks.
            if due > -math.inf:
                _catch_up(executor)
            with meanwhile:
                beat.act()


class _Substitute(Thread):
    """A context: while its body takes long, this thread runs the callbacks of an executor."""

    def __init__(self, executor):
        super().__init__(name='callbacks', daemon=True)
        self._executor, self._error = executor, None
        # When the body was entered; who holds the lock may use the executor.
        self._since, self._turn, self._over = math.inf, Lock(), Event()
        self.start()

    def __enter__(self):
        self._since = time.monotonic()

    def __exit__(self, *_):
        self._since = math.inf
        with self._turn:
            pass
        if self._error is not None:
            raise self._error

    def close(self):
        """End the thread."""
        self._over.set()
        self.join()

    def run(self):
        """Wait for bodies that take long."""
        try:
            while not self._over.wait(POLL):
                while self._is_long():
                    with self._turn:
                        # The body may have ended before this thread had its turn.
                        if self._is_long():
                            self._executor.spin_once(timeout_sec=TURN)
        except Exception as error:
            self._error = error

    def _is_long(self):
        return time.monotonic() - self._since > LONG_BEAT


def _catch_up(executor):
    """Run all callbacks that are ready: those before a task that is added now."""
    done = []
    executor.create_task(done.append, True)
    while not done:
        executor.spin_once(timeout_sec=LONGEST_WAIT)
