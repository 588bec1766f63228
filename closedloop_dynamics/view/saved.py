# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Motions that are saved in a page, or played by one: simulated for it, or recorded."""

import math

import numpy as np

from .columns import motion_columns, motion_rows, motion_thinning_values, SimulationRows
from .thinning import Thinning
from ..kinematics.modeling import extent
from ..recording.run import Report, run

# Rows of a recording that are made at once; factor of successive tolerances, where there are too
# many rows.
BLOCK, COARSER = 10_000, 4.0


def simulated(simulation, duration, rate, torque, progress=lambda time: None):
    """
    Simulate from time zero under constant torques, by actuated joint [N m or N]; all rows of it.

    ``duration`` is in s, ``rate`` in Hz: there is a row at every multiple of its inverse, whose
    time ``progress`` is called with, and where straight lines between these would miss a state.
    Returns Columns, times [s] and rows, both lists. Raises SimulationError.
    """
    points = len(simulation.mechanism.points)
    shown = SimulationRows(simulation, points=points)
    thinning = Thinning(shown.columns.plots, points, extent(simulation.mechanism))
    times, rows, before = [], [], []
    every = max(1, math.floor(0.25 * rate))
    count = 0

    def on_step():
        row = shown.row()
        if thinning.misses(simulation.time, shown.thinning_values(row)):
            times.append(before[0])
            rows.append(before[1])
        before[:] = simulation.time, row

    def on_row(values):
        nonlocal count
        if count % every == 0:
            shown.refresh()
        count += 1
        times.append(values[0])
        rows.append(shown.row())
        thinning.keep(values[0], shown.thinning_values(rows[-1]))
        progress(values[0])

    run(simulation, duration, rate, torque, report=Report(), on_row=on_row, on_step=on_step)
    return shown.columns, times, rows


def recorded(motion, most):
    """
    Return times [s] and rows of a ``Trajectory``: all, or about ``most`` of more than these.

    Of more, those are left out that straight lines between the others do not miss.
    """
    if len(motion.time) <= most:
        return motion.time, motion_rows(motion)
    every, coarse = math.ceil(2 * len(motion.time) / most), 1.0
    while True:
        times, rows = _thinned(motion, every, coarse)
        if len(times) <= most:
            return times, rows
        coarse *= COARSER


def _thinned(motion, every, coarse):
    """Return times and rows: every n-th, and those that lines between these would miss."""
    mechanism = motion.mechanism
    columns = motion_columns(mechanism)
    thinning = Thinning(columns.plots, len(mechanism.points), extent(mechanism), coarse)
    times, kept, before = [], [], None
    for first in range(0, len(motion.time), BLOCK):
        part = motion.part(slice(first, first + BLOCK))
        rows = motion_rows(part)
        for k, values in enumerate(motion_thinning_values(columns, part, rows)):
            time = float(part.time[k])
            if thinning.misses(time, values):
                times.append(before[0])
                kept.append(before[1])
            before = time, rows[k].copy()
            if (first + k) % every == 0 or first + k == len(motion.time) - 1:
                times.append(time)
                kept.append(before[1])
                thinning.keep(time, values)
    return np.array(times), np.array(kept)
