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

"""The stability atlas: every hard case with every method."""

import math

from .hard_cases import (
    ACCURATE, CASES, DEGRADED, judge, Outcome, REFUSED, SKIPPED, UNSTABLE)
from ..simulation.scene_records import Method
from ..visual.tables import markdown_table, text_table, write_csv

METHODS = {
    'auto (default)': Method(),
    'rk4': Method(integrator='rk4'),
    'rk4, independent': Method(integrator='rk4', stabilisation='independent'),
    'rk4, Baumgarte': Method(integrator='rk4', stabilisation='baumgarte'),
    'rk4, none': Method(integrator='rk4', stabilisation='none'),
    'Euler': Method(integrator='semi_implicit_euler'),
    'dopri5': Method(integrator='dopri5'),
    'dop853': Method(integrator='dop853'),
    'rodas4': Method(integrator='rodas4'),
}
DEFAULT = 'auto (default)'
MARKS = {ACCURATE: 'accurate', DEGRADED: 'degraded', REFUSED: 'refused', UNSTABLE: 'UNSTABLE',
         SKIPPED: 'not run'}
# RODAS4's cost grows with the cube of the size, beside flat positions with its fourth power.
TOO_SLOW = {('flat, 40 loops', 'rodas4'), ('1000 loops', 'rodas4')}


def study_stability(quick=False, cases=CASES, methods=METHODS, progress=lambda done, total: None):
    """
    Run the suite.

    Parameters
    ----------
    quick : bool
        Fewer trials and shorter runs for the default method, too; the others always have those.
    cases : sequence of Case
        Rows of the atlas.
    methods : dict of str to Method
        Columns of the atlas.
    progress : callable
        Told how many cells of how many are done.

    Returns
    -------
    dict of (str, str) to Outcome
        By the names of case and method.

    """
    atlas, total = {}, len(cases) * len(methods)
    for case in cases:
        for name, method in methods.items():
            if (case.name, name) in TOO_SLOW:
                outcome = Outcome(SKIPPED, math.nan, 'takes too long')
            else:
                outcome = judge(case, method, quick or name != DEFAULT)
            atlas[case.name, name] = outcome
            progress(len(atlas), total)
    return atlas


def cell(outcome):
    """Return what a table says of an outcome."""
    if outcome.status in (REFUSED, SKIPPED):
        return MARKS[outcome.status]
    return f'{MARKS[outcome.status]} {outcome.figure:.1e}'


def table(atlas, cases=CASES, methods=METHODS, write=text_table):
    """Return the atlas as text, one row a case."""
    return write(('case', 'full / short', *methods), [
        (case.name, case.lengths or 'the same',
         *(cell(atlas[case.name, name]) for name in methods)) for case in cases])


def write_files(atlas, directory, cases=CASES, methods=METHODS):
    """Write the atlas as stability.csv and stability.md."""
    write_csv(directory / 'stability.csv',
              ('group', 'case', 'method', 'outcome', 'figure', 'meaning', 'note'),
              [(case.group, case.name, name, atlas[case.name, name].status,
                atlas[case.name, name].figure, case.figure, atlas[case.name, name].note)
               for case in cases for name in methods])
    text = table(atlas, cases, methods, markdown_table)
    (directory / 'stability_table.md').write_text(text + '\n', encoding='utf-8')


def unstable(atlas, method=DEFAULT):
    """Return the names of the cases that a method fails silently."""
    return [case for (case, name), outcome in atlas.items()
            if name == method and outcome.status == UNSTABLE]
