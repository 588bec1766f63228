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

"""
Measure all that doc/accuracy.md shows, and put it there.

Writes the pictures and CSV files doc/pictures/accuracy_*.* and fills the passages of
doc/accuracy.md between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``; the text
around them stays. To be run on a machine that does nothing else.

"""

import argparse
from dataclasses import dataclass, field
import datetime
from pathlib import Path
import re
import sys
import time

import energy_study
from machine import description, ROOT

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.simulation.scene import load_scene  # noqa: E402,I100
from closedloop_dynamics.studies import accuracy_report, formulations_report  # noqa: E402
from closedloop_dynamics.studies.accuracy import default_lines, Line, study_accuracy  # noqa: E402
from closedloop_dynamics.studies.advice import for_target, yaml_lines  # noqa: E402
from closedloop_dynamics.studies.formulations import study_formulations  # noqa: E402
from closedloop_dynamics.visual.tables import markdown_table, seconds, share  # noqa: E402

TARGETS = (1e-3, 1e-6, 1e-9)
BASE_TORQUES = {'theta_1': 5.0, 'theta_6': -3.0, 'theta_7': 2.0}


@dataclass(frozen=True)
class Case:
    """One study of the document: its name there, scene, torques, duration [s]."""

    name: str
    scene: str
    torque: dict = field(default_factory=dict)
    duration: float = 1.0
    everything: bool = False


CASES = (
    Case('three_rrr', 'three_rrr', everything=True),
    Case('three_rrr_driven', 'three_rrr', BASE_TORQUES),
    Case('carpet_scraper', 'carpet_scraper', everything=True),
    Case('carpet_scraper_driven', 'carpet_scraper', {'theta_1': 2.0}),
    Case('carpet_scraper_on_carpet', 'carpet_scraper_on_carpet', {'theta_1': 30.0}),
    Case('slider_crank_end_stop', 'slider_crank_end_stop'),
)
# The measurements of other simulators that the README of the project speaks of: 2 s.
LONG_CASES = (Case('three_rrr_driven_2s', 'three_rrr', BASE_TORQUES, 2.0),
              Case('three_rrr_2s', 'three_rrr', {}, 2.0))
LONG_LINES = (Line('rk4'), Line('dopri5'), Line('dop853'))


def lines(case):
    """Return the lines to measure: all of them, or the integrators alone."""
    return [line for line in default_lines() if case.everything or line == Line(line.integrator)]


def cheapest(study, target, line):
    """Return the cheapest row of a line that holds a target, None where there is none."""
    part = type(study)(study.scene, study.duration, study.torque, study.reference,
                       [row for row in study.rows if row.line == line])
    return for_target(part, target).row if any(not row.failure for row in part.rows) else None


def summary(study):
    """Return the costs of each line for the targets, as a table."""
    header = ('integrator', 'stabilisation', 'formulation', *(
        f'positions within {target:.0e}' for target in TARGETS))
    rows = []
    for line in study.lines():
        best = [cheapest(study, target, line) for target in TARGETS]
        rows.append((line.integrator, line.stabilisation, line.formulation, *map(_cell, best)))
    return markdown_table(header, rows)


def _cell(row):
    if row is None:
        return 'not reached'
    kind = 'tolerance' if row.line.adaptive else 'step'
    unit = '' if row.line.adaptive else ' s'
    return f'{seconds(row.cost)} ({kind} {row.setting.value:g}{unit})'


def findings(study):
    """Return what to use for each target, in words."""
    parts = []
    for target in TARGETS:
        row = for_target(study, target).row
        usual = cheapest(study, target, Line('rk4'))
        start = f'* For {target:.0e} over {study.duration:g} s'
        if row is None:
            parts.append(f'{start}: nothing that was tried reaches it.')
            continue
        setting = yaml_lines(row.method).splitlines()[2].strip().replace(':', '')
        text = (f'{start} use {row.line.integrator} with {row.line.stabilisation} ({setting}): '
                f'it costs {seconds(row.cost)} per simulated second, {share(row.cost)}')
        if usual is None:
            text += '; RK4 does not reach it at any cost tried'
        elif usual.line != row.line:
            text += f'; RK4 needs {usual.cost / row.cost:.1f} times as much'
        parts.append(text + '.')
    return '\n'.join(parts)


def long_runs(studies):
    """Return the table of errors below 1e-6 over 2 s."""
    rows = []
    for study in studies:
        for line in study.lines():
            row = cheapest(study, 1e-6, line)
            rows.append((accuracy_report.title(study), line.integrator, _cell(row),
                         '' if row is None else f'{row.position_error:.1e}'))
    return markdown_table(('motion', 'integrator', 'CPU time per simulated second', 'error'), rows)


def passages(pictures, quick, only):
    """Measure; return {name of a passage: its text}."""
    result = {}
    for case in CASES:
        if only and case.name not in only:
            continue
        study = _studied(case, lines(case), quick)
        accuracy_report.write(study, pictures / f'accuracy_{case.name}.csv',
                              pictures / f'accuracy_{case.name}.png')
        result[f'{case.name} findings'] = findings(study)
        result[f'{case.name} reference'] = study.reference.description
        result[f'{case.name} table'] = summary(study)
    if not only or 'long' in only:
        result['long'] = long_runs([
            _studied(case, LONG_LINES, quick) for case in LONG_CASES])
    if not only or 'formulations' in only:
        rows = study_formulations(quick=quick, progress=_progress('formulations'))
        formulations_report.write(rows, pictures / 'accuracy_formulations.csv',
                                  pictures / 'accuracy_formulations.png')
        result['formulations table'] = formulations_report.table(
            [row for row in rows if row.size in (7, 10, 100, 1000)], markdown=True)
        result['formulations growth'] = '\n'.join(
            f'* {line}' for line in formulations_report.growth_text(rows).splitlines())
    if not only or 'energy' in only:
        result['energy'] = energy_study.table(quick)
    date = datetime.date.today().isoformat()
    result['machine'] = f'Measured on {date}: {description()}.' + (
        ' Quick version: fewer settings.' if quick else '')
    return result


def _studied(case, chosen, quick):
    return study_accuracy(load_scene(case.scene), case.torque, case.duration, quick,
                          list(chosen), _progress(case.name))


def _progress(name):
    begin = time.perf_counter()

    def progress(done, total):
        print(f'\r{name}: {done} of {total}, {time.perf_counter() - begin:.0f} s ',
              end='\n' if done == total else '', file=sys.stderr, flush=True)

    return progress


def filled(text, parts):
    """
    Return a document with passages replaced.

    Raises
    ------
    KeyError
        Where it has no such passage.

    """
    for name, part in parts.items():
        begin, end = (f'<!-- {word} {re.escape(name)} -->' for word in ('begin', 'end'))
        pattern = re.compile(f'({begin}\n).*?({end})', re.DOTALL)
        if not pattern.search(text):
            raise KeyError(f'the document has no passage {name!r}')
        text = pattern.sub(lambda match: f'{match[1]}{part}\n{match[2]}', text)
    return text


def main(arguments=None):
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='fewer settings')
    parser.add_argument('--only', action='append', metavar='NAME', default=[],
                        help='one study alone: ' + ', '.join(
                            [*(case.name for case in CASES), 'long', 'energy', 'formulations']))
    parser.add_argument('--document', type=Path, default=ROOT / 'doc' / 'accuracy.md')
    options = parser.parse_args(arguments)
    pictures = options.document.parent / 'pictures'
    pictures.mkdir(exist_ok=True)
    text = options.document.read_text()
    parts = passages(pictures, options.quick, options.only)
    options.document.write_text(filled(text, parts))
    return 0


if __name__ == '__main__':
    sys.exit(main())
