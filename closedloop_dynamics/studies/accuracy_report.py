# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Output of an accuracy study: a table, a CSV file, the diagram, a title."""

import math

from .accuracy import DEFAULT_INTEGRATOR, DEFAULT_STABILISATION
from ..mechanism.extras import of_an_extra
from ..visual.appearance import COLORS, DOTS_PER_INCH
from ..visual.tables import markdown_table, seconds, short, text_table, write_csv

HEADER = ('integrator', 'stabilisation', 'step or tol.', 'positions', 'velocities', 'forces',
          'closure', 'energy [J]', 'evaluations/s', 'CPU time/s')
CSV_HEADER = (
    'integrator', 'stabilisation', 'step_size', 'tolerance', 'position_error', 'velocity_error',
    'force_error', 'closure', 'energy_error', 'evaluations_per_second',
    'cpu_time_per_second', 'failure')
# Markers and dashes distinguish the lines without any colour.
LINE_COLORS = (*COLORS, '#E69F00')
MARKERS = 'osD^vP*X<>'
REAL_TIME = 1.0
# Error of positions that counts as zero [rad or m].
SMALLEST = 1e-16
_UNITS = ((1.0, 's'), (1e-3, 'ms'), (1e-6, 'µs'))


def title(study):
    """Return the subject of the study, on one line."""
    driven = ', '.join(f'{joint} = {value:g}' for joint, value in study.torque.items() if value)
    return f'{study.scene.name}, {study.duration:g} s, ' + (
        f'driven by {driven} N m or N' if driven else 'without torques')


def table(study, rows=None, markdown=False):
    """
    Return the rows of a study as a table.

    ``rows``: list of Row, optional; some of its rows; all of them when not given.
    """
    make = markdown_table if markdown else text_table
    return make(HEADER, [_cells(row) for row in (study.rows if rows is None else rows)])


def _cells(row):
    line = row.line
    value = f'{row.setting.value:g}' + ('' if line.adaptive else ' s')
    start = (line.integrator, line.stabilisation, value)
    if row.failure:
        # The first sentence names the event; the last column may be wide.
        return (*start, *[''] * 6, row.failure.split('; ')[0].split('. ')[0])
    return (*start, short(row.position_error), short(row.velocity_error),
            short(row.force_error), short(row.closure), short(row.energy_error),
            f'{row.evaluations:.0f}', seconds(row.cost))


def write(study, csv_path, picture_path):
    """Write the rows of a study and its diagram; both files are replaced if they exist."""
    write_csv(csv_path, CSV_HEADER, [_csv_row(row) for row in study.rows])
    work_precision(study, title(study)).savefig(picture_path)


def _csv_row(row):
    line, nothing = row.line, math.nan
    return (line.integrator, line.stabilisation,
            nothing if line.adaptive else row.setting.value,
            row.setting.value if line.adaptive else nothing, row.position_error,
            row.velocity_error, row.force_error, row.closure, row.energy_error, row.evaluations,
            row.cost, row.failure)


def work_precision(study, title):
    """Draw a study: integrators and stabilisations side by side."""
    with of_an_extra():
        from matplotlib.figure import Figure
    figure = Figure(figsize=(12.0, 6.2), dpi=DOTS_PER_INCH, layout='constrained')
    figure.suptitle(title, fontsize=12)
    groups = [group for group in _groups(study) if group[1]]
    panels = figure.subplots(
        1, len(groups), sharex=True, sharey=True, squeeze=False,
        width_ratios=[1.7 if number == 0 and len(groups) > 1 else 1.0
                      for number in range(len(groups))])[0]
    for axes, (heading, lines) in zip(panels, groups):
        _panel(axes, heading, lines, study)
    panels[0].set_ylabel('largest error of positions [rad or m]')
    panels[0].set_xlabel('CPU time for one simulated second (lower left is better)')
    for axes in panels[1:]:
        axes.set_xlabel('CPU time for one simulated second')
    return figure


def _groups(study):
    """Return (heading, {label: rows}) of each panel: one thing varied at a time."""
    lines = study.lines()
    panels = (
        (f'Integrators (with {DEFAULT_STABILISATION})', 'integrator',
         lambda line: line.stabilisation == DEFAULT_STABILISATION),
        (f'Keeping the loops closed ({DEFAULT_INTEGRATOR})', 'stabilisation',
         lambda line: line.integrator == DEFAULT_INTEGRATOR))
    for number, (heading, name, belongs) in enumerate(panels):
        chosen = {getattr(line, name): rows for line, rows in lines.items() if belongs(line)}
        # A single line says nothing that the first panel does not.
        yield heading, chosen if number == 0 or len(chosen) > 1 else {}


def _panel(axes, heading, lines, study):
    with of_an_extra():
        from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
    axes.set_title(heading, fontsize=10)
    axes.set_xscale('log')
    axes.set_yscale('log')
    # Where nothing moves, the reference is exact.
    floor = max(study.reference.error.position, SMALLEST)
    refused = []
    for number, (label, rows) in enumerate(lines.items()):
        rows = [row for row in rows if not row.failure]
        if not rows:
            refused.append(label)
            continue
        style = {'color': LINE_COLORS[number % len(LINE_COLORS)]}
        if number >= len(LINE_COLORS):
            # In grey, so that no two lines share a color.
            style = {'color': '#666666', 'linestyle': ('--', '-.', ':')[number % 3]}
        axes.plot([row.cost for row in rows], [max(row.position_error, 0.3 * floor)
                                               for row in rows],
                  marker=MARKERS[number % len(MARKERS)],
                  markersize=4.5, linewidth=1.4, label=label, **style)
    axes.axvline(REAL_TIME, color='#B2182B', linewidth=1.2)
    axes.annotate('real time', (REAL_TIME, 1.0), xycoords=('data', 'axes fraction'),
                  xytext=(-3, -4), textcoords='offset points', rotation=90, ha='right',
                  va='top', fontsize=8, color='#B2182B')
    axes.axhspan(1e-30, floor, color='#999999', alpha=0.25, linewidth=0)
    axes.set_ylim(0.2 * floor, 10.0)
    axes.annotate("below the reference's own error", (0.02, floor),
                  xycoords=('axes fraction', 'data'), xytext=(0, -2),
                  textcoords='offset points', va='top', fontsize=7.5, color='#555555')
    costs = [row.cost for row in study.rows if not row.failure] or [REAL_TIME]
    axes.set_xlim(0.7 * min(costs), 2.0 * max(REAL_TIME, *costs))
    axes.xaxis.set_major_formatter(FuncFormatter(_time))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_locator(LogLocator(numticks=20))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=8)
    axes.grid(which='major', color='#dddddd', linewidth=0.7)
    axes.set_axisbelow(True)
    axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.11), fontsize=8, frameon=False,
                ncols=3 if len(lines) > 5 else 2, columnspacing=1.2, title_fontsize=8,
                title=f'no result: {", ".join(refused)}' if refused else None)


def _time(value, _):
    """Write a time in the unit that suits it."""
    for factor, unit in _UNITS:
        if value >= 0.999 * factor:
            break
    return f'{value / factor:g} {unit}'
