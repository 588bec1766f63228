# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tables, CSV files and pictures of other simulators beside us."""

import datetime
import math

from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from peer_cases import SHIPPED

from closedloop_dynamics.visual.tables import markdown_table, seconds, write_csv  # noqa: I100

OURS = 'closedloop_dynamics'
# What marks lines that no simulator offers: loops written for this comparison.
OWN_LOOP = 'in C++'
TARGETS = (1e-3, 1e-6, 1e-8)
# Load average of a machine that does little else.
QUIET = 0.7
# Okabe and Ito's palette, one colour an engine; markers and dashes tell its lines apart.
COLORS = {OURS: '#0072B2', 'Pinocchio': '#D55E00', 'MuJoCo': '#009E73', 'Exudyn': '#CC79A7'}
STYLES = (('o', '-'), ('s', '--'), ('D', ':'), ('^', '-.'), ('v', '-'), ('x', '--'), ('+', ':'))
# What the files of a group are called, and how their names end.
FILES = {'plane': 'peers', 'space': 'peers_space', 'generated': 'peers_generated',
         'families': 'peers_families'}
ENDS = ('_evaluation.csv', '_motions.csv', '.png')
EVALUATIONS = ('tree', 'engine', 'what', 'best', 'median')
MOTIONS = ('case', 'tree', 'engine', 'line', 'setting', 'error', 'closure', 'best', 'median')
BAND = '#e5e5e5'
DOTS_PER_INCH = 120


def file_names(result, group):
    """Return the names of a group's files: times of evaluations; motions where there are any."""
    return [f'{FILES[group]}{end}' for end in ENDS[:None if result['motions'] else 1]]


def write_files(result, directory, group):
    """Write what was measured of a group as CSV files and as a picture."""
    evaluations, *others = (directory / name for name in file_names(result, group))
    write_csv(evaluations, ('scene', *EVALUATIONS), [
        (scene, *(row[key] for key in EVALUATIONS))
        for scene, rows in result['evaluation'].items() for row in rows])
    if others:
        known = {case['name']: case['uncertainty'] for case in result['cases']}
        write_csv(others[0], (*MOTIONS, 'uncertainty'), [
            (*(row[key] for key in MOTIONS), known[row['case']]) for row in result['motions']])
        picture(result).savefig(others[1])


def measured(result):
    """Return when and where something was measured."""
    date = result.get('date') or datetime.date.today().isoformat()
    return f'Measured on {date}: {result["machine"]}.' + (
        ' Quick version: rough numbers.' if result['quick'] else '')


def passages(results):
    """Return {name of a passage: its text} on the groups of peers.py that were measured."""
    texts = {}
    for group, result in results.items():
        name = 'peers' if group == 'plane' else f'peers {group}'
        before, after = result['load']
        texts.update({
            f'{name} machine': f'{measured(result)}\nLoad average before and '
            f'after: {before:.1f} and {after:.1f}.' + (
                ' Other programs kept the machine busy: ratios say more than times.'
                if before > QUIET else ''),
            f'{name} agreement': agreement_table(result),
            f'{name} evaluation': evaluation_table(result)})
        if result['cases']:
            uncertain = max(case['uncertainty'] for case in result['cases'])
            texts[f'{name} motions'] = motion_table(result)
            texts[f'{name} reference'] = ('The two methods behind the reference differ by '
                                          f'{uncertain:.0e} rad or m at most.')
        texts.update((f'{name} {key.replace("_", " ")}', rollout_table(result[key]))
                     for key in ('rollouts', 'short_rollouts') if result[key])
    return texts


def _by_line(by_scene, keys, choose):
    """Return {line of a table: a row for each scene}; of rows of several trees the one chosen."""
    lines = {}
    for scene, rows in by_scene.items():
        for row in rows:
            found = lines.setdefault(tuple(row[key] for key in keys), {})
            found[scene] = choose(found.get(scene, row), row)
    return {line: [found.get(scene) for scene in by_scene] for line, found in lines.items()}


def agreement_table(result):
    """Return how far accelerations differ from ours; of several trees the largest difference."""
    lines = _by_line(result['agreement'], ('engine', 'version'),
                     lambda *rows: max(rows, key=lambda row: row['error']))
    rows = [(' '.join(line), *('-' if part is None else f'{part["error"]:.0e}' + (
        f' ({part["limit_name"]}: {part["limit"]:.0e})' if 'limit' in part else '')
        for part in parts)) for line, parts in lines.items()]
    return markdown_table(('simulator', *result['agreement']), rows)


def evaluation_table(result):
    """
    Return the times of an evaluation or step, and in brackets how many times ours.

    Of several trees the shortest time, and the name of a tree that is not the scene's own; of a
    simulator that is left out the reason.
    """
    why = [result['left out'].get(scene, {}) for scene in result['evaluation']]
    ours = [min(row['best'] for row in rows if row['engine'] == OURS)
            for rows in result['evaluation'].values()]
    lines = _by_line(result['evaluation'], ('engine', 'what'),
                     lambda *rows: min(rows, key=lambda row: row['best']))
    digits = 1 if result['motions'] else 2
    rows = [(*line, *(
        left_out.get(line[0], '-') if part is None else
        f'{seconds(part["best"])} ({part["best"] / time:.{digits}f}'
        f'{"" if part["tree"] == SHIPPED else ", " + part["tree"]})'
        for part, time, left_out in zip(parts, ours, why))) for line, parts in lines.items()]
    return markdown_table(('simulator', 'what', *result['evaluation']), rows)


def cheapest(rows, target, cost='best'):
    """Return the cheapest row within a target, None where there is none."""
    return min((row for row in rows if row['error'] <= target), key=lambda row: row[cost],
               default=None)


def motion_table(result):
    """Return, for each case and error, what each simulator's best way costs."""
    engines = list(dict.fromkeys(row['engine'] for row in result['motions']))
    rows = []
    for case in result['cases']:
        chosen = [row for row in result['motions'] if row['case'] == case['name']]
        others = [row for row in chosen if row['engine'] != OURS]
        plain = [row for row in others if OWN_LOOP not in row['line']]
        for target in TARGETS:
            if target < 10.0 * case['uncertainty']:
                continue
            best = {engine: cheapest([row for row in chosen if row['engine'] == engine], target)
                    for engine in engines}
            rows.append((case['name'], f'{target:.0e}',
                         *(_ratio(cheapest(some, target), best.get(OURS))
                           for some in (others, plain)),
                         *(seconds(one['best']) if one else 'not reached'
                           for one in best.values())))
    return markdown_table(('motion', 'error within', 'best of the others, times ours',
                           'without our loops in C++', *engines), rows)


def _ratio(other, ours):
    return f'{other["best"] / ours["best"]:.1f}' if other and ours else '-'


def rollout_table(rows):
    """Return how many steps per second rollouts make, and how exact they are."""
    fastest = max((speed for row in rows if OURS not in row['what']
                   for speed in row['speeds'].values()), default=math.nan)
    return markdown_table(('rollouts of', 'steps per second', "times the fastest of MuJoCo's",
                           'error at the end, median [rad, m]'), [
        (row['what'], f'{row["speeds"]["1"]:,.0f}', f'{row["speeds"]["1"] / fastest:.1f}',
         f'{row["error"]:.1e}') for row in rows])


def picture(result):
    """Draw error against cost of what peers.py measured, one panel a case."""
    cases = result['cases']
    columns = min(3, len(cases))
    lines = -(-len(cases) // columns)
    figure = Figure(figsize=(4.3 * columns, 3.9 * lines + 0.9), dpi=DOTS_PER_INCH,
                    layout='constrained')
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for axes, case in zip(panels.flat, cases):
        _panel(axes, case, [row for row in result['motions'] if row['case'] == case['name']])
    for axes in panels.flat[len(cases):]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel('CPU time for one simulated second')
    for axes in panels[:, 0]:
        axes.set_ylabel('error at the end [rad or m]')
    handles, _ = panels[0, 0].get_legend_handles_labels()
    handles.append(Patch(color=BAND, label="below the reference's own error"))
    figure.legend(handles=handles, loc='outside lower center', ncols=4 if columns > 2 else 2,
                  frameon=False, fontsize=8)
    return figure


def styled(axes, title):
    """Give a panel of costs its title, its scale and its grid."""
    axes.set_title(title, fontsize=10)
    axes.set_xscale('log')
    axes.tick_params(labelsize=8)
    axes.grid(color='#dddddd', linewidth=0.7)
    axes.set_axisbelow(True)


def _panel(axes, case, rows):
    styled(axes, case['name'])
    axes.set_yscale('log')
    for engine in dict.fromkeys(row['engine'] for row in rows):
        own = [row for row in rows if row['engine'] == engine]
        for line, (marker, dashes) in zip(dict.fromkeys(row['line'] for row in own), STYLES):
            chosen = _front([row for row in own if row['line'] == line])
            axes.plot([row['best'] for row in chosen], [row['error'] for row in chosen],
                      color=COLORS.get(engine, '#333333'), marker=marker, linestyle=dashes,
                      markersize=3.5, linewidth=1.3, label=f'{engine}: {line}')
    axes.axhspan(1e-30, max(case['uncertainty'], 1e-16), color=BAND, linewidth=0)
    axes.set_ylim(1e-13, 10.0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: seconds(value)))
    axes.yaxis.set_major_locator(LogLocator(numticks=16))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())


def _front(rows):
    """Return the rows that no other row beats in both error and cost, by cost."""
    front, least = [], math.inf
    for row in sorted(rows, key=lambda row: row['best']):
        if row['error'] < least:
            front.append(row)
            least = row['error']
    return front
