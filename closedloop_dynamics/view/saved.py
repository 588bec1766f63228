# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A motion that is simulated to be saved in a page."""

import math

from .columns import SimulationRows
from ..recording.run import Report, run


def simulated(simulation, duration, rate, torque, progress=lambda time: None):
    """
    Simulate from time zero under constant torques, by actuated joint [N m or N]; all rows of it.

    ``duration`` is in s, ``rate`` in Hz: there is a row at every multiple of its inverse, whose
    time ``progress`` is called with. Returns Columns, times [s] and rows, both lists. Raises
    SimulationError.

    """
    shown = SimulationRows(simulation)
    times, rows = [], []
    looks = max(1, math.floor(0.25 * rate))

    def on_row(values):
        if len(times) % looks == 0:
            shown.look()
        times.append(values[0])
        rows.append(shown.row())
        progress(values[0])

    run(simulation, duration, rate, torque, report=Report(), on_row=on_row)
    return shown.columns, times, rows
