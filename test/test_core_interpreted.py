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

"""The tests of the kernels again without compilation, where their lines and errors are visible."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.timeout(1800)
@pytest.mark.skipif('NUMBA_DISABLE_JIT' in os.environ, reason='this run is without it already')
def test_core_without_compilation():
    run = subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', 'test/core'],
        cwd=ROOT, env={**os.environ, 'NUMBA_DISABLE_JIT': '1'},
        stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout[-20000:] + run.stderr[-5000:]
