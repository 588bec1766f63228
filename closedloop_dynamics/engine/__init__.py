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

"""Kernels in C++, compiled when the package is installed: the extension module native."""

from pathlib import Path

try:
    from closedloop_dynamics.engine import native
except ImportError as error:
    raise ImportError(
        f'The compiled engine of closedloop_dynamics is missing ({error}). Compile it: '
        'scripts/build in a checkout, colcon build in a workspace, or install the package with '
        'pip.') from error

# An installed package has no sources, and no need to look.
if (Path(__file__).parent / 'bindings.cpp').is_file():
    from closedloop_dynamics.engine import build
    if native.sources != build.digest():
        raise ImportError(
            f'The sources of the engine changed after {native.__file__} was compiled. Compile it '
            'again: scripts/build in a checkout, colcon build in a workspace.')
