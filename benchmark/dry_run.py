# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What ``closedloop simulate --dry-run`` expects, against what the same run takes.

Every shipped scene is probed and run in turn, at its accuracy and at a thousandth of it. CPU time
of this process, the run that gives the error and the rows left out.
"""

import argparse
from dataclasses import replace
import sys
import warnings

from machine import ROOT

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.recording.cost import probe  # noqa: E402,I100
from closedloop_dynamics.recording.run import Report, run  # noqa: E402
from closedloop_dynamics.simulation.errors import InaccuracyWarning, SimulationError  # noqa: E402
from closedloop_dynamics.simulation.scene import scene_names  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.visual.tables import short, text_table  # noqa: E402

# Within which a prediction is right.
FACTOR = 1.5
HEADER = ('scene', 'method', 'probed [s]', 'expected [s]', 'taken [s]', 'expected / taken')


def measured(name, duration, rate, longest):
    """Return the rows of a scene: what was expected and taken."""
    simulation = Simulation.from_scene(name)
    rows = []
    for cost in probe(simulation, duration, rate, longest=longest):
        if cost.failure:
            rows.append((name, cost.setting, cost.probed, cost.failure, '', float('nan')))
            continue
        report = Report()
        try:
            run(Simulation(replace(simulation.scene, method=replace(
                simulation.scene.method, **{cost.key: cost.value}))),
                duration, rate, report=report, on_row=lambda row: None)
        except SimulationError as error:
            rows.append((name, cost.setting, cost.probed, cost.cpu_time, str(error), float('nan')))
            continue
        rows.append((name, cost.setting, cost.probed, cost.cpu_time, report.cpu_time,
                     cost.cpu_time / report.cpu_time))
    return rows


def main(arguments=None):
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='*', help='names of shipped scenes (default: all)')
    parser.add_argument('--duration', type=float, default=10.0, metavar='SECONDS')
    parser.add_argument('--rate', type=float, default=100.0, metavar='HZ')
    parser.add_argument('--longest', type=float, metavar='SECONDS',
                        help='CPU time of a probe (default: as the command takes)')
    parser.add_argument('--quick', action='store_true', help='a second of two scenes')
    options = parser.parse_args(arguments)
    names = options.scenes or sorted(scene_names())[:2 if options.quick else None]
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', InaccuracyWarning)
        for name in names:
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
