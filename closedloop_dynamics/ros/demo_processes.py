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

"""The nodes of the demonstration as processes of their own, none of which is left behind."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import closedloop_dynamics

# On Linux a process started here gets SIGTERM when this one is killed, and ends by itself where
# that has happened already.
STARTER = """\
import os, sys
if sys.platform == 'linux':
    import ctypes
    ctypes.CDLL(None).prctl(1, 15)
    if os.getppid() != {parent}:
        sys.exit('whoever started this is gone')
from closedloop_dynamics.ros import executables
sys.exit(executables.{name}())
"""
FUNCTIONS = {
    'closedloop_simulator': 'simulator',
    'closedloop_torque_source': 'torque_source',
    'closedloop_recorder': 'recorder',
}
# What an orderly end may take, before it is enforced [s].
PATIENCE = 20.0
LINES_SHOWN = 12


class DemoError(RuntimeError):
    """The demonstration failed; the message says of what."""


class Program:
    """
    One of the package's executables, in a process group of its own.

    Parameters
    ----------
    executable : str
        Its name, as given to ``ros2 run``.
    arguments : sequence of str
        ROS arguments.
    log : pathlib.Path
        Where its output goes.

    """

    def __init__(self, executable, arguments, log):
        self.executable = executable
        self.log = log
        self._stopping = False
        place = str(Path(closedloop_dynamics.__file__).resolve().parents[1])
        paths = [place, *filter(None, [os.environ.get('PYTHONPATH')])]
        environment = {
            **os.environ, 'PYTHONPATH': os.pathsep.join(paths), 'PYTHONUNBUFFERED': '1',
            'RCUTILS_COLORIZED_OUTPUT': '0'}
        code = STARTER.format(parent=os.getpid(), name=FUNCTIONS[executable])
        with log.open('w') as output:
            self._process = subprocess.Popen(
                [sys.executable, '-P', '-c', code, '--ros-args', *arguments], stdout=output,
                stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=environment,
                start_new_session=True)

    @property
    def exit_code(self):
        """Return the exit code, or None while it runs."""
        return self._process.poll()

    def check(self):
        """Raise DemoError if the process has ended without being asked to."""
        if self.exit_code is not None and not self._stopping:
            raise DemoError(f'{self.executable} ended early, {self._ending()}')

    def stop(self, number):
        """Ask the process to end and wait for that; raise DemoError unless it ends with 0."""
        self.check()
        self._stopping = True
        self._process.send_signal(number)
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            raise DemoError(f'{self.executable} still ran {PATIENCE:g} s after '
                            f'{signal.Signals(number).name}') from None
        if self.exit_code != 0:
            raise DemoError(f'{self.executable} did not end well, {self._ending()}')

    def says(self, text):
        """Return whether the log holds a text."""
        return text in self.log.read_text(errors='replace')

    def last_words(self):
        """Return the last line of the log, without the logger's prefix."""
        lines = self.log.read_text(errors='replace').split('\n')
        said = [line.rsplit(']: ', 1)[-1] for line in lines if line]
        return said[-1] if said else ''

    def kill(self, deadline):
        """End the process and its group: by SIGTERM until a deadline, then by SIGKILL."""
        try:
            self._process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            self.signal_group(signal.SIGKILL)
            self._process.wait()

    def signal_group(self, number):
        """Send a signal to the process group if the process still runs."""
        if self.exit_code is None:
            os.killpg(self._process.pid, number)

    def _ending(self):
        lines = self.log.read_text(errors='replace').splitlines()[-LINES_SHOWN:]
        said = ''.join(f'\n  {line}' for line in lines) or ' nothing'
        return f'with exit code {self.exit_code}; it said last ({self.log}):{said}'


class Programs:
    """
    Those that run; all are ended when the ``with`` block is left, however that happens.

    Parameters
    ----------
    directory : pathlib.Path
        For their logs.

    """

    def __init__(self, directory):
        self._directory = directory
        self._started = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for program in self._started:
            program.signal_group(signal.SIGTERM)
        deadline = time.monotonic() + PATIENCE / 4
        for program in self._started:
            program.kill(deadline)

    def start(self, executable, arguments):
        """Start an executable and return its Program."""
        program = Program(executable, arguments, self._directory / f'{executable}.log')
        self._started.append(program)
        return program

    def check(self):
        """Raise DemoError if one of them has ended without being asked to."""
        for program in self._started:
            program.check()
