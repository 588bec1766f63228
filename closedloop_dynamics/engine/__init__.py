# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Kernels in C++, compiled when the package is installed: the extension module native."""

from pathlib import Path

try:
    from closedloop_dynamics.engine import native
except ImportError as error:
    raise ImportError(
        f'The compiled engine of closedloop_dynamics is missing ({error}). Compile it: '
        'scripts/build in a checkout, colcon build in a workspace, or install the package with '
        'pip.') from error

# An installed package has no sources, and nothing to check.
if (Path(__file__).parent / 'bindings.cpp').is_file():
    from closedloop_dynamics.engine import build
    if native.sources != build.digest():
        raise ImportError(
            f'The sources of the engine changed after {native.__file__} was compiled. Compile it '
            'again: scripts/build in a checkout, colcon build in a workspace.')
