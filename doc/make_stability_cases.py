# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Write ``doc/stability_cases.md`` and its picture: every hard case, its criteria and its results.

The cases are those of the code, the results those of ``doc/pictures/stability.csv``, which
``python benchmark/stability.py --output`` writes.
"""

import csv
from pathlib import Path
import sys

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'benchmark'))

from hard_cases import CASES, Outcome, SKIPPED  # noqa: E402
from stability import markdown_table, METHODS, stability_atlas, table  # noqa: E402

PAGE = Path(__file__).with_name('stability_cases.md')
RESULTS = PAGE.parent / 'pictures' / 'stability.csv'
HEAD = """\
# The hard cases and their results

Written by `python doc/make_stability_cases.py` from the cases in the code and the results of

    python benchmark/stability.py --output results   # a quarter of an hour; with --quick a minute

[stability.md](stability.md) says what the results mean for a user.

![The stability atlas: hard cases by methods, each cell with its worst figure](PICTURE)

Each cell is the worst figure of one case with one method. *Accurate* and *degraded* are judged by
the limits below, *refused* is an exception that says what happened and what to do, *unstable* is
silently wrong and must not occur with the default method. The default method runs each case in
full, the others its shorter form (second column; *the same* where there is one form only).
Semi-implicit Euler crosses singular configurations, and is compared with known answers, in steps a
tenth as long, because its own error would hide theirs. Cases marked *not run* everywhere are newer
than the results.

""".replace('PICTURE', 'pictures/stability_atlas.png')


def results():
    """Return {(case, method): Outcome} of the file, ``SKIPPED`` where it has none."""
    atlas = {(case.name, method): Outcome(SKIPPED, float('nan'))
             for case in CASES for method in METHODS}
    with open(RESULTS, newline='', encoding='utf-8') as file:
        for row in csv.DictReader(file):
            atlas[row['case'], row['method']] = Outcome(
                row['outcome'], float(row['figure'] or 'nan'), row['note'])
    return atlas


def criteria():
    """Return a table of the cases for each group: what is hard, the figure and its limits."""
    parts = []
    for group in dict.fromkeys(case.group for case in CASES):
        rows = [(case.name, case.text, case.figure, f'{case.accurate:g}', f'{case.stable:g}')
                for case in CASES if case.group == group]
        parts.append(f'### {group}\n\n' + markdown_table(
            ('case', 'what is hard, and what counts', 'figure', 'accurate up to',
             'stable up to'), rows))
    return '\n\n'.join(parts)


def page():
    """Return the text of the page."""
    return (f'{HEAD}## Results\n\n{table(results(), write=markdown_table)}\n\n'
            f'## Criteria\n\n{criteria()}\n')


if __name__ == '__main__':
    PAGE.write_text(page(), encoding='utf-8')
    stability_atlas(results()).savefig(RESULTS.with_name('stability_atlas.png'))
