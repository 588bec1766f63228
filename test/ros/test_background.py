# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of closedloop_dynamics.ros.background."""

from pathlib import Path
import subprocess
import sys
import time

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 240.0


def wait(condition, what):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f'no {what}'
        time.sleep(0.02)


def is_alive(number):
    """Return whether a process runs: not ended, and not waiting for its parent to notice."""
    try:
        return Path(f'/proc/{number}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except FileNotFoundError:
        return False


def test_process_ends_with_a_parent_that_was_killed(tmp_path):
    child = ('import os, sys, time; from closedloop_dynamics.ros.background import die_with; '
             'die_with(int(sys.argv[1])); print(os.getpid(), flush=True); time.sleep(600)')
    parent = subprocess.Popen(
        [sys.executable, '-c', 'import os, subprocess, sys; subprocess.run('
         f'[sys.executable, "-c", {child!r}, str(os.getpid())])'],
        stdout=subprocess.PIPE, text=True, cwd=ROOT)
    number = int(parent.stdout.readline())
    assert is_alive(number)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    wait(lambda: not is_alive(number), 'end of the orphan')
