# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Exceptions of the engine become Python's; the process goes on."""

import os
from pathlib import Path
import subprocess
import sys

from closedloop_dynamics.engine import native
import pytest

ROOT = Path(__file__).resolve().parents[2]
# Inverse dynamics takes a dense Jacobian, of 32 MB here; there is memory for a part of it.
CHILD = """
import resource
import numpy as np
from closedloop_dynamics.engine import native
from closedloop_dynamics.simulation.system import build_system
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.kinematics.modeling import build_model
from families import ladder

mechanism, position = ladder(1000)
system = build_system(build_model(validate_mechanism(mechanism)))
nv, nc = len(system.qdd), len(system.lam)
assert 8 * nv * nc >= 3e7
joints = np.arange(nv)
find = native.bind('find_torques', system.native, joints[:1], joints[1:], nc, np.zeros(0),
                   np.zeros(1 + nc))
given = np.array(position, dtype=float), np.zeros(nv), np.full(nv, np.inf)
assert not find(*given)
given = *given[:2], np.zeros(nv)
before = resource.getrlimit(resource.RLIMIT_AS)
used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2 ** 20, before[1]))
for _ in range(2):
    try:
        find(*given)
    except MemoryError as error:
        print(error, flush=True)
resource.setrlimit(resource.RLIMIT_AS, before)
system.evaluate(*given[:2])
print(np.isfinite(system.qdd).all())
"""


@pytest.mark.skipif('-fsanitize' in native.flags, reason='AddressSanitizer ends such a process')
@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='asks Linux how much is used')
def test_memory_that_is_not_there_is_a_memory_error():
    done = subprocess.run(
        [sys.executable, '-c', CHILD], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        timeout=300, check=False, env={
            **os.environ, 'PYTHONPATH': f'{ROOT}{os.pathsep}{ROOT / "benchmark"}'})
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ['out of memory', 'out of memory', 'True']
