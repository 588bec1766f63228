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

"""Real processes of the package's executables, with their output and exit codes."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

# The first start may compile everything.
PATIENCE = 120.0
EXECUTABLES = {
    'closedloop_simulator': 'simulator',
    'closedloop_torque_source': 'torque_source',
    'closedloop_recorder': 'recorder',
}
# Said by a node when it works.
READY = {
    'closedloop_simulator': 'simulating',
    'closedloop_torque_source': 'driving',
    'closedloop_recorder': 'recording',
}


def memory(process):
    """Return the resident memory of a process [bytes]."""
    pages = int(Path(f'/proc/{process.popen.pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE')


class Process:
    """One executable in a process group of its own."""

    def __init__(self, executable, arguments, output, environment, directory):
        self.executable = executable
        self._output = output
        code = (f'import sys; from closedloop_dynamics.ros import executables; '
                f'sys.exit(executables.{EXECUTABLES[executable]}())')
        with output.open('w') as file:
            self.popen = subprocess.Popen(
                [sys.executable, '-c', code, *arguments], stdout=file, stderr=file,
                stdin=subprocess.DEVNULL, env=environment, cwd=directory,
                start_new_session=True)

    @property
    def output(self):
        """Return everything the process has said so far."""
        return self._output.read_text()

    def wait_for(self, text, patience=PATIENCE):
        """Wait until the process has said something; fail if it ends without."""
        deadline = time.monotonic() + patience
        while text not in self.output:
            assert self.popen.poll() is None or text in self.output, (
                f'{self.executable} ended with {self.popen.returncode}:\n{self.output}')
            assert time.monotonic() < deadline, f'no "{text}" in:\n{self.output}'
            time.sleep(0.01)
        return self

    def wait_until_ready(self):
        """Wait until the node has said that it works."""
        return self.wait_for(READY[self.executable])

    def send(self, number):
        """Send a signal to this process alone."""
        self.popen.send_signal(number)

    def wait(self, patience=PATIENCE):
        """Wait for the end and return the exit code."""
        try:
            return self.popen.wait(patience)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f'{self.executable} still runs after {patience} s:\n{self.output}') from None

    def stop(self, number=signal.SIGINT):
        """Send a signal and return the exit code."""
        self.send(number)
        return self.wait()


class Processes:
    """Start executables, and leave none behind."""

    def __init__(self, directory, environment):
        self._directory = directory
        self.environment = environment
        self._started = []

    def start(self, executable, namespace=None, arguments=(), remap=(), **parameters):
        """
        Start an executable.

        Parameters
        ----------
        executable : str
            Its name, as given to ``ros2 run``.
        namespace : str, optional
            Of the node.
        arguments : sequence of str
            Given as they are, before the ROS arguments.
        remap : sequence of str
            ``FROM:=TO``.
        **parameters
            ROS ones, with values as one writes them in YAML.

        Returns
        -------
        Process

        """
        command = list(arguments) + ['--ros-args']
        rules = list(remap) + ([f'__ns:={namespace}'] if namespace else [])
        for rule in rules:
            command += ['-r', rule]
        for name, value in parameters.items():
            command += ['-p', f'{name}:={value}']
        output = self._directory / f'{len(self._started)}_{executable}.log'
        process = Process(executable, command, output, self.environment, self._directory)
        self._started.append(process)
        return process

    def kill_all(self):
        """Kill every process group that is left."""
        for process in self._started:
            try:
                os.killpg(process.popen.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            process.popen.wait()
