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
Processes that help this one, and end with it.

    python -m closedloop_dynamics.ros.background spend CORE PARENT

uses up the spare time of a core, so that the core does not fall asleep: in a virtual machine it
may take a millisecond until a sleeping core runs again. It runs when nothing else wants to.

    python -m closedloop_dynamics.ros.background compile SCENE PARENT

compiles the rank-revealing path of a scene, for other processes to find it on disk. That takes
half a minute, and most runs never need it. So the simulator begins without, and starts this
process meanwhile, once for an installation.

"""

import ctypes
import fcntl
import os
import signal
import subprocess
import sys
import time

COMMAND = (sys.executable, '-m', 'closedloop_dynamics.ros.background')
# Of prctl(): which signal a process gets when its parent ends.
_PR_SET_PDEATHSIG = 1
# A node that ends sooner has not begun to compile anything [s].
DELAY = 5.0
LOWEST_PRIORITY = 19


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


class Awake:
    """Keeps the core of the thread that builds this awake while asked to."""

    def __init__(self):
        self._thread = os.getpid()
        self._cores = os.sched_getaffinity(self._thread)
        self._process = None

    def keep(self, awake):
        """
        Begin to or cease; nothing happens if that is so already.

        Raises OSError if this system does not allow it.

        """
        if awake and self._process is None:
            core = ctypes.CDLL(None).sched_getcpu()
            self._process = start_child(*COMMAND, 'spend', str(core))
            os.sched_setaffinity(self._thread, {core})
        elif not awake and self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
            os.sched_setaffinity(self._thread, self._cores)


def set_priority(priority):
    """
    Let the threads that this process has now go before all that is not real-time.

    All of them, because the main thread waits for those of DDS. ``priority`` is that of the
    scheduling policy SCHED_FIFO, 1 to 99; 0: nothing is changed. Raises OSError if this user may
    not.

    """
    if priority:
        for thread in os.listdir('/proc/self/task'):
            # What they start goes without.
            os.sched_setscheduler(int(thread), os.SCHED_FIFO | os.SCHED_RESET_ON_FORK,
                                  os.sched_param(priority))


class Preparation:
    """Gets the rank-revealing path of a scene's system ready: from disk, or in the background."""

    def __init__(self, scene, system, logger):
        from closedloop_dynamics.integration import precompile
        self._scene, self._logger = scene, logger
        self._process, self._due = None, time.monotonic() + DELAY
        self._left = precompile.preparations(system)
        self.over = precompile.is_stored(system)
        while self.over and self._left:
            self._left.pop()()

    def look(self):
        """Do what can be done now; to be called once a second until it is ``over``."""
        if self.over:
            return
        if self._process is None:
            if time.monotonic() >= self._due:
                self._start()
            return
        code = self._process.poll()
        if code is None:
            return
        if code != 0:
            self._give_up(f'exit code {code}')
        elif self._left:
            # One kernel at a time, for loading one takes 0.05 s.
            self._left.pop()()
        else:
            self.over = True
            self._logger.info(
                f'singular configurations: ready after {time.monotonic() - self._due:.0f} s')

    def close(self):
        """End the process, if it still runs."""
        self.over = True
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def _start(self):
        try:
            self._process = start_child(*COMMAND, 'compile', self._scene)
        except OSError as error:
            self._give_up(str(error))
            return
        self._logger.info(
            'compiling the code for singular configurations in the background (once for an '
            'installation, about a minute)')

    def _give_up(self, reason):
        self.over = True
        self._logger.warning(
            f'the code for singular configurations could not be compiled ahead ({reason}): '
            'the simulation will stand still for about a minute where it first meets one')


def spend(core):
    """Use up the spare time of a core of that number."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.sched_setaffinity(0, {core})
    while True:
        pass


def compile_ahead(scene):
    """Compile the rank-revealing path of a scene, unless another process does or has done so."""
    from closedloop_dynamics.core import cache
    from closedloop_dynamics.integration import precompile
    from closedloop_dynamics.simulation.simulation import Simulation
    os.nice(LOWEST_PRIORITY)
    system = Simulation.from_scene(scene).system
    if cache.directory() is None:
        sys.exit('there is no place to store compiled code')
    with (cache.directory() / 'prepare.lock').open('w') as lock:
        # Who waited finds all of it on disk.
        fcntl.flock(lock, fcntl.LOCK_EX)
        for get_ready in precompile.preparations(system):
            get_ready()
    if not precompile.is_stored(system):
        sys.exit('compiled code could not be stored')


if __name__ == '__main__':
    task, subject, parent_number = sys.argv[1:]
    die_with(int(parent_number))
    spend(int(subject)) if task == 'spend' else compile_ahead(subject)
