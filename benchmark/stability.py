# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The stability atlas: every hard case with every method, as tables and as a picture.

Hard cases are singular configurations, redundant loops, extreme scales, contradictory input, stiff
scenes and long runs. Each cell is the worst figure of one case with one method, and what that
means: accurate, degraded but stable, refused with a reason, or unstable: silently wrong.
doc/stability_cases.md lists every case. Exit code 1 where the default method is unstable.
"""

import math
from pathlib import Path
import sys
import warnings

from closedloop_dynamics.mechanism.errors import InaccuracyWarning
from closedloop_dynamics.scene.records import Method
from closedloop_dynamics.visual.appearance import DOTS_PER_INCH
from closedloop_dynamics.visual.progress import parts_bar
from closedloop_dynamics.visual.tables import markdown_table, text_table, write_csv
from hard_cases import ACCURATE, CASES, DEGRADED, judge, Outcome, REFUSED, SKIPPED, UNSTABLE
from machine import parser_of
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

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
    Run cases, the rows of the atlas, with methods, its columns, by name; return the outcomes.

    The outcomes are by the names of case and method. ``quick``: fewer trials and shorter runs for
    the default method, too; the others always have those. ``progress`` is called with the
    numbers of cells done and of all.
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
    """Return the cell of a table for an outcome."""
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


def unstable(atlas):
    """Return the names of the cases that the default method fails silently."""
    return [case for (case, name), outcome in atlas.items()
            if name == DEFAULT and outcome.status == UNSTABLE]


# Told apart by colour-blind readers, and by the words in the cells.
OUTCOME_COLORS = {ACCURATE: '#8fd0b5', DEGRADED: '#f3dc82', REFUSED: '#b9c4d4',
                  UNSTABLE: '#d9613c', SKIPPED: '#f4f4f4'}


def stability_atlas(atlas, cases=CASES, methods=METHODS):
    """Draw the atlas."""
    figure = Figure(figsize=(0.82 * len(methods) + 2.6, 0.26 * len(cases) + 2.2),
                    dpi=DOTS_PER_INCH, layout='constrained')
    axes = figure.subplots()
    names = list(methods)
    heights, height, groups = {}, 0.0, {}
    for case in cases:
        if case.group not in groups:
            height += 0.35
            groups[case.group] = height
            height += 0.65
        heights[case.name] = height
        for column, name in enumerate(names):
            _cell(axes, column, height, atlas[case.name, name])
        height += 1.0
    for group, place in groups.items():
        axes.text(-0.5, place - 0.05, group, fontweight='bold', fontsize=9, va='center',
                  ha='left')
    axes.set_xlim(-0.52, len(names) - 0.48)
    axes.set_ylim(height - 0.45, -0.2)
    axes.set_xticks(range(len(names)), [name.replace(' ', '\n') for name in names], fontsize=9)
    axes.xaxis.tick_top()
    axes.set_yticks([heights[case.name] for case in cases], [case.name for case in cases],
                    fontsize=9)
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    figure.suptitle('Stability atlas: the worst figure of each hard case (criteria: '
                    'doc/stability_cases.md)', fontsize=11)
    figure.legend(handles=[Patch(facecolor=color, label=status)
                           for status, color in OUTCOME_COLORS.items()],
                  loc='outside lower center', ncols=len(OUTCOME_COLORS), frameon=False, fontsize=9)
    return figure


def _cell(axes, column, row, outcome):
    """Draw one cell: a coloured box with the figure in it."""
    axes.add_patch(Rectangle((column - 0.48, row - 0.45), 0.96, 0.9, linewidth=0,
                             facecolor=OUTCOME_COLORS[outcome.status]))
    text = {REFUSED: 'refused', SKIPPED: '-'}.get(outcome.status, f'{outcome.figure:.1e}')
    axes.text(column, row, text, ha='center', va='center', fontsize=8,
              color='white' if outcome.status == UNSTABLE else 'black')


def main(arguments=None):
    """Run the hard cases; return the exit code."""
    parser = parser_of(__doc__, 'fewer trials and shorter runs of the default method, too')
    parser.add_argument('--output', type=Path, metavar='DIR',
                        help='where to write stability.csv, stability_table.md and '
                             'stability_atlas.png (default: only print)')
    parser.add_argument('--case', action='append', metavar='NAME', default=[],
                        help='only the cases whose name contains this; may be repeated')
    parser.add_argument('--default-only', action='store_true',
                        help='only the default method, and RODAS4 for stiff scenes')
    options = parser.parse_args(arguments)
    cases = [case for case in CASES
             if not options.case or any(word in case.name for word in options.case)]
    if not cases:
        parser.error(f'--case: expected a part of one of: {", ".join(one.name for one in CASES)}')
    methods = {name: METHODS[name] for name in (DEFAULT, 'rodas4')
               } if options.default_only else METHODS
    # The table has the error of each method.
    warnings.simplefilter('ignore', InaccuracyWarning)
    with parts_bar('cells', 'stability') as progress:
        atlas = study_stability(options.quick, cases, methods, progress)
    print(table(atlas, cases, methods))
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        write_files(atlas, options.output, cases, methods)
        stability_atlas(atlas, cases, methods).savefig(options.output / 'stability_atlas.png')
    failed = unstable(atlas)
    if failed:
        print(f'\nunstable with the default method: {", ".join(failed)}')
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
