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

"""Error-controlled steps of an embedded Runge-Kutta pair, with dense output between them."""

import math

from . import runge_kutta
from .advance import DONE, NOT_FINITE, OPEN_LOOP, STEP_TOO_SMALL
from .projection import all_finite, stabilise
from .system import derivative
from ..core.compiled import compiled

# Columns of the control record: the time reached by whole steps; the step to try next (0: to be
# guessed); the start and the size of the latest step (0: there is none to interpolate); whether
# its slopes for dense output are complete; steps accepted and rejected since the last reset; the
# latest and the largest accepted error relative to the tolerance.
(REACHED, NEXT_STEP, STEP_START, STEP_SIZE, EXTENDED, ACCEPTED, REJECTED, ERROR,
 LARGEST_ERROR) = range(9)
CONTROL_COLUMNS = 9

# Hairer's choices: aim a little below the tolerance, and change the step gently.
SAFETY, LARGEST_GROWTH, LARGEST_CUT = 0.9, 6.0, 0.2


@compiled
def error_norm(tableau, step_size, slopes, state, out, scale):
    """
    Estimate the error of a step relative to the tolerance (1: just accepted).

    Parameters
    ----------
    tableau : Tableau
        Of the method.
    step_size : float
        [s].
    slopes : ndarray, shape (>= stages, ns)
        Of the stages.
    state, out : ndarray, shape (ns,)
        Before and after the step.
    scale : ndarray, shape (2, ns)
        Absolute and relative tolerance of each component.

    Returns
    -------
    float

    Notes
    -----
    Hairer, Norsett and Wanner (1993), section II.10: a coarser estimate, where the
    method has one, keeps the finer from being fooled.

    """
    fine, coarse = 0.0, 0.0
    count = state.shape[0]
    for i in range(count):
        first, second = 0.0, 0.0
        for k in range(tableau.error.shape[1]):
            first += tableau.error[0, k] * slopes[k, i]
            second += tableau.error[1, k] * slopes[k, i]
        weight = 1.0 / (scale[0, i] + scale[1, i] * max(abs(state[i]), abs(out[i])))
        fine += (first * weight) ** 2
        coarse += (second * weight) ** 2
    if coarse > 0.0:
        return step_size * fine / math.sqrt((fine + 0.01 * coarse) * count)
    return step_size * math.sqrt(fine / count)


@compiled
def first_step(system, tableau, state, slopes, scale, stage, out):
    """
    Guess the size of the first step (Hairer, Norsett and Wanner 1993, section II.4).

    Parameters
    ----------
    system, tableau, state, slopes, scale, stage, out
        As for ``advance``; ``slopes[0]`` is the slope at ``state``, ``slopes[1]`` is scratch.

    Returns
    -------
    float
        [s].

    """
    size, slope, bend = 0.0, 0.0, 0.0
    count = state.shape[0]
    for i in range(count):
        weight = 1.0 / (scale[0, i] + scale[1, i] * abs(state[i]))
        size += (state[i] * weight) ** 2
        slope += (slopes[0, i] * weight) ** 2
    size, slope = math.sqrt(size / count), math.sqrt(slope / count)
    guess = 1e-6 if size < 1e-5 or slope < 1e-5 else 0.01 * size / slope
    for i in range(count):
        stage[i] = state[i] + guess * slopes[0, i]
    derivative(system, stage, slopes[1])
    for i in range(count):
        weight = 1.0 / (scale[0, i] + scale[1, i] * abs(state[i]))
        bend += ((slopes[1, i] - slopes[0, i]) * weight) ** 2
    bend = math.sqrt(bend / count) / guess
    steepest = max(slope, bend)
    if steepest <= 1e-15:
        return max(1e-6, guess * 1e-3)
    return min(100.0 * guess, (0.01 / steepest) ** (1.0 / (tableau.error_order + 1)))


@compiled
def advance(system, tableau, stabilisation, state, target, control, scale, scratch):
    """
    Advance a state to a time, by error-controlled steps that need not end there.

    Parameters
    ----------
    system : System
        What moves.
    tableau : Tableau
        With error estimate and dense output.
    stabilisation : int
        One of ``projection``.
    state : ndarray, shape (ns,)
        State at the time of the latest call, replaced by the one at ``target``.
    target : float
        [s], not before the latest call's.
    control : ndarray, shape (CONTROL_COLUMNS,)
        With STEP_SIZE zero the integration starts at ``state`` and time REACHED; otherwise it
        goes on from where the latest step ended.
    scale : ndarray, shape (2, ns)
        Absolute and relative tolerance of each component.
    scratch : ndarray, shape (stages + 4, ns)
        Kept between calls.

    Returns
    -------
    int
        ``DONE``, ``NOT_FINITE``, ``OPEN_LOOP`` or ``STEP_TOO_SMALL``; on failure ``state`` and
        REACHED are the latest good ones.

    """
    stage, out, before, after, slopes = (
        scratch[0], scratch[1], scratch[2], scratch[3], scratch[4:])
    if control[STEP_SIZE] == 0.0:
        for i in range(state.shape[0]):
            after[i] = state[i]
    status = DONE
    while control[REACHED] < target and status == DONE:
        status = _step(system, tableau, stabilisation, target, control, scale, stage, out, before,
                       after, slopes)
    if status != DONE:
        for i in range(state.shape[0]):
            state[i] = after[i]
        control[STEP_SIZE] = 0.0
        return status
    if control[REACHED] == target or control[STEP_SIZE] == 0.0:
        for i in range(state.shape[0]):
            state[i] = after[i]
        return DONE
    if control[EXTENDED] == 0.0:
        first = tableau.b.shape[0]
        if tableau.error[0, first] != 0.0:
            first += 1
        runge_kutta.extend(system, tableau, before, control[STEP_SIZE], slopes, stage, first)
        control[EXTENDED] = 1.0
    share = (target - control[STEP_START]) / control[STEP_SIZE]
    runge_kutta.interpolate(tableau, before, control[STEP_SIZE], slopes, share, state)
    return DONE if stabilise(system, stabilisation, state) else OPEN_LOOP


@compiled
def _step(system, tableau, stabilisation, target, control, scale, stage, out, before, after,
          slopes):
    """Make one accepted step from ``after``, which becomes ``before``."""
    steps = tableau.b.shape[0]
    derivative(system, after, slopes[0])
    size = control[NEXT_STEP]
    if size == 0.0:
        size = first_step(system, tableau, after, slopes, scale, stage, out)
    rejected = False
    while True:
        if not size > 1e-14 * max(abs(control[REACHED]), 1e-3):
            return STEP_TOO_SMALL if all_finite(slopes[0]) else NOT_FINITE
        runge_kutta.step(system, tableau, after, size, slopes, stage, out)
        if tableau.error[0, steps] != 0.0:
            derivative(system, out, slopes[steps])
        error = error_norm(tableau, size, slopes, after, out, scale)
        # Written so that a NaN counts as an error too large.
        if error <= 1.0:
            break
        rejected = True
        control[REJECTED] += 1.0
        cut = SAFETY * error ** (-1.0 / (tableau.error_order + 1)) if error < 1e30 else 0.0
        size *= max(LARGEST_CUT, cut)
    for i in range(after.shape[0]):
        before[i] = after[i]
        after[i] = out[i]
    if not stabilise(system, stabilisation, after):
        for i in range(after.shape[0]):
            after[i] = before[i]
        return OPEN_LOOP
    growth = LARGEST_GROWTH if error < 1e-10 else min(
        LARGEST_GROWTH, SAFETY * error ** (-1.0 / (tableau.error_order + 1)))
    if rejected:
        growth = min(growth, 1.0)
    control[STEP_START] = control[REACHED]
    control[STEP_SIZE] = size
    control[REACHED] += size
    control[NEXT_STEP] = size * max(growth, LARGEST_CUT)
    control[EXTENDED] = 0.0
    control[ACCEPTED] += 1.0
    control[ERROR] = error
    control[LARGEST_ERROR] = max(control[LARGEST_ERROR], error)
    return DONE
