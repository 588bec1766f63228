# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What a run will cost, told before it is made: from a probe, its first part."""

from dataclasses import dataclass, replace
import math
import time

from .run import ErrorEstimate, Report, run
from ..integration.registry import AUTO, FIXED, INTEGRATORS
from ..simulation.errors import SimulationError
from ..simulation.simulation import Simulation

# CPU time that a probe may take [s]; one that took less than the second is made once more, and the
# faster one counts: what runs for the first time is slower, and other programs disturb.
LONGEST, SHORT = 0.5, 0.2
# Of a second method that is told beside the first: its tolerance or accuracy, and its step size,
# against those of the first.
FINER, SHORTER = 1e-3, 0.5


@dataclass(frozen=True)
class Cost:
    """What a run is expected to cost."""

    key: str  # Of a scene's method: ``accuracy``, ``tolerance`` or ``step_size``
    value: float  # Its value
    duration: float  # Simulated time [s]
    # CPU time of the simulated time alone [s]; with rows and the second run that tells the error.
    cpu_time: float
    whole: float
    probed: float  # Simulated time that the probe covered [s]
    failure: str = ''  # Why the probe failed, whose costs are those up to there

    @property
    def share(self):
        """Return the CPU time per simulated time."""
        return self.cpu_time / self.duration

    def __str__(self):
        """Return the cost in words."""
        what = f'{self.key.replace("_", " ")} {self.value:g}'
        if self.failure:
            return f'at {what} the run fails at t = {self.probed:.3g} s: {self.failure}'
        return f'about {self.cpu_time:.2g} s of CPU for {self.duration:g} s at {what}'


def probe(simulation, duration, rate, torque=None, estimated=False):
    """
    Tell what a run will cost, and what a finer one would.

    Parameters
    ----------
    simulation : Simulation
        Of the run; it is left alone.
    duration : float
        Of the run [s].
    rate : float
        Rows, or calls, per simulated second [Hz].
    torque : mapping, sequence or None
        As for ``Simulation.step``.
    estimated : bool
        Whether a second, finer run beside the first tells its error.

    Returns
    -------
    list of Cost
        With the method of the run, and with one of a smaller accuracy, tolerance or step size.

    Notes
    -----
    The run is made for up to ``LONGEST`` of CPU time. Where it is not at its end by then, the rest
    is expected to cost what the later half of the probe did.

    """
    method = simulation.scene.method
    fixed = INTEGRATORS[method.integrator].kind == FIXED
    key = 'step_size' if fixed else 'accuracy' if method.integrator == AUTO else 'tolerance'
    found = []
    for factor in (1.0, SHORTER if fixed else FINER):
        value = factor * getattr(method, key)
        try:
            other = Simulation(replace(
                simulation.scene, method=replace(method, **{key: value})))
        except (SimulationError, ValueError) as error:
            found.append(Cost(key, value, duration, math.nan, math.nan, 0.0, str(error)))
            continue
        found.append(_probed(other, key, value, duration, rate, torque, estimated))
        if found[-1].probed == duration and found[-1].whole < SHORT:
            other.reset()
            again = _probed(other, key, value, duration, rate, torque, estimated)
            found[-1] = min(found[-1], again, key=lambda one: one.cpu_time)
    return found


def _probed(simulation, key, value, duration, rate, torque, estimated):
    """Return the cost of a run of a simulation from its start."""
    report, failure, marks = Report(), '', []
    begin = time.process_time()

    def keep_going():
        marks.append((report.time, report.cpu_time, time.process_time() - begin))
        return marks[-1][2] < LONGEST

    try:
        run(simulation, duration, rate, torque, report=report, on_row=lambda row: None,
            keep_going=keep_going, estimate=ErrorEstimate(simulation) if estimated else None)
    except SimulationError as error:
        failure = str(error)
    marks.append((report.time, report.cpu_time, time.process_time() - begin))
    end = marks[-1]
    middle = next(mark for mark in marks if mark[0] >= 0.5 * end[0])
    left = duration - end[0]
    costs = end[1:]
    if left > 0.0 and end[0] > middle[0] and not failure:
        costs = [one + left * (one - half) / (end[0] - middle[0])
                 for one, half in zip(end[1:], middle[1:])]
    return Cost(key, value, duration, *costs, end[0], failure)
