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
and neither does ``spin_once()`` without a timeout; with one it does.

"""

import os

from rclpy.executors import SingleThreadedExecutor

# Which executor: anything else than 'events' means the single-threaded one.
VARIABLE = 'CLOSEDLOOP_EXECUTOR'
# A wait is interrupted by whatever happens; this is for the case that nothing does [s].
LONGEST_WAIT = 0.1


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


def spin(executor, over):
    """
    Run callbacks as they become due.

    Parameters
    ----------
    executor : rclpy.executors.Executor
        With a node.
    over : callable
        Asked after every callback whether to end.

    """
    while not over():
        executor.spin_once(timeout_sec=LONGEST_WAIT)
