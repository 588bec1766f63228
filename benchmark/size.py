# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Cost and memory as mechanisms grow to ten thousand joints: ladders, stars, chains.

Measures, per joint: the time of an evaluation inside compiled code, the memory of model
and workspace, the time to set a mechanism up. All sizes are timed in turn, one thread, CPU time.

Timed are the kernels alone, by loops, one evaluation waiting for the one before; small mechanisms
have unrolled kernels.
"""

from functools import partial
import statistics
import sys
import time

from closedloop_dynamics.engine.types import RANK
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.mechanism.decomposition import decompose
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.simulation.system import build_system
from closedloop_dynamics.visual.tables import markdown_table, seconds, text_table
from evaluations import evaluate_again
from families import chain, ladder, star
from machine import description, in_turn, parser_of, write_result
from matplotlib.figure import Figure
import numpy as np

# Label: words, builder, its sizes for 10 to 10,000 joints, colour and marker.
FAMILIES = {
    'ladder': ('ladder of N four-bars', ladder,
               (5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000), '#0072B2', 'o'),
    'star of four': ('star: four ladders meet at one crank', lambda loops: star(loops, 4),
                     (2, 3, 6, 12, 25, 60, 125, 250, 625, 1250), '#D55E00', 's'),
    'star of eight': ('star: eight ladders meet at one crank', star,
                      (1, 2, 3, 6, 12, 30, 60, 125, 312, 625), '#CC79A7', '^'),
    'chain': ('chain of N links hung up at both ends', chain,
              (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000), '#009E73', 'D'),
}
QUICK_LARGEST = 300
# Timing: evaluations that take so long together [s], in so many turns.
PORTION, TURNS, QUICK_TURNS = 2e-3, 150, 3
FROM = 10


def build(family, size):
    """
    Set a member of a family up, moving and driven; ``size`` as its builder counts.

    Returns a row (joints, equations, fill, bytes, set-up time [s]), and a function that evaluates
    it so many times.
    """
    _, builder, *_ = FAMILIES[family]
    mechanism, position = builder(size)
    begin = time.process_time()
    mechanism = validate_mechanism(mechanism)
    decomposition = decompose(mechanism)
    model = build_model(mechanism, decomposition=decomposition)
    # Small mechanisms have unrolled kernels, three times as fast; here all take the same loops.
    system = build_system(model, unrolled=False)
    setup = time.process_time() - begin
    joints = len(mechanism.joints)
    # Cranks turn alike, couplers do not turn at all: the rates close the loops.
    state = np.zeros((2, joints))
    state[0] = position
    if family != 'chain':
        state[1] = [1.0 if joint.name.startswith('pivot') else -1.0
                    for joint in mechanism.joints]
    system.tau[:] = np.random.default_rng(1).uniform(-1.0, 1.0, joints)
    evaluate_again(system, *state, 1)
    held = [value for record in (model, system.work) for value in vars(record).values()
            if isinstance(value, np.ndarray)]
    row = {'family': family, 'size': size, 'joints': joints,
           'equations': mechanism.number_of_equations, 'fill': decomposition.fill,
           'entries': len(model.row), 'setup': setup,
           'bytes': sum(part.nbytes for part in held),
           'full rank': bool(system.work.health[RANK] == mechanism.number_of_equations)}
    return row, partial(evaluate_again, system, *state)


def measure(quick=False):
    """Measure all families; ``quick``: small ones alone, and rough numbers."""
    rows, tasks = [], {}
    for family, (_, _, sizes, *_) in FAMILIES.items():
        for size in sizes:
            if not (quick and size > QUICK_LARGEST):
                row, run = build(family, size)
                (first,), = in_turn({size: partial(run, 3)}, 1, time.thread_time).values()
                row['count'] = max(1, round(PORTION / max(first / 3.0, 1e-7)))
                tasks[len(rows)] = partial(run, row['count'])
                rows.append(row)
    times = in_turn(tasks, QUICK_TURNS if quick else TURNS, time.thread_time)
    for number, row in enumerate(rows):
        row.update(best=min(times[number]) / row['count'],
                   median=statistics.median(times[number]) / row['count'])
    return {'machine': description(), 'quick': quick, 'rows': rows}


def growth(result):
    """Return, for each family, between what limits the time per joint stays from ten joints on."""
    lines = []
    for family, (words, *_) in FAMILIES.items():
        costs = [1e9 * row['best'] / row['joints'] for row in result['rows']
                 if row['family'] == family and row['joints'] >= FROM]
        if not costs:
            continue
        least, most = min(costs), max(costs)
        middle = statistics.median(costs)
        lines.append(
            f'* {words}: {middle:.0f} ns per joint (the median of the sizes), '
            f'{100.0 * (1.0 - least / middle):.0f} % less to '
            f'{100.0 * (most / middle - 1.0):.0f} % more; the largest of all sizes is '
            f'{most / least:.2f} times the smallest.')
    return '\n'.join(lines)


def table(result, make=markdown_table):
    """Return the rows as a table."""
    return make(
        ('mechanism', 'joints', 'equations', 'blocks filled in', 'evaluation', 'per joint',
         'memory per joint', 'set-up', 'set-up per joint'),
        [(row['family'], str(row['joints']), str(row['equations']), str(row['fill']),
          seconds(row['best']), f'{1e9 * row["best"] / row["joints"]:.0f} ns',
          f'{row["bytes"] / row["joints"]:.0f} B', seconds(row['setup']),
          seconds(row['setup'] / row['joints'])) for row in result['rows']])


def picture(result):
    """Draw time and memory per joint over the number of joints."""
    figure = Figure(figsize=(9.6, 3.9), dpi=120, layout='constrained')
    time_axes, memory_axes = figure.subplots(1, 2)
    for family, (words, _, _, color, marker) in FAMILIES.items():
        rows = [row for row in result['rows'] if row['family'] == family]
        joints = [row['joints'] for row in rows]
        style = {'color': color, 'marker': marker, 'markersize': 4.5, 'linewidth': 1.4}
        time_axes.plot(joints, [1e9 * row['best'] / row['joints'] for row in rows],
                       label=words, **style)
        memory_axes.plot(joints, [row['bytes'] / row['joints'] for row in rows], **style)
    for axes, title in ((time_axes, 'CPU time of one evaluation, per joint [ns]'),
                        (memory_axes, 'model and workspace, per joint [bytes]')):
        axes.set_xscale('log')
        axes.set_ylim(0.0, None)
        axes.set_xlabel('joints')
        axes.set_title(title, fontsize=10)
        axes.grid(color='#dddddd', linewidth=0.7)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=8)
    figure.legend(loc='outside lower center', ncols=2, frameon=False, fontsize=8.5)
    return figure


def main(arguments=None):
    """Run the benchmark."""
    options = parser_of(
        __doc__, 'small ones alone, rough numbers', output=True).parse_args(arguments)
    result = measure(options.quick)
    write_result(options, 'size', result, table(result, text_table), growth(result))
    picture(result).savefig(options.output / 'size.png')
    return 0


if __name__ == '__main__':
    sys.exit(main())
