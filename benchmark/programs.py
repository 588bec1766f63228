# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""
The package's executables as child processes, with their output and exit codes.

For the demonstration, the tests and the benchmarks. None outlives who started it.
"""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import closedloop_dynamics

FUNCTIONS = {
    'closedloop_simulator': 'simulator',
    'closedloop_torque_source': 'torque_source',
    'closedloop_recorder': 'recorder',
    'closedloop_joint_states': 'joint_states',
    'closedloop_estimator': 'estimator',
    'closedloop_viewer': 'viewer',
}
# Said by a node when it works.
READY = {
    'closedloop_simulator': 'simulating',
    'closedloop_torque_source': 'driving',
    'closedloop_recorder': 'recording',
    'closedloop_joint_states': 'completing',
    'closedloop_estimator': 'estimating',
    'closedloop_viewer': ' at http',
}
# The first start may compile everything [s].
PATIENCE = 240.0
POLL = 0.02
LINES_SHOWN = 12
_STARTER = """\
import signal
from closedloop_dynamics.ros import background, process
background.die_with({parent}, signal.SIGTERM)
process.{name}()
"""


class ProgramError(RuntimeError):
    """A program that failed; the message has its last output."""


class Program:
    """
    One executable, by its name as given to ``ros2 run``, in a process group of its own.

    Its output goes into the file ``log``. ``environment`` has changes to this process's own;
    ``directory`` is where it works, here if not given; ``path`` is the installed executable: if
    not given, that of this package runs in this Python. ``popen`` is the process.
    """

    def __init__(self, executable, arguments, log, environment=None, directory=None, path=None):
        self.executable, self.log = executable, log
        self._stopping = False
        environment = {**os.environ, 'PYTHONUNBUFFERED': '1', 'RCUTILS_COLORIZED_OUTPUT': '0',
                       **(environment or {})}
        command = [path]
        if path is None:
            code = _STARTER.format(parent=os.getpid(), name=FUNCTIONS[executable])
            command = [sys.executable, '-P', '-c', code]
            place = str(Path(closedloop_dynamics.__file__).resolve().parents[1])
            environment['PYTHONPATH'] = os.pathsep.join(
                [place, *filter(None, [environment.get('PYTHONPATH')])])
        with log.open('w') as file:
            self.popen = subprocess.Popen(
                [*command, *arguments], stdout=file, stderr=file, stdin=subprocess.DEVNULL,
                env=environment, cwd=directory, start_new_session=True)

    @property
    def output(self):
        """Return everything the process has said so far."""
        return self.log.read_text(errors='replace')

    def check(self):
        """Raise ProgramError if the process has ended without being asked to."""
        if self.popen.poll() is not None and not self._stopping:
            raise ProgramError(f'{self.executable} ended early, {self._ending()}')

    def wait_for(self, text, patience=PATIENCE, check=None):
        """Wait until the process has said something; raise ProgramError if it ends without."""
        deadline = time.monotonic() + patience
        while text not in self.output:
            if check is not None:
                check()
            if self.popen.poll() is not None and text not in self.output:
                raise ProgramError(f"{self.executable} ended before '{text}', {self._ending()}")
            if time.monotonic() > deadline:
                raise ProgramError(f"{self.executable} did not say '{text}' within "
                                   f'{patience:g} s, but ({self.log}):{self._last()}')
            time.sleep(POLL)
        return self

    def wait_until_ready(self):
        """Wait until the node has said that it works."""
        return self.wait_for(READY[self.executable])

    def send(self, number):
        """Send a signal to this process alone."""
        self._stopping = True
        self.popen.send_signal(number)

    def wait(self, patience=PATIENCE):
        """Wait for the end and return the exit code."""
        try:
            return self.popen.wait(patience)
        except subprocess.TimeoutExpired:
            raise ProgramError(f'{self.executable} still runs after {patience:g} s; it said last '
                               f'({self.log}):{self._last()}') from None

    def stop(self, number=signal.SIGINT, patience=PATIENCE):
        """Send a signal and return the exit code."""
        self.send(number)
        return self.wait(patience)

    def last_words(self):
        """Return the last line that it said, without the logger's prefix."""
        lines = [line.rsplit(']: ', 1)[-1] for line in self.output.split('\n') if line]
        return lines[-1] if lines else ''

    def end_group(self, number):
        """Send a signal to the process group, if there still is one."""
        try:
            os.killpg(self.popen.pid, number)
        except ProcessLookupError:
            pass

    def _ending(self):
        return (f'with exit code {self.popen.returncode}; it said last ({self.log}):'
                f'{self._last()}')

    def _last(self):
        return ''.join(f'\n  {line}' for line in self.output.splitlines()[-LINES_SHOWN:])


class Programs:
    """
    Those that run; all are ended when the ``with`` block is left, however that happens.

    ``directory`` is where they work and their logs are; ``environment`` has changes to this
    process's own.
    """

    def __init__(self, directory, environment=None):
        self._directory = directory
        self.environment = environment or {}
        self._started = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for program in self._started:
            if program.popen.poll() is None:
                program.end_group(signal.SIGTERM)
        deadline = time.monotonic() + 5.0
        for program in self._started:
            try:
                program.popen.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                pass
        self.kill_all()

    def start(self, executable, namespace=None, arguments=(), remap=(), path=None,
              **parameters):
        """
        Start an executable, by its name as given to ``ros2 run``; return its Program.

        ``arguments`` come before the other ROS arguments; ``remap`` are rules ``FROM:=TO``; the
        parameters have values as one writes them in YAML; ``path`` is as ``Program`` has it.
        """
        command = [*arguments, '--ros-args']
        rules = [*remap, *([f'__ns:={namespace}'] if namespace else [])]
        for rule in rules:
            command += ['-r', rule]
        for name, value in parameters.items():
            command += ['-p', f'{name}:={value}']
        log = self._directory / f'{len(self._started)}_{executable}.log'
        program = Program(executable, command, log, self.environment, self._directory,
                          path)
        self._started.append(program)
        return program

    def check(self):
        """Raise ProgramError if one of them has ended without being asked to."""
        for program in self._started:
            program.check()

    def kill_all(self):
        """Kill every process group that is left."""
        for program in self._started:
            program.end_group(signal.SIGKILL)
            program.popen.wait()
