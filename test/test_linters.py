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

"""The linters of ROS 2 Jazzy, ament_flake8 and ament_pep257, and the licence headers."""

from pathlib import Path

from ament_flake8.main import main_with_errors as ament_flake8
from ament_pep257.main import main as ament_pep257
import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('benchmark', 'closedloop_dynamics', 'doc', 'launch', 'scripts', 'test')
SOURCES = sorted(['setup.py', *(str(path.relative_to(ROOT)) for folder in FOLDERS
                                for path in (ROOT / folder).rglob('*.py'))])
LICENCE = 'Licensed under the Apache License, Version 2.0'


@pytest.fixture(autouse=True)
def in_root(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_sources_are_found():
    assert {'setup.py', 'test/test_linters.py'} < set(SOURCES)


def test_flake8(capsys):
    code, errors = ament_flake8(argv=SOURCES)
    capsys.readouterr()  # the same again, and the names of all files
    assert code == 0, f'{len(errors)} errors:\n' + '\n'.join(errors)


def test_pep257(capsys, caplog):
    caplog.set_level('WARNING', 'pydocstyle.utils')
    code = ament_pep257(argv=SOURCES)
    assert code == 0, capsys.readouterr().err


@pytest.mark.parametrize('path', SOURCES)
def test_licence_header(path):
    start = Path(path).read_text().splitlines()[:14]
    assert start[0].startswith('# Copyright ')
    assert LICENCE in start[2]
