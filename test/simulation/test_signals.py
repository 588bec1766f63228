# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Signals end programs that do not look whether one has come."""

from pathlib import Path
import signal
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[2]
# A loop of Python that never ends by itself, as in a command that notes signals.
CHILD = """
import sys
from closedloop_dynamics.simulation.signals import Interrupted, program_watch
program_watch.install()
try:
    with program_watch.interrupting(), program_watch.noting() as received:
        print('ready', flush=True)
        while True:
            pass
except Interrupted as error:
    sys.exit(f'{received} {error}')
"""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_loop_that_never_looks_is_ended(number):
    with subprocess.Popen([sys.executable, '-c', CHILD], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout.readline() == 'ready\n'
        child.send_signal(number)
        # The first one is noted, and the body gets it again.
        _, error = child.communicate()
    assert child.returncode == 1
    assert error.strip() == f'[{int(number)}] {int(number)}'
