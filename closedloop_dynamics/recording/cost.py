# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The cost of a run, predicted from a probe, its first part."""

from bisect import bisect_right
from dataclasses import dataclass, field, replace
import math
import time

from .run import ErrorEstimate, Report, run
from ..engine.status import LONGEST_PAUSE, WINDOW
from ..mechanism.errors import SimulationError
from ..scene.integrators import AUTO, FIXED, INTEGRATORS
from ..simulation.budget import allowed
from ..simulation.simulation import Simulation

# CPU time that a probe may take [s]; one that took less than the second is made once more, and the
# faster one counts: what runs for the first time is slower, and other programs disturb.
LONGEST, SHORT = 0.5, 0.2
# Tolerance or accuracy, and step size, of a second method that is listed beside the first,
# relative to those of the first.
FINER, SHORTER = 1e-3, 0.5


@dataclass(frozen=True)
class Cost:
    """Expected cost of a run."""

    key: str  # Of a scene's method: ``accuracy``, ``tolerance`` or ``step_size``
    value: float  # Its value
    duration: float  # Simulated time [s]
    # CPU time of the simulated time alone [s]; with rows and the second run that gives the error.
    cpu_time: float
    whole: float
    probed: float  # Simulated time that the probe covered [s]
    failure: str = ''  # Why the probe failed, whose costs are those up to there
    # Simulated time and CPU time of it along the probe [s].
    history: tuple = field(default=(), repr=False, compare=False)

    @property
    def setting(self):
        """Return the method's key and value in words."""
        return f'{self.key.replace("_", " ")} {self.value:g}'

    @property
    def share(self):
        """Return the CPU time per simulated time."""
        return self.cpu_time / self.duration

    def __str__(self):
        """Return the cost in words."""
        if self.failure:
            return f'at {self.setting} the run fails at t = {self.probed:.3g} s: {self.failure}'
        return f'about {self.cpu_time:.2g} s of CPU for {self.duration:g} s at {self.setting}'


def probe(simulation, duration, rate, torque=None, estimated=False, longest=None):
    """
    Predict the cost of a run, and of a finer one.

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
        Whether a second, finer run beside the first gives its error.
    longest : float, optional
        CPU time that each of the two probes may take [s]; ``LONGEST`` when not given.

    Returns
    -------
    list of Cost
        With the method of the run, and with one of a smaller accuracy, tolerance or step size.

    Notes
    -----
    The run is made for up to ``LONGEST`` of CPU time. Where it is not at its end by then, the rest
    is expected to cost what the later half of the probe did, with the reference run of
    ``integrator: auto`` in its windows alone, where it doubles the cost. Where the finer run did
    not get as far as the other, it is expected to cost as many times more for the rest as it did
    up to there: a machine that stands still at times may have done so in the longer probe alone.

    """
    method = simulation.scene.method.without_budget
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
        found.append(_probed(other, key, value, duration, rate, torque, estimated, longest))
        if found[-1].probed == duration and found[-1].whole < SHORT:
            other.reset()
            again = _probed(other, key, value, duration, rate, torque, estimated, longest)
            found[-1] = min(found[-1], again, key=lambda one: one.cpu_time)
    first, finer = found
    if 0.0 < finer.probed < first.probed and not (first.failure or finer.failure):
        found[1] = _like(finer, first)
    return found


def _like(cost, longer):
    """Return a cost extrapolated like that of a run probed for longer, times a factor."""
    reached, spent = cost.history[-1]
    times, taken = zip(*longer.history)
    place = bisect_right(times, reached)
    # At the same time in the longer probe.
    share = (reached - times[place - 1]) / (times[place] - times[place - 1])
    same = taken[place - 1] + share * (taken[place] - taken[place - 1])
    if not same > 0.0:
        return cost
    cpu_time = spent + (longer.cpu_time - same) * spent / same
    return replace(cost, cpu_time=cpu_time, whole=cost.whole + cpu_time - cost.cpu_time)


def allowance(budget, costs, pace=1.0):
    """
    Return in words which accuracy a budget is expected to allow.

    ``budget``: computing time per time of the clock [1]; ``costs``: from ``probe``, of
    ``integrator: auto``; ``pace``: simulated seconds per second of the clock.
    """
    known = [(cost.value, pace * cost.share) for cost in costs
             if not cost.failure and cost.share > 0.0]
    if len(known) < 2:
        return f'what a budget of {budget:g} of real time allows is not known: a probe failed'
    accuracy = allowed(budget, known)
    if accuracy is None:
        return (f'a budget of {budget:g} of real time allows no accuracy: {known[0][0]:g} takes '
                f'{known[0][1]:.2g}')
    wanted = costs[0].value
    return (f'a budget of {budget:g} of real time allows an accuracy of about {accuracy:g}' + (
        f', and the accuracy of {wanted:g} takes {known[0][1]:.2g}: they exclude each other'
        if accuracy > wanted else ''))


def _probed(simulation, key, value, duration, rate, torque, estimated, longest):
    """Return the cost of a run of a simulation from its start."""
    report, failure, marks = Report(), '', []
    begin, most = time.process_time(), LONGEST if longest is None else longest

    def mark():
        marks.append((report.time, report.cpu_time, time.process_time() - begin,
                      *simulation.stepping.monitor.work))

    def keep_going():
        mark()
        return marks[-1][2] < most

    try:
        run(simulation, duration, rate, torque, report=report, on_row=lambda row: None,
            keep_going=keep_going, estimate=ErrorEstimate(simulation) if estimated else None)
    except SimulationError as error:
        failure = str(error)
    mark()
    end = marks[-1]
    *_, middle = (mark for mark in marks if mark[0] <= 0.5 * end[0])
    left, costs = duration - end[0], end[1:3]
    if not (failure or end[0] > 0.0):
        failure = f'nothing was simulated within {most:g} s of CPU'
    if left > 0.0 and not failure:
        probed, cpu_time, whole, *work = (one - half for one, half in zip(end, middle))
        rest = left * cpu_time / probed
        if work[0] > 0.0:
            checked = in_windows(duration) - in_windows(end[0])
            rest *= work[0] / sum(work) * (1.0 + checked / left)
        costs = end[1] + rest, end[2] + rest + left * (whole - cpu_time) / probed
    return Cost(key, value, duration, *costs, end[0], failure,
                ((0.0, 0.0), *(mark[:2] for mark in marks)))


def in_windows(duration):
    """
    Return the time that ``integrator: auto`` estimates its error in, at one accuracy [s].

    ``duration``: float; of the run [s].
    """
    windows, begin, pause = 0.0, 0.0, WINDOW
    while begin < duration:
        windows += min(WINDOW, duration - begin)
        begin += WINDOW + pause
        pause = min(2.0 * pause, LONGEST_PAUSE)
    return windows
