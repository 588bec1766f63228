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

"""Run pytest with the engine that scripts/sanitize compiled in the place of the ordinary one."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
NAME = 'closedloop_dynamics.engine.native'


def main():
    path = ROOT / 'build' / 'engine-sanitize' / 'native.abi3.so'
    spec = spec_from_file_location(NAME, path)
    sys.modules[NAME] = module_from_spec(spec)
    spec.loader.exec_module(sys.modules[NAME])
    sys.path.insert(0, str(ROOT))
    return pytest.main(sys.argv[1:] or ['test/engine'])


if __name__ == '__main__':
    sys.exit(main())
