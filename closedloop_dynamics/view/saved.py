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
    Simulate from time zero under constant torques, by actuated joint [N m or N]; all rows of it.

    ``duration`` is in s, ``rate`` in Hz: there is a row at every multiple of its inverse, whose
    time ``progress`` is told. Returns Columns, times [s] and rows, both lists. Raises
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
