# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Output of a study of the formulations: a table, a CSV file, the picture."""

import math

from formulations import exponent, FAMILIES, LONGEST, SCENES, UNROLLED
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
import numpy as np

from closedloop_dynamics.visual.appearance import DOTS_PER_INCH  # noqa: I100
from closedloop_dynamics.visual.tables import (
    markdown_table, seconds, short, text_table, write_csv)

HEADER = ('mechanism', 'size', 'joints', 'equations', 'formulation', 'time', 'accelerations',
          'forces')
CSV_HEADER = ('mechanism', 'size', 'joints', 'equations', 'formulation', 'time',
              'acceleration_error', 'force_error')
# Okabe and Ito's palette; markers distinguish the lines without it.
STYLES = {'subsystem': ('#0072B2', 'o', '-'), 'system': ('#D55E00', 's', '--'),
          'augmented': ('#009E73', 'D', ':'), UNROLLED: ('#56B4E9', '^', '-')}
# Scenes with upright names below a picture.
MOST_UPRIGHT = 8
HEADINGS = {'ladder': 'N four-bar loops side by side', 'chain': 'N links hung up at both ends'}
SIZE_LABELS = {'ladder': 'loops N', 'chain': 'links N'}


def table(rows, markdown=False):
    """Return the rows of a study as a table."""
    make = markdown_table if markdown else text_table
    return make(HEADER, [_cells(row) for row in rows])


def growth_text(rows):
    """Return the fitted exponents, one line for each family and formulation."""
    lines = []
    for family in FAMILIES:
        for name in dict.fromkeys(row.formulation for row in rows):
            chosen = [row for row in rows if (row.family, row.formulation) == (family, name)]
            power = exponent(chosen)
            if not math.isnan(power):
                lines.append(f'{family}, {name}: time ~ N^{power:.2f} over the largest tenfold')
    return '\n'.join(lines)


def write(rows, csv_path, picture_path):
    """Write the rows of a study and its picture; both files are replaced if they exist."""
    picture = growth if any(row.family in FAMILIES for row in rows) else comparison
    write_csv(csv_path, CSV_HEADER, [
        (row.family, row.size, row.joints, row.equations, row.formulation, row.time,
         row.acceleration_error, row.force_error) for row in rows])
    picture(rows).savefig(picture_path)


def _cells(row):
    made = seconds(row.time) if not math.isnan(row.time) else (
        row.failure.split('. ')[0] or 'not made: too long')
    return (row.family, str(row.size), str(row.joints), str(row.equations), row.formulation, made,
            short(row.acceleration_error), short(row.force_error))


def growth(rows):
    """Draw a study of the formulations."""
    figure = Figure(figsize=(11.0, 7.2), dpi=DOTS_PER_INCH, layout='constrained')
    figure.suptitle('One evaluation of the accelerations and constraint forces: what it costs, '
                    'how many digits it keeps', fontsize=12)
    panels = figure.subplots(2, 3, sharex='col', sharey='row', width_ratios=(1.0, 1.0, 0.55))
    for column, family in enumerate(FAMILIES):
        chosen = [row for row in rows if row.family == family]
        _line_panels(panels[:, column], chosen)
        panels[0, column].set_title(HEADINGS[family], fontsize=10)
        panels[1, column].set_xlabel(SIZE_LABELS[family])
    _scene_panels(panels[:, 2], [row for row in rows if row.family in SCENES], SCENES)
    panels[0, 0].set_ylabel('CPU time of one evaluation')
    panels[1, 0].set_ylabel('largest relative rounding error')
    for axes in panels.flat:
        axes.grid(which='major', color='#dddddd', linewidth=0.7)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=8)
        axes.yaxis.set_minor_formatter(NullFormatter())
    panels[0, 0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: seconds(value)))
    for axes in panels[:, 0]:
        axes.yaxis.set_major_locator(LogLocator(numticks=12))
    handles, labels = panels[0, 2].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=4, frameon=False, fontsize=9)
    return figure


def comparison(rows):
    """Draw the formulations on scenes."""
    names = list(dict.fromkeys(row.family for row in rows))
    figure = Figure(figsize=(max(5.0, 1.5 + 0.9 * len(names)), 6.5), dpi=DOTS_PER_INCH,
                    layout='constrained')
    figure.suptitle('One evaluation of the accelerations and constraint forces', fontsize=12)
    panels = figure.subplots(2, 1, sharex=True)
    _scene_panels(panels, rows, names)
    for axes in panels:
        axes.set_yscale('log')
        axes.grid(which='major', color='#dddddd', linewidth=0.7)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=8)
        axes.yaxis.set_minor_formatter(NullFormatter())
    panels[0].set_title('')
    panels[0].autoscale(axis='y')
    panels[0].set_ylabel('CPU time')
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: seconds(value)))
    panels[1].set_ylabel('largest relative difference\nfrom the median of all')
    panels[1].tick_params(axis='x', rotation=90 if len(names) > MOST_UPRIGHT else 0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=3, frameon=False, fontsize=9)
    return figure


def _line_panels(panels, rows):
    """Draw time above, error below, one line per formulation with its exponent."""
    time_axes, error_axes = panels
    for axes in panels:
        axes.set_xscale('log')
        axes.set_yscale('log')
    growth_lines = []
    for name, (color, marker, dashes) in STYLES.items():
        chosen = [row for row in rows if row.formulation == name and not math.isnan(row.time)]
        if not chosen:
            continue
        style = {'color': color, 'marker': marker, 'linestyle': dashes, 'markersize': 4.5,
                 'linewidth': 1.5}
        sizes = [row.size for row in chosen]
        time_axes.plot(sizes, [row.time for row in chosen], **style)
        error_axes.plot(sizes, [_error(row) for row in chosen], **style)
        power = exponent(chosen)
        if not math.isnan(power):
            growth_lines.append((f'{_label(name)}: N$^{{{power:.1f}}}$', color))
    for number, (text, color) in enumerate(growth_lines):
        # Below the lines, which rise to the right.
        time_axes.annotate(text, (0.98, 0.03 + 0.06 * number), xycoords='axes fraction',
                           fontsize=8, color=color, ha='right')
    if rows and max(row.size for row in rows) > 200:
        time_axes.axhline(LONGEST, color='#999999', linewidth=0.8, linestyle=(0, (1, 2)))
        time_axes.annotate('the dense ones end here', (0.03, LONGEST), xytext=(0, -2), va='top',
                           xycoords=('axes fraction', 'data'), textcoords='offset points',
                           fontsize=8, color='#666666')


def _scene_panels(panels, rows, names):
    """Draw the same for the mechanisms of the scenes, as points."""
    panels[0].set_title('shipped mechanisms', fontsize=10)
    panels[0].set_ylim(2e-8, 3.0 * LONGEST)
    for number, (name, (color, marker, _)) in enumerate(STYLES.items()):
        chosen = [row for row in rows if row.formulation == name and not math.isnan(row.time)]
        if not chosen:
            continue
        places = [names.index(row.family) + 0.2 * (number - 1.5) for row in chosen]
        style = {'color': color, 'marker': marker, 'linestyle': '', 'markersize': 6}
        panels[0].plot(places, [row.time for row in chosen], label=_label(name), **style)
        panels[1].plot(places, [_error(row) for row in chosen], **style)
    panels[1].set_xticks(range(len(names)), [
        name if len(names) > MOST_UPRIGHT else name.replace('_', '\n') for name in names])
    panels[1].set_xlim(-0.6, len(names) - 0.4)


def _label(name):
    return 'subsystem level, unrolled' if name == UNROLLED else f'{name} level'


def _error(row):
    return np.nanmax([row.acceleration_error, row.force_error, 1e-17])
