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

"""A simulation run to its end, with a row of numbers at even times: ``closedloop simulate``."""

from dataclasses import dataclass
import math
import time

from ..mechanism.mechanism import REVOLUTE

# Between two looks whether to go on; about 10 ms of computing.
LARGEST_PORTION = 1000
# Row times count as multiples of the step up to this share of it.
ROUNDING = 1e-9


@dataclass
class Report:
    """
    What a run did, up to date while it goes on.

    Attributes
    ----------
    rows : int
        Handed over so far.
    time : float
        Simulated time [s].
    cpu_time : float
        Spent on the simulated time alone, not on rows [s].
    largest_closure : float
        Largest closure error of positions at the rows' times [m or rad].
    first_energy, last_energy : float
        At the first and at the last row [J].
    finished : bool
        False while it goes on, and where it was ended early.

    """

    rows: int = 0
    time: float = 0.0
    cpu_time: float = 0.0
    largest_closure: float = 0.0
    first_energy: float = math.nan
    last_energy: float = math.nan
    finished: bool = False


def columns(simulation):
    """Return the names of the columns, in the order of ``row``."""
    joints = simulation.joint_names
    names = ['time']
    for quantity in ('position', 'velocity', 'acceleration', 'effort'):
        names += [f'{quantity}.{joint}' for joint in joints]
    for cut in simulation.cut_joints:
        names += [f'force.{cut.name}.{part}' for part in _force_parts(cut)]
    return [*names, 'closure', 'energy']


def row(simulation, seconds):
    """
    Return the present state as numbers.

    Parameters
    ----------
    simulation : Simulation
        Read, not advanced.
    seconds : float
        The time to write [s].

    Returns
    -------
    list of float

    """
    values = [seconds]
    for quantity in (simulation.position, simulation.velocity, simulation.acceleration,
                     simulation.effort):
        values += quantity.tolist()
    for cut, (moment, force_x, force_y) in zip(
            simulation.cut_joints, simulation.constraint_forces.tolist()):
        values += [force_x, force_y, moment][:len(_force_parts(cut))]
    return [*values, simulation.closure, simulation.energy]


def _force_parts(cut):
    """Return the components of a cut joint's wrench that can differ from zero."""
    return ('x', 'y') if cut.type == REVOLUTE else ('x', 'y', 'torque')


def run(simulation, duration, rate, torque=None, *, report, on_row, keep_going=lambda: True):
    """
    Advance a simulation under constant torques, with a row at every multiple of ``1 / rate``.

    The time between two rows is covered by whole steps; where it is no multiple of the step
    size, the last of them is shorter.

    Parameters
    ----------
    simulation : Simulation
        At time zero.
    duration : float
        [s].
    rate : float
        Rows per simulated second [Hz].
    torque : mapping, sequence or None
        As for ``Simulation.step``.
    report : Report
        Filled while the run goes on, so that it tells of a run that fails, too.
    on_row : callable
        Takes the numbers of ``row``.
    keep_going : callable
        Asked again and again; the run ends early where it returns False.

    Raises
    ------
    SimulationError, ValueError

    """
    tau = simulation.joint_torques(torque)
    simulation.advance(tau, 0)
    last = math.floor(duration * rate * (1.0 + 1e-12) + ROUNDING)
    for index in range(last + 1):
        if not _reached(index / rate, simulation, torque, report, keep_going):
            return
        on_row(_noted(row(simulation, index / rate), report))
    report.finished = _reached(duration, simulation, torque, report, keep_going)


def _noted(values, report):
    """Put what a row says into the report; return the row."""
    report.rows += 1
    *_, closure, report.last_energy = values
    report.largest_closure = max(report.largest_closure, closure)
    if report.rows == 1:
        report.first_energy = report.last_energy
    return values


def _reached(until, simulation, torque, report, keep_going):
    """Advance to a time; return False where the run is to end before."""
    tau, size = simulation.joint_torques(torque), simulation.step_size
    while keep_going():
        left = until - simulation.time
        steps = round(left / size)
        begin = time.process_time()
        try:
            if steps > LARGEST_PORTION:
                simulation.advance(tau, LARGEST_PORTION)
                continue
            # Counted steps: a difference of two large times would leave crumbs of a step.
            if abs(steps * size - left) <= ROUNDING * size + 4e-16 * until:
                simulation.advance(tau, steps)
            elif left > 0.0:
                simulation.step(torque, left)
            return True
        finally:
            report.cpu_time += time.process_time() - begin
            report.time = simulation.time
    return False
