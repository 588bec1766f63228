# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Monitor of a running simulation: its cost and its estimated error."""

from dataclasses import dataclass
import math

import numpy as np

from ..engine.status import CLOSER, FLOOR
from ..engine.types import EVALUATIONS, RANK_REVEALING_COUNT
from ..scene.integrators import AUTO, FIXED, INTEGRATORS

# An accuracy counts as kept up to this factor.
KEPT = 3.0
# Rounding errors that two runs may have in common next to a singular configuration [rad or m]: in
# random passages of Peaucellier's linkage, whose motion is known, up to 4e-11.
COMMON_ROUNDING = 1e-10


@dataclass(frozen=True)
class RunReport:
    """
    Cost of a run so far, and its estimated error.

    Attributes
    ----------
    method : str
        Names of integrator and stabilisation.
    time : float
        Simulated since the start or the last reset [s].
    steps : int
        Steps made for it; of an error-controlled method those accepted.
    compute_time : float
        Spent on them [s].
    local_error : float
        Largest estimate of the error of one step [rad or m], from a sample of steps made again in
        two halves, or of an error-controlled method its own; NaN where there is none.
    closure : float
        Present closure error [m or rad].
    energy_error : float
        Change of energy that neither work nor dissipation explains [J].
    evaluations : int
        Of the accelerations.
    energy_moved : float
        The most energy that has moved since the start [J]; NaN before the first look.
    error_bound : float
        Of ``integrator: auto``: largest error of coordinates within a second [rad or m], by a
        reference run with a larger tolerance: a tenth of the distance to it, all of it where the
        run came next to a singular configuration; NaN for other methods, and where the energy
        balance contradicts.
    findings : tuple of str
        What is wrong with the run, each with its remedy; empty where nothing is known to be.
    accuracy : float
        Of ``integrator: auto``: the accuracy that is kept now [rad or m]; NaN for other methods.
    present_bound : float
        As ``error_bound``, in the latest second that was looked at alone [rad or m].
    budget, budget_used : float
        Computing time per time of the clock that is allowed, and that the latest tenth of a second
        took, the reference run included throughout [1]; NaN without a budget.
    branch_undecided : bool
        Whether the run came to a change point that lengths miss by so little that it may be on
        another branch, as ``findings`` say. There are no bounds then: a reference run takes the
        same branch.

    """

    method: str
    time: float
    steps: int
    compute_time: float
    local_error: float
    closure: float
    energy_error: float
    evaluations: int
    energy_moved: float = math.nan
    error_bound: float = math.nan
    findings: tuple = ()
    accuracy: float = math.nan
    present_bound: float = math.nan
    budget: float = math.nan
    budget_used: float = math.nan
    branch_undecided: bool = False

    @property
    def time_per_step(self):
        """Return the mean computing time of a step [s]."""
        return self.compute_time / self.steps if self.steps else math.nan

    @property
    def share(self):
        """Return the computing time per simulated time: 1 is all that real time allows."""
        return self.compute_time / self.time if self.time else math.nan

    @property
    def evaluation_rate(self):
        """Return the evaluations per simulated second [1/s]."""
        return self.evaluations / self.time if self.time else math.nan

    def __str__(self):
        """Return the report in a line for each thing."""
        lines = [
            f'cost         {_number(1e6 * self.time_per_step)} us per step, '
            f'{_number(100.0 * self.share)} % of real time ({self.method}; {self.steps} steps, '
            f'{self.evaluations} evaluations)',
            f'local error  {_number(self.local_error, 2)} rad or m in the worst step checked '
            '(the error of one step, not of the run)',
            f'closure      {_number(self.closure, 2)} m or rad',
            f'energy       {energy_in_words(self.energy_error, self.energy_moved)}']
        if not math.isnan(self.error_bound):
            lines.insert(1, f'error        at most about {_number(self.error_bound, 2)} rad or m '
                            'within a second, by a reference run')
        if not math.isnan(self.budget):
            lines.insert(1, f'accuracy     {self.accuracy:g} rad or m within a second: the best '
                            f'that {self.budget:g} of real time allows now')
        return '\n'.join([*lines, *(f'warning      {finding}' for finding in self.findings)])


def energy_in_words(error, moved):
    """Return the error of the energy balance in words, with the energy exchanged."""
    of_what = '' if math.isnan(moved) else f' of {_number(moved)} J exchanged'
    if error == 0.0:
        return f'balanced to the last digit{of_what}'
    return f'{_number(abs(error), 2)} J too {"much" if error > 0.0 else "little"}{of_what}'


def _number(value, digits=3):
    return 'unknown' if math.isnan(value) else f'{value:.{digits}g}'


class Monitor:
    """
    An account of the cost of a run and of its local error.

    Parameters
    ----------
    method : scene_records.Method
    run : run.Run

    """

    def __init__(self, method, run):
        self._method, self._run, self._sampling = method, run, True
        self.clear()

    @property
    def measured(self):
        """
        Return the measurements so far, shape (5,).

        Simulated time, CPU time of the thread, with a budget alone, and time of the clock [s];
        ``work``.
        """
        report = self._run.report
        return np.array([report.simulated, report.worked, report.elapsed, *self.work])

    @property
    def work(self):
        """Return the evaluations in steps of ``integrator: auto`` and of its reference run."""
        steps = self._run.steps
        return (0.0, 0.0) if math.isnan(steps.accuracy) else (steps.work, steps.reference_work)

    @property
    def sampling(self):
        """Whether to estimate the error of fixed steps, at the cost of some 20 steps in 1000."""
        return self._sampling

    @sampling.setter
    def sampling(self, wanted):
        self._sampling = wanted
        self._run.sample(wanted and INTEGRATORS[self._method.integrator].kind == FIXED)

    def clear(self):
        """Reset the counts: the time starts again."""
        self._run.clear_cost()
        self.sampling = self._sampling

    def report(self, health, closure, energy_error, energy_guard, notes=(), budget=None):
        """
        Report counts and findings.

        ``health``: of the system; ``closure``: the present error [m or rad]; ``energy_error``:
        change of energy that neither work nor dissipation explains [J]; ``notes``: findings beside
        these; ``budget``: that the accuracy follows, or None.
        """
        run, made, bound, present = self._run.report, self._run.steps, math.nan, math.nan
        steps, error = int(run.steps), run.local_error
        findings = [*notes, *([energy_guard.finding] if energy_guard.finding else [])]
        if not math.isnan(made.accepted):
            steps, error = int(made.accepted), made.local_error
        if self._method.integrator == AUTO:
            bound, present = made.largest_bound, made.bound
            if run.failed or energy_guard.finding:
                # The reference run is as wrong as the run.
                bound = present = math.nan
            singular = health[RANK_REVEALING_COUNT] > 0.0
            if singular:
                # Next to a singular configuration rounding errors grow, and a smaller tolerance
                # does not reduce them: the distance may be the error of the reference run.
                bound = max(bound / CLOSER, COMMON_ROUNDING)
                present = max(present / CLOSER, COMMON_ROUNDING)
            if bound > KEPT * self._method.accuracy:
                cause = (
                    'as the motion came next to a singular configuration, where rounding errors '
                    'grow, and the distance to the reference run may be the error of that run'
                    if singular else
                    'although the tolerance was the smallest one: rounding errors grow to that '
                    'size in this motion'
                    if made.tolerance <= FLOOR else
                    'as the budget did not allow for more' if budget is not None else
                    'before the tolerance was tightened. Ask for a smaller accuracy')
                findings.append(
                    f'the accuracy of {self._method.accuracy:g} rad or m within a second was not '
                    f'kept: the error was about {bound:.2g}, {cause}.')
        share = used = math.nan
        if budget is not None:
            share, used = budget.share, budget.used
            findings += filter(None, [budget.finding(made.accuracy)])
        method = f'{self._method.integrator}, {self._method.stabilisation}'
        return RunReport(
            method, run.simulated, steps, run.elapsed, error, closure, energy_error,
            int(health[EVALUATIONS]), run.moved, bound,
            tuple(findings), made.accuracy, present, share, used)
