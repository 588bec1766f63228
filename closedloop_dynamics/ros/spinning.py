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
The executor that spins a node, and how.

rclpy's events executor takes a third of the processor time of the single-threaded one, which
builds its wait set anew for every message. Its ``spin()`` does not work in every build of rclpy,
and neither does ``spin_once()`` without a timeout; with one it does. Its timers and timeouts wake
up a thread of its own first, and that one the caller: what has to happen in time is slept for
here.

"""

import os
import time

from rclpy.executors import SingleThreadedExecutor

# Which executor: anything else than 'events' means the single-threaded one.
VARIABLE = 'CLOSEDLOOP_EXECUTOR'
# A wait is interrupted by whatever happens; this is for the case that nothing does [s].
LONGEST_WAIT = 0.1
# Nearer to a beat than this, what happens waits for it; further, the executor waits until a
# little before it [s].
NEAR, BEFORE = 0.004, 0.002


def build_executor(context=None):
    """
    Return the quickest executor that this rclpy has.

    Parameters
    ----------
    context : rclpy.context.Context, optional
        The default one when not given.

    Returns
    -------
    rclpy.executors.Executor

    """
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

    Parameters
    ----------
    executor : rclpy.executors.Executor
        With a node.
    over : callable
        Asked after every callback whether to end.
    beat : object, optional
        Something to be done in time: ``take_over()`` is called once where this is possible,
        ``due()`` tells when (of the steady clock [s]; None: not now), ``act()`` does it.

    """
    if beat is not None and not isinstance(executor, SingleThreadedExecutor):
        beat.take_over()
    while not over():
        due = beat.due() if beat is not None else None
        ahead = due - time.monotonic() if due is not None else LONGEST_WAIT + BEFORE
        if ahead > NEAR:
            executor.spin_once(timeout_sec=min(ahead - BEFORE, LONGEST_WAIT))
            continue
        if ahead > 0.0:
            time.sleep(ahead)
        _catch_up(executor)
        beat.act()


def _catch_up(executor):
    """Run all callbacks that are ready: those before a task that is added now."""
    done = []
    executor.create_task(done.append, True)
    while not done:
        executor.spin_once(timeout_sec=LONGEST_WAIT)
