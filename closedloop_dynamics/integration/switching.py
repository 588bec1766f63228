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

"""
The default method: error control that changes between an explicit and a stiff method.

The explicit method is DOP853. Where its steps are limited by stability, RODAS4 is tried, and
whichever takes less work for the same time goes on; work is counted in evaluations, so that the
same run changes at the same steps every time.

The local tolerance is a thousandth of the accuracy that is asked for. Whether that is enough is
watched: in windows of one second a companion run with a tolerance 30 times as large starts from
the same state. How far the two come apart bounds the global error of the run within a second; the
tolerance of both is tightened where that bound comes near the accuracy.

"""

import math
from typing import NamedTuple

import numpy as np

from . import adaptive, motion, rosenbrock
from .adaptive import (
    AFTER, CONTROL_COLUMNS, FIRST_SLOPE, HOLD, is_before, LEAST, MOST_EVALUATIONS, NEXT_STEP,
    NOTHING_BETWEEN, OUT, REACHED, RESTARTED, STEP_SIZE, STIFFNESS, WORK)
from .advance import DONE, OPEN_LOOP, POOR_EQUATIONS, TOO_MUCH_WORK
from ..core.compiled import compiled, merged

# Columns that follow those of ``adaptive`` in the control record: whether the stiff method steps;
# explicit steps in a row that stability seems to limit and those that it does not; how many of the
# first kind let the stiff method be tried; work and time when that count, or the trial,
# began; work per time of the explicit method before the trial; steps of the trial.
(STIFF, LIMITED, FREE, PATIENCE, SINCE_WORK, SINCE_TIME, EXPLICIT_RATE, TRIED) = range(
    CONTROL_COLUMNS, CONTROL_COLUMNS + 8)
COLUMNS = CONTROL_COLUMNS + 8

# Columns of the watch: the accuracy; the present tolerance; whether a window is open; when it ends
# or the next begins; how long the next pause is; the smallest step in a window; the bound of the
# error in the present window, what of it is from before the companion was set back, and the
# largest of all windows; the bound at which the tolerance is tightened next; how often it was.
(ACCURACY, TOLERANCE, OPEN, UNTIL, PAUSE, SMALLEST, BOUND, CARRIED, LARGEST_BOUND, NEXT_BOUND,
 TIGHTENED) = range(11)
WATCH_COLUMNS = 11

# Tolerance against accuracy, and the companion's against it.
SHARE, LOOSER = 1e-3, 30.0
# The run's own error against the distance to its companion: the steps of a method of order 8
# make it LOOSER times as small at best.
CLOSER = 0.1
# Share of the accuracy at which the tolerance is tightened, and again at ten times as much each
# time in a window; by how much; and down to what.
TIGHTEN_AT, TIGHTER, FLOOR = 0.3, 0.1, 1e-13
WINDOW, LONGEST_PAUSE = 1.0, 8.0

# Step size times fastest rate from which on stability may limit the explicit steps (it does at
# 6.1 along the negative real axis), and the share of that at which they would be stable again.
STABILITY_LIMIT, STABLE = 4.0, 5.0
# Such steps in a row before a trial, at first and at most; others in a row that end the count.
FIRST_PATIENCE, MOST_PATIENCE, FREE_STEPS = 15, 1000, 6
# Steps of a trial, and those at its start, small still, that do not count.
TRIAL, GROWING = 20, 8
EXPLICIT_WORK = 12


# Rows of all arrays of ``Runs``.
RUN, COMPANION = range(2)


class Runs(NamedTuple):
    """A run and its companion: control records, tolerances and scratch."""

    control: np.ndarray  # Shape (2, COLUMNS)
    scale: np.ndarray  # Shape (2, 2, ns): absolute and relative tolerance of each component
    # Shape (2, rows, ns): of the explicit method; its row AFTER is the state at REACHED.
    scratch: np.ndarray
    stiff_scratch: np.ndarray  # Shape (2, rows, ns): of the stiff method
    matrix: np.ndarray  # Shape (ns, ns)
    pivots: np.ndarray  # Shape (ns,)
    watch: np.ndarray  # Shape (WATCH_COLUMNS,)
    weight: np.ndarray  # Shape (nq,): of a component in the distance of the two


def allocate_runs(tableau, states, weight):
    """
    Allocate a run and its companion.

    Parameters
    ----------
    tableau : Tableau
        Of the explicit method.
    states : int
        Length of the state vector.
    weight : ndarray, shape (nq,)
        What a component's error stands for.

    Returns
    -------
    Runs

    """
    stiff_rows = rosenbrock.STAGES + rosenbrock.FIRST_SLOPE
    return Runs(
        np.zeros((2, COLUMNS)), np.zeros((2, 2, states)),
        np.zeros((2, len(tableau.a) + FIRST_SLOPE, states)), np.zeros((2, stiff_rows, states)),
        np.zeros((states, states)), np.zeros(states, dtype=np.int64), np.zeros(WATCH_COLUMNS),
        weight)


@compiled
def advance(system, tableau, stabilisation, state, origin, done, step_size, steps, runs):
    """
    Advance a state by a number of steps of the raster.

    Returns
    -------
    int
        As for ``adaptive.advance``.

    Notes
    -----
    There is one place for the steps of both runs: whichever is behind makes the next one.

    """
    control, watch, scratch = runs.control, runs.watch, runs.scratch
    if control[RUN, STEP_SIZE] == 0.0:
        _begin(origin + done * step_size, state, runs)
    target = origin + (done + steps) * step_size
    most = control[RUN, WORK] + control[COMPANION, WORK] + 2.0 * MOST_EVALUATIONS * steps
    status, follows = DONE, False
    while status == DONE and (follows or is_before(control[RUN, REACHED], target)):
        which, limit = COMPANION, control[RUN, REACHED]
        if not follows:
            # A stiff step ends on the raster, where the state may be asked for.
            passed = math.floor((control[RUN, REACHED] - origin) / step_size + 1e-6)
            which, limit = RUN, origin + (passed + 1.0) * step_size
        now = control[which]
        if now[STIFF] == 0.0:
            status = adaptive.accepted_step(
                system, tableau, stabilisation, now, runs.scale[which], scratch[which])
            if status == DONE:
                _consider_stiff(now)
            elif status != POOR_EQUATIONS:
                # What stops the one may not stop the other.
                status, now[EXPLICIT_RATE] = DONE, 0.0
                _change(now, 1.0)
        else:
            status = rosenbrock.accepted_step(
                system, stabilisation, scratch[which, AFTER], limit, now, runs.scale[which],
                runs.matrix, runs.pivots, runs.stiff_scratch[which])
            if status == DONE:
                now[STEP_SIZE] = NOTHING_BETWEEN
                _consider_explicit(now)
        if status == POOR_EQUATIONS:
            now[STEP_SIZE] = NOTHING_BETWEEN
        lost = which == COMPANION and status not in (DONE, POOR_EQUATIONS)
        if lost:
            status = DONE
        elif control[RUN, WORK] + control[COMPANION, WORK] > most:
            status = TOO_MUCH_WORK
        follows = watch[OPEN] == 1.0 and not lost and is_before(
            control[COMPANION, REACHED], control[RUN, REACHED])
        if not follows and status == DONE:
            _look(system, tableau, runs, lost)
    if status != DONE:
        for i in range(state.shape[0]):
            state[i] = scratch[RUN, AFTER, i]
        # With other equations both go on.
        if status != POOR_EQUATIONS:
            control[RUN, STEP_SIZE] = 0.0
        return status
    adaptive.interpolate(system, tableau, target, control[RUN], scratch[RUN], state)
    if is_before(target, control[RUN, REACHED]) and not motion.stabilise(
            system, stabilisation, state):
        return OPEN_LOOP
    return DONE


@merged
def _begin(time, state, runs):
    """Start at a state; the companion continues from its own, if that is of the same time."""
    control, watch = runs.control, runs.watch
    adaptive.begin(time, state, control[RUN], runs.scratch[RUN])
    if control[RUN, PATIENCE] == 0.0:
        # Nothing that was before says anything about this state.
        control[RUN, PATIENCE] = FIRST_PATIENCE
        _change(control[RUN], 0.0)
        watch[PAUSE] = WINDOW
        watch[SMALLEST] = 0.0
        _open(runs)
    elif watch[OPEN] == 1.0:
        other = control[COMPANION]
        # Amid a step it is set back: a run that is restored does not know that step.
        if abs(other[REACHED] - time) <= LEAST * max(abs(time), 1e-3):
            other[HOLD], other[RESTARTED] = control[RUN, HOLD], time
            other[REACHED], other[STEP_SIZE] = time, 0.0
        else:
            watch[CARRIED] = watch[BOUND]
            _set_back(runs)


@compiled
def _open(runs):
    """Open a window."""
    watch = runs.watch
    watch[OPEN], watch[BOUND], watch[CARRIED] = 1.0, 0.0, 0.0
    watch[NEXT_BOUND] = TIGHTEN_AT * watch[ACCURACY]
    _set_back(runs)


@compiled
def _set_back(runs):
    """Let the companion go on from where the run is."""
    control, other = runs.control[RUN], runs.control[COMPANION]
    for i in range(runs.scratch.shape[2]):
        runs.scratch[COMPANION, AFTER, i] = runs.scratch[RUN, AFTER, i]
    for column in (REACHED, RESTARTED, HOLD, STIFF, TRIED, PATIENCE):
        other[column] = control[column]
    other[STEP_SIZE] = other[LIMITED] = other[FREE] = other[EXPLICIT_RATE] = 0.0
    if other[NEXT_STEP] == 0.0:
        other[NEXT_STEP] = control[NEXT_STEP]


@merged
def _consider_stiff(control):
    """Change to the stiff method where stability has limited the explicit steps for a while."""
    if control[STIFFNESS] > STABILITY_LIMIT:
        if control[LIMITED] == 0.0:
            control[SINCE_WORK], control[SINCE_TIME] = control[WORK], control[REACHED]
        control[LIMITED] += 1.0
        control[FREE] = 0.0
    else:
        control[FREE] += 1.0
        if control[FREE] >= FREE_STEPS:
            control[LIMITED] = 0.0
    if control[LIMITED] > control[PATIENCE]:
        control[EXPLICIT_RATE] = (control[WORK] - control[SINCE_WORK]) / (
            control[REACHED] - control[SINCE_TIME])
        _change(control, 1.0)


@merged
def _consider_explicit(control):
    """Change back where the stiff method takes more work, or explicit steps would be stable."""
    control[TRIED] += 1.0
    if control[TRIED] == GROWING:
        control[SINCE_WORK], control[SINCE_TIME] = control[WORK], control[REACHED]
    if control[TRIED] >= TRIAL:
        rate = (control[WORK] - control[SINCE_WORK]) / (control[REACHED] - control[SINCE_TIME])
        if control[EXPLICIT_RATE] > 0.0 and rate > control[EXPLICIT_RATE]:
            # The trial has failed: the next one after a longer while.
            control[PATIENCE] = min(2.0 * control[PATIENCE], MOST_PATIENCE)
            _change(control, 0.0)
        elif EXPLICIT_WORK * control[STIFFNESS] / STABLE < rate:
            control[PATIENCE] = FIRST_PATIENCE
            _change(control, 0.0)
            control[NEXT_STEP] = min(control[NEXT_STEP], STABLE / control[STIFFNESS])
        else:
            control[TRIED], control[EXPLICIT_RATE] = GROWING, 0.0
            control[SINCE_WORK], control[SINCE_TIME] = control[WORK], control[REACHED]


@merged
def _change(control, stiff):
    """Let the other method go on."""
    control[STIFF] = stiff
    control[LIMITED] = control[FREE] = control[TRIED] = 0.0


@merged
def _look(system, tableau, runs, lost):
    """Compare the run with its companion, and tighten the tolerance where it must be."""
    control, watch = runs.control[RUN], runs.watch
    now = control[REACHED]
    if watch[OPEN] == 0.0:
        # Much smaller steps than were seen while it was open: it is another motion now.
        if now >= watch[UNTIL] or control[STEP_SIZE] > 0.0 and (
                control[NEXT_STEP] < 0.25 * watch[SMALLEST]):
            watch[UNTIL], watch[SMALLEST] = now + WINDOW, control[NEXT_STEP]
            _open(runs)
    else:
        if watch[SMALLEST] == 0.0:
            watch[UNTIL], watch[SMALLEST] = now + WINDOW, control[NEXT_STEP]
        watch[SMALLEST] = min(watch[SMALLEST], control[NEXT_STEP])
        bound = math.inf
        if not lost:
            bound = watch[CARRIED] + CLOSER * _distance(system, tableau, runs)
        if not lost or watch[TOLERANCE] <= FLOOR:
            watch[BOUND] = max(watch[BOUND], bound)
            watch[LARGEST_BOUND] = max(watch[LARGEST_BOUND], watch[BOUND])
        if bound > watch[NEXT_BOUND] and watch[TOLERANCE] > FLOOR:
            factor = max(TIGHTER, FLOOR / watch[TOLERANCE])
            watch[TOLERANCE] *= factor
            watch[NEXT_BOUND] *= 10.0
            watch[TIGHTENED] += 1.0
            for which in range(2):
                for k in range(2):
                    for i in range(runs.scale.shape[2]):
                        runs.scale[which, k, i] *= factor
            control[NEXT_STEP] *= 0.5
            watch[PAUSE] = WINDOW
        if lost:
            _set_back(runs)
        if now >= watch[UNTIL]:
            watch[OPEN], watch[UNTIL] = 0.0, now + watch[PAUSE]
            watch[PAUSE] = min(2.0 * watch[PAUSE], LONGEST_PAUSE)


@merged
def _distance(system, tableau, runs):
    """Return how far the coordinates of the companion are from those of the run."""
    scratch, apart = runs.scratch, 0.0
    adaptive.interpolate(
        system, tableau, runs.control[RUN, REACHED], runs.control[COMPANION], scratch[COMPANION],
        scratch[COMPANION, OUT])
    for i in range(runs.weight.shape[0]):
        apart = max(apart, runs.weight[i] * abs(
            scratch[COMPANION, OUT, i] - scratch[RUN, AFTER, i]))
    return apart
