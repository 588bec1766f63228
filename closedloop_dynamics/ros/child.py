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

"""A process that helps this one and ends with it."""

import ctypes
import os
import signal
import subprocess
import sys

# Of prctl(): which signal a process gets when its parent ends.
_PR_SET_PDEATHSIG = 1


def start_child(*command):
    """
    Start a process that is told the number of this one as its last argument.

    Parameters
    ----------
    *command : str
        What to run; it calls ``die_with`` first.

    Returns
    -------
    subprocess.Popen

    Raises
    ------
    OSError
        If it cannot be started.

    """
    return subprocess.Popen(
        [*command, str(os.getpid())], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # Ctrl-C is for this process, which ends the other. Not a session of its own: Linux would
        # share the processor evenly between the two, however low the priority.
        process_group=0,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))})


def die_with(parent):
    """
    End this process when its parent ends, by whatever.

    Parameters
    ----------
    parent : int
        Number of the process that started this one.

    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        # It had ended before.
        os._exit(1)
