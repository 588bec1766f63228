# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""A motion that is simulated to be saved in a page."""

import math

from .columns import SimulationRows
from ..recording.run import Report, run


def simulated(simulation, duration, rate, torque, progress=lambda time: None):
    """
    Simulate under constant torques, with a row at every multiple of ``1 / rate``.

    Parameters
    ----------
    simulation : simulation.simulation.Simulation
        At time zero.
    duration, rate : float
        [s], [Hz].
    torque : mapping
        By actuated joint [N m or N].
    progress : callable
        Told the time of every row [s].

    Returns
    -------
    columns : columns.Columns
    times : list of float
        [s].
    rows : list of ndarray

    Raises
    ------
    SimulationError

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
