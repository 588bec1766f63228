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
of this file runs the callbacks, so that services answer that the simulation is busy.
"""

import math
import os
import threading
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
    callback_thread = None
    if beat is not None and not isinstance(executor, SingleThreadedExecutor):
        beat.take_over()
        callback_thread = _CallbackThread(executor)
    try:
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
            if callback_thread is None:
                beat.act()
            else:
                with callback_thread:
                    beat.act()
    finally:
        if callback_thread is not None:
            callback_thread.close()


class _CallbackThread:
    """A context: while its body takes long, another thread runs the callbacks of an executor."""

    def __init__(self, executor):
        self._executor, self._since, self._over = executor, None, False
        self._error = None
        # Who holds it may use the executor.
        self._turn = threading.Lock()
        self._turn.acquire()
        self._thread = threading.Thread(target=self._run_callbacks, name='callbacks', daemon=True)
        self._thread.start()

    def __enter__(self):
        self._since = time.monotonic()
        self._turn.release()

    def __exit__(self, *_):
        self._since = None
        self._turn.acquire()
        if self._error is not None:
            raise self._error

    def close(self):
        """End the thread."""
        self._over = True
        self._turn.release()
        self._thread.join()

    def _run_callbacks(self):
        while not self._over:
            since = self._since
            if since is None or time.monotonic() - since < LONG_BEAT:
                time.sleep(POLL)
                continue
            with self._turn:
                if self._since is None:
                    continue
                try:
                    self._executor.spin_once(timeout_sec=TURN)
                except Exception as error:
                    self._error, self._over = error, True


def _catch_up(executor):
    """Run all callbacks that are ready: those before a task that is added now."""
    done = []
    executor.create_task(done.append, True)
    while not done:
        executor.spin_once(timeout_sec=LONGEST_WAIT)
