# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What a benchmark ran on: processor, versions, commit."""

import importlib.metadata
import os
from pathlib import Path
import platform
import subprocess

from closedloop_dynamics.studies.published_benchmarks import processor

ROOT = Path(__file__).resolve().parents[1]
# Names the commit in the environment of benchmarks that a longer measurement runs.
COMMIT = 'BENCHMARK_COMMIT'
LIBRARIES = ('llvmlite', 'numpy', 'scipy')


def commit():
    """Return the commit of the checkout, marked where files differ from it."""
    if os.environ.get(COMMIT):
        return os.environ[COMMIT]
    try:
        name = subprocess.run(['git', 'describe', '--always', '--dirty'], cwd=ROOT, check=True,
                              capture_output=True, text=True)
        return name.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return 'unknown'


def description():
    """Return one line on the machine and the versions."""
    versions = ', '.join(f'{name} {importlib.metadata.version(name)}' for name in LIBRARIES)
    return (f'{processor()}, {platform.system()}; Python {platform.python_version()}, {versions}; '
            f'commit {commit()}')
