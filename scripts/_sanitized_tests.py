# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

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
