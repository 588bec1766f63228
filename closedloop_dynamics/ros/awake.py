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
Waking up in time: a core that is kept from falling asleep, and the priority of a thread on it.

A core that has nothing to do sleeps, and in a virtual machine it may take a millisecond until it
runs again. So an idle process is kept on the core of the thread that should wake up: it runs
when nothing else wants to, and gives way at once.

    python -m closedloop_dynamics.ros.awake CORE PARENT

is that process; it ends with the process of number PARENT.

"""

import ctypes
import os
import sys

from closedloop_dynamics.ros.child import die_with, start_child


class Awake:
    """Keeps the core of the thread that builds this awake while asked to."""

    def __init__(self):
        self._thread = os.getpid()
        self._cores = os.sched_getaffinity(self._thread)
        self._process = None

    def keep(self, awake):
        """
        Begin or end; nothing happens if that is so already.

        Parameters
        ----------
        awake : bool
            Whether to.

        Raises
        ------
        OSError
            If this system does not allow it.

        """
        if awake and self._process is None:
            core = ctypes.CDLL(None).sched_getcpu()
            self._process = start_child(sys.executable, '-m', __name__, str(core))
            os.sched_setaffinity(self._thread, {core})
        elif not awake and self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
            os.sched_setaffinity(self._thread, self._cores)


def set_priority(priority):
    """
    Let the threads that this process has now go before all that is not real-time.

    All of them, because the main thread waits for those of DDS.

    Parameters
    ----------
    priority : int
        Of the scheduling policy SCHED_FIFO, 1 to 99; 0: nothing is changed.

    Raises
    ------
    OSError
        If this user may not.

    """
    if priority:
        for thread in os.listdir('/proc/self/task'):
            # What they start goes without.
            os.sched_setscheduler(int(thread), os.SCHED_FIFO | os.SCHED_RESET_ON_FORK,
                                  os.sched_param(priority))


def run(core, parent):
    """
    Use up the spare time of a core.

    Parameters
    ----------
    core : int
        Number of the core.
    parent : int
        Number of the process that started this one.

    """
    die_with(parent)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.sched_setaffinity(0, {core})
    while True:
        pass


if __name__ == '__main__':
    run(*map(int, sys.argv[1:]))
