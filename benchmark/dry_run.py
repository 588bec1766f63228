# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What ``closedloop simulate --dry-run`` expects, against what the same run takes.

Every shipped scene is probed and run in turn, at its accuracy and at a thousandth of it. CPU time
of this process, the run that gives the error and the rows left out.
"""

from dataclasses import replace
import math
import sys
import warnings

from closedloop_dynamics.mechanism.errors import InaccuracyWarning, SimulationError
from closedloop_dynamics.recording.cost import probe
from closedloop_dynamics.recording.run import Report, run
from closedloop_dynamics.scene.loading import scene_names
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import short, text_table
from machine import parser_of

# Within which a prediction is right.
FACTOR = 1.5
HEADER = ('scene', 'method', 'probed [s]', 'expected [s]', 'taken [s]', 'expected / taken')


def measured(name, duration, rate, longest):
    """Return the rows of a scene: what was expected and taken."""
    simulation, rows = Simulation.from_scene(name), []
    for cost in probe(simulation, duration, rate, longest=longest):
        report, taken, ratio = Report(), '', math.nan
        try:
            if not cost.failure:
                run(Simulation(replace(simulation.scene, method=replace(
                    simulation.scene.method, **{cost.key: cost.value}))),
                    duration, rate, report=report, on_row=lambda row: None)
                taken, ratio = report.cpu_time, cost.cpu_time / report.cpu_time
        except SimulationError as error:
            taken = str(error)
        rows.append((name, cost.setting, cost.probed, cost.failure or cost.cpu_time, taken, ratio))
    return rows


def main(arguments=None):
    """Measure and print."""
    parser = parser_of(__doc__, 'a second of two scenes', scenes=sorted(scene_names()))
    parser.add_argument('--duration', type=float, default=10.0, metavar='SECONDS')
    parser.add_argument('--rate', type=float, default=100.0, metavar='HZ')
    parser.add_argument('--longest', type=float, metavar='SECONDS',
                        help='CPU time of a probe (default: as the command takes)')
    options = parser.parse_args(arguments)
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', InaccuracyWarning)
        for name in options.scenes[:2 if options.quick else None]:
            rows += measured(name, 1.0 if options.quick else options.duration,
                             options.rate, options.longest)
    print(text_table(HEADER, [
        tuple(cell if isinstance(cell, str) else short(cell) for cell in row) for row in rows]))
    ratios = [row[-1] for row in rows if row[-1] == row[-1]]
    right = sum(1.0 / FACTOR <= ratio <= FACTOR for ratio in ratios)
    print(f'{right} of {len(ratios)} within a factor of {FACTOR:g}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
