# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Ctrl-C at any moment of a program's first seconds: the promised exit code, and no traceback."""

from pathlib import Path
import random
import signal
import subprocess
import sys
import time

import pytest

NODE = 'from closedloop_dynamics.ros import process; process.{}()'
# Command line of Python, and the exit code after SIGINT.
PROGRAMS = {
    'closedloop': (
        ['-m', 'closedloop_dynamics.cli', 'simulate', 'four_bar', '--duration', '1e9'], 130),
    'simulator': (['-c', NODE.format('simulator')], 0),
    'torque_source': (['-c', NODE.format('torque_source')], 0),
    'recorder': (['-c', NODE.format('recorder')], 0),
}
# A node that asks to be ended, and whose topics DDS never closes.
STUCK = """
import os, signal, threading
from closedloop_dynamics.ros import process
process.watch_signals()
from rclpy.node import Node

class Stuck(Node):
    exit_code = None

    def __init__(self):
        super().__init__('stuck')
        self.create_timer(0.01, lambda: os.kill(os.getpid(), signal.SIGINT))

    def close(self):
        print('closed', flush=True)

    def destroy_node(self):
        threading.Event().wait()

process.leave(process.run(Stuck, 'stuck', '', ['stuck'], loses_nothing=True))
"""
DELAYS = (0.0, 0.02, 0.1, 0.3)
PATIENCE = 240.0


def watches(pid):
    """Return whether a process has handlers of its own: Python by itself has none of SIGTERM."""
    status = Path(f'/proc/{pid}/status').read_text()
    caught = int(status.split('SigCgt:')[1].split()[0], 16)
    return caught >> (signal.SIGTERM - 1) & 1


def interrupted(arguments, directory, delay, times):
    """Start a program, send SIGINT so long after it began to watch; return code and errors."""
    process = subprocess.Popen(
        [sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        text=True, cwd=directory)
    try:
        deadline = time.monotonic() + PATIENCE
        while not watches(process.pid):
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.001)
        time.sleep(delay)
        for _ in range(times):
            process.send_signal(signal.SIGINT)
            time.sleep(0.002)
        _, errors = process.communicate(timeout=PATIENCE)
        return process.returncode, errors
    finally:
        process.kill()


@pytest.mark.parametrize('times', [2, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize('program', PROGRAMS)
def test_interrupt_ends_a_starting_program_in_order(program, times, domain, tmp_path):
    arguments, code = PROGRAMS[program]
    ended = [interrupted(arguments, tmp_path, delay, times) for delay in DELAYS]
    assert [end[0] for end in ended] == [code] * len(DELAYS)
    assert not any('Traceback' in end[1] or 'KeyboardInterrupt' in end[1] for end in ended)


@pytest.mark.slow
@pytest.mark.parametrize('program', PROGRAMS)
def test_interrupt_ends_a_program_in_order_whenever_it_comes(program, domain, tmp_path):
    arguments, code = PROGRAMS[program]
    rng = random.Random(1)
    for i in range(15):
        delay, times = 4.0 * rng.random() ** 2, rng.choice((1, 2, 5))
        directory = tmp_path / str(i)
        directory.mkdir()
        ended, errors = interrupted(arguments, directory, delay, times)
        assert ended == code and 'Traceback' not in errors, f'{delay} s, {times}: {errors}'


def test_signal_ends_a_node_whose_topics_cannot_be_closed(domain):
    ended = subprocess.run(
        [sys.executable, '-c', STUCK], capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, 'closed\n', '')
