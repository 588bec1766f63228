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

"""The benchmarks run, and the document they fill has a place for all that they measure."""

import importlib
from pathlib import Path
import re
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = ROOT / 'benchmark'

# They compile for minutes on a busy machine.
pytestmark = [pytest.mark.timeout(1200), pytest.mark.skipif(
    not BENCHMARKS.is_dir(), reason='not in a source checkout')]


@pytest.fixture
def benchmark(monkeypatch):
    """Return a function that imports a benchmark by name."""
    monkeypatch.setattr(sys, 'path', [str(BENCHMARKS), *sys.path])
    return importlib.import_module


def test_forward_dynamics_prints_times(benchmark, capsys):
    assert benchmark('forward_dynamics').main(
        ['four_bar', 'three_rrr', '--count', '20', '--repeats', '2', '--without-starts']) == 0
    text = capsys.readouterr().out
    assert 'numba' in text and 'commit' in text
    for scene in ('four_bar', 'three_rrr'):
        line = next(line for line in text.splitlines() if line.startswith(scene))
        numbers = [float(number) for number in re.findall(r'-?[\d.]+', line.removeprefix(scene))]
        assert len(numbers) == 8 and all(number > 0.0 for number in numbers[:6])
        # No step makes an array.
        assert numbers[7] == 0


def test_document_has_a_passage_for_every_part(benchmark):
    document = benchmark('make_accuracy_doc')
    text = (ROOT / 'doc' / 'accuracy.md').read_text()
    names = [f'{case.name} {part}' for case in document.CASES
             for part in ('findings', 'reference', 'table')]
    names += ['long', 'formulations table', 'formulations growth', 'machine']
    filled = document.filled(text, {name: f'[{name}]' for name in names})
    for name in names:
        assert f'-->\n[{name}]\n<!--' in filled
    assert filled.count('<!-- begin') == len(names)
    with pytest.raises(KeyError, match='no passage'):
        document.filled(text, {'poem': ''})
    for case in document.CASES:
        assert f'(pictures/accuracy_{case.name}.png)' in text


def test_document_parts_are_measured(benchmark, tmp_path, monkeypatch):
    document = benchmark('make_accuracy_doc')
    monkeypatch.setattr(document, 'default_lines', lambda: list(document.LONG_LINES))
    path = tmp_path / 'accuracy.md'
    path.write_text((ROOT / 'doc' / 'accuracy.md').read_text())
    assert document.main(
        ['--quick', '--only', 'three_rrr', '--document', str(path)]) == 0
    text = path.read_text()
    assert '* For 1e-06 over 1 s use dop853 with projection' in text
    assert '| rk4 | projection | subsystem |' in text
    assert (tmp_path / 'pictures' / 'accuracy_three_rrr.png').stat().st_size > 10000


def test_all_hooks_of_effects_are_found(benchmark, tmp_path):
    module = benchmark('effects_absent')
    for name in module.HOOKED:
        source = (ROOT / 'closedloop_dynamics' / 'integration' / name).read_text()
        path = tmp_path / name
        path.write_text(source)
        found = module.cut_hooks(path)
        assert found == source.count('    if effects is not None:\n')
        cut = path.read_text()
        compile(cut, name, 'exec')
        assert 'effects is not None:' not in cut
