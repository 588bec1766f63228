# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A process that helps this one, and ends with it.

    python -m closedloop_dynamics.ros.background CORE PARENT

uses up the spare time of a core, so that the core does not fall asleep: in a virtual machine it
may take a millisecond until a sleeping core runs again. It runs when nothing else wants to.
"""

import ctypes
import os
import signal
import subprocess
import sys

COMMAND = (sys.executable, '-m', 'closedloop_dynamics.ros.background')
# Option of prctl(): the signal that a process gets when its parent ends.
_PR_SET_PDEATHSIG = 1


def start_child(*command):
    """
    Start a process whose last argument is the number of this one; it calls ``die_with`` first.

    Raises OSError if it cannot be started.
    """
    return subprocess.Popen(
        [*command, str(os.getpid())], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # Ctrl-C is for this process, which ends the other. Not a session of its own: Linux would
        # share the processor evenly between the two, however low the priority.
        process_group=0,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))})


def die_with(parent, number=signal.SIGKILL):
    """End this process by a signal when its parent, of that number, ends; on Linux."""
    if sys.platform != 'linux':
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)
    if os.getppid() != parent:
        # It had ended before.
        os._exit(1)


class IdleStateInhibitor:
    """Keeps the core of the thread that builds this out of idle states on request."""

    def __init__(self):
        self._thread = os.getpid()
        self._cores = os.sched_getaffinity(self._thread)
        self.process = None

    def keep(self, awake):
        """
        Begin to or cease; nothing happens if that is so already.

        Raises OSError if this system does not allow it.
        """
        if awake and self.process is None:
            core = ctypes.CDLL(None).sched_getcpu()
            self.process = start_child(*COMMAND, str(core))
            os.sched_setaffinity(self._thread, {core})
        elif not awake and self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None
            os.sched_setaffinity(self._thread, self._cores)


def set_priority(priority):
    """
    Raise the priority of this process's present threads above all that is not real-time.

    All of them, because the main thread waits for those of DDS. ``priority`` is that of the
    scheduling policy SCHED_FIFO, 1 to 99; 0: nothing is changed. Raises OSError if this user may
    not.
    """
    if priority:
        for thread in os.listdir('/proc/self/task'):
            # What they start goes without.
            os.sched_setscheduler(int(thread), os.SCHED_FIFO | os.SCHED_RESET_ON_FORK,
                                  os.sched_param(priority))


def spend(core):
    """Use up the spare time of a core of that number."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.sched_setaffinity(0, {core})
    while True:
        pass


if __name__ == '__main__':
    own_core, parent_number = sys.argv[1:]
    die_with(int(parent_number))
    spend(int(own_core))
