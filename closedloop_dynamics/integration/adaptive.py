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

from . import motion, runge_kutta, stick_slip
from .advance import (
    DONE, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, STEP_TOO_SMALL, TOO_MUCH_WORK)
from .projection import all_finite
from ..core.compiled import compiled, inlined, merged

# Columns of the control record: the time reached by whole steps; the step to try next (0: to be
# guessed); the start and the size of the latest step (0: there is none to interpolate); whether
# its slopes for dense output are complete; steps accepted and rejected since the last reset; the
# latest and the largest accepted error relative to the tolerance; evaluations; the time of the
# latest restart and how long before it the one before was; step size times fastest rate, as the
# latest step shows it.
(REACHED, NEXT_STEP, STEP_START, STEP_SIZE, EXTENDED, ACCEPTED, REJECTED, ERROR,
 LARGEST_ERROR, WORK, RESTARTED, HOLD, STIFFNESS) = range(13)
CONTROL_COLUMNS = 13

# Hairer's choices: aim a little below the tolerance, and change the step gently.
SAFETY, LARGEST_GROWTH, LARGEST_CUT = 0.9, 6.0, 0.2
# Errors of the step before that are smaller say little about where the motion goes.
TELLING = 1e-2
# Guesses of the first step, each this many times the one before.
GUESSES, FARTHER = 4, 100.0
# The least step, relative to the time that it has to change; times closer than that are the same.
LEAST = 1e-14
# In the place of a step size: there is no step to interpolate, but there is a past.
NOTHING_BETWEEN = -1.0
# Rows of the scratch.
STAGE, OUT, BEFORE, AFTER, LAST_STAGE, FIRST_SLOPE = range(6)
# What takes more evaluations than this for one step of the raster is no simulation any more.
MOST_EVALUATIONS = 200_000


@merged
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


@merged
def first_step(system, tableau, state, slopes, scale, stage, out):
    """
    Guess the size of the first step (Hairer, Norsett and Wanner 1993, section II.4).

    Where their guess is cut short, as for a mechanism that starts at rest with all coordinates
    zero, another is made from there: an evaluation costs less than small steps do.

    Parameters
    ----------
    system, tableau, state, slopes, scale, stage, out
        As for ``advance``; ``slopes[0]`` is the slope at ``state``, ``slopes[1]`` is scratch.

    Returns
    -------
    float
        [s].

    """
    size, slope = 0.0, 0.0
    count = state.shape[0]
    for i in range(count):
        weight = 1.0 / (scale[0, i] + scale[1, i] * abs(state[i]))
        size += (state[i] * weight) ** 2
        slope += (slopes[0, i] * weight) ** 2
    size, slope = math.sqrt(size / count), math.sqrt(slope / count)
    guess = 1e-6 if size < 1e-5 or slope < 1e-5 else 0.01 * size / slope
    for _ in range(GUESSES):
        for i in range(count):
            stage[i] = state[i] + guess * slopes[0, i]
        motion.derivative(system, stage, slopes[1])
        bend = 0.0
        for i in range(count):
            weight = 1.0 / (scale[0, i] + scale[1, i] * abs(state[i]))
            bend += ((slopes[1, i] - slopes[0, i]) * weight) ** 2
        steepest = max(slope, math.sqrt(bend / count) / guess)
        if steepest <= 1e-15:
            return max(1e-6, guess * 1e-3)
        best = (0.01 / steepest) ** (1.0 / (tableau.error_order + 1))
        guess *= FARTHER
        if not best > guess:
            return min(guess, best)
    return guess


@inlined
def is_before(time, target):
    """Return whether a time is before another by more than rounding."""
    return target - time > LEAST * max(abs(target), 1e-3)


@merged
def begin(time, state, control, scratch):
    """
    Start at a state, or start again where torques have changed.

    Parameters
    ----------
    time : float
        Of the state [s].
    state : ndarray, shape (ns,)
        To start at.
    control, scratch
        As for ``advance``.

    """
    control[HOLD] = time - control[RESTARTED]
    control[RESTARTED] = control[REACHED] = time
    control[STIFFNESS] = 0.0
    for i in range(state.shape[0]):
        scratch[AFTER, i] = state[i]


@compiled
def advance(system, tableau, stabilisation, state, origin, done, step_size, steps, control,
            scale, scratch):
    """
    Advance a state to a time, by error-controlled steps that need not end there.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    tableau : Tableau
        With error estimate and dense output.
    stabilisation : int
        One of ``projection``.
    state : ndarray, shape (ns,)
        After ``done`` steps of the raster, replaced by the one ``steps`` later.
    origin : float
        Time at which the raster begins [s].
    done : int
        Steps of the raster before this call. Times are computed from ``origin``, so that the
        same run in other portions ends at the same times to the last bit.
    step_size : float
        Of the raster [s].
    steps : int
        How many to advance.
    control : ndarray, shape (CONTROL_COLUMNS,)
        With STEP_SIZE zero the integration starts at ``state``; otherwise it goes on from where
        the latest step ended.
    scale : ndarray, shape (2, ns)
        Absolute and relative tolerance of each component.
    scratch : ndarray, shape (stages + FIRST_SLOPE, ns)
        Kept between calls.

    Returns
    -------
    int
        ``DONE``, ``NOT_FINITE``, ``OPEN_LOOP``, ``STEP_TOO_SMALL``, ``TOO_MUCH_WORK`` or
        ``POOR_EQUATIONS``; on failure ``state`` and REACHED are the latest good ones.

    """
    if control[STEP_SIZE] == 0.0:
        begin(origin + done * step_size, state, control, scratch)
    target = origin + (done + steps) * step_size
    most = control[WORK] + MOST_EVALUATIONS * steps
    status = DONE
    while is_before(control[REACHED], target) and status == DONE:
        status = accepted_step(system, tableau, stabilisation, control, scale, scratch)
        if control[WORK] > most:
            status = TOO_MUCH_WORK
    if status != DONE:
        for i in range(state.shape[0]):
            state[i] = scratch[AFTER, i]
        control[STEP_SIZE] = 0.0
        return status
    interpolate(system, tableau, target, control, scratch, state)
    if is_before(target, control[REACHED]) and not motion.stabilise(system, stabilisation, state):
        return OPEN_LOOP
    return DONE


@compiled
def interpolate(system, tableau, time, control, scratch, out):
    """
    Compute the state at a time within the latest step, before it is stabilised.

    Parameters
    ----------
    system, tableau, control, scratch
        As for ``advance``.
    time : float
        [s].
    out : ndarray, shape (ns,)
        Written in place.

    """
    if control[STEP_SIZE] == 0.0 or not is_before(time, control[REACHED]):
        for i in range(out.shape[0]):
            out[i] = scratch[AFTER, i]
        return
    slopes = scratch[FIRST_SLOPE:]
    if control[EXTENDED] == 0.0:
        _extend(system, tableau, scratch[BEFORE], control[STEP_SIZE], slopes, scratch[STAGE])
        control[EXTENDED] = 1.0
    share = (time - control[STEP_START]) / control[STEP_SIZE]
    runge_kutta.interpolate(tableau, scratch[BEFORE], control[STEP_SIZE], slopes, share, out)
    motion.normalise(system, out)


@inlined
def _extend(system, tableau, state, size, slopes, stage):
    """Evaluate the slopes that only dense output needs; parameters as of ``runge_kutta``."""
    first = tableau.b.shape[0]
    if tableau.error[0, first] != 0.0:
        first += 1
    runge_kutta.extend(system, tableau, state, size, slopes, stage, first)


@compiled
def accepted_step(system, tableau, stabilisation, control, scale, scratch):
    """
    Make one accepted step from where the latest ended.

    Returns
    -------
    int
        As for ``advance``.

    Notes
    -----
    Torques are expected to change again after as long as they were held the last time: a step
    ends there, since what goes beyond would be thrown away.

    The step size times the fastest rate is estimated as by Hairer and Wanner (1996), section
    IV.2: two states at the end of a step, the last stage's and the result, differ most in the
    direction of the largest eigenvalue.

    The next step follows the trend of the error, too (Gustafsson's predictive control, Hairer and
    Wanner 1996, section IV.8): where steps have to become smaller, every one would be rejected
    once otherwise.

    """
    stage, out, before, after, last, slopes = (
        scratch[STAGE], scratch[OUT], scratch[BEFORE], scratch[AFTER], scratch[LAST_STAGE],
        scratch[FIRST_SLOPE:])
    count, stages = after.shape[0], tableau.b.shape[0]
    motion.derivative(system, after, slopes[0])
    landed, sought = motion.begin_contacts(system, after), -1
    if control[STEP_SIZE] > 0.0:
        turned, moved = 0.0, 0.0
        for i in range(count):
            turned += (slopes[0, i] - slopes[stages - 1, i]) ** 2
            moved += (after[i] - last[i]) ** 2
        control[STIFFNESS] = control[STEP_SIZE] * math.sqrt(turned / moved) if moved > 0.0 else 0.0
    size = control[NEXT_STEP]
    if size == 0.0:
        size = first_step(system, tableau, after, slopes, scale, stage, out)
    elif landed:
        # What was a good size before says little now.
        size = min(size, first_step(system, tableau, after, slopes, scale, stage, out))
    wanted, rest = size, control[RESTARTED] + control[HOLD] - control[REACHED]
    if rest > LEAST * max(abs(control[REACHED]), 1e-3):
        # Two steps of a half rather than one and a crumb.
        size = rest if size >= rest else min(size, 0.5 * rest) if size > 0.5 * rest else size
    rejected, closed, extended, cuts = False, True, False, 0
    size_before, error_before = control[STEP_SIZE], max(control[ERROR], TELLING)
    size = min(size, motion.until_corner(system, after))
    while True:
        if not size > LEAST * max(abs(control[REACHED]), 1e-3):
            motion.end_contacts(system, after)
            return (NOT_FINITE if not all_finite(slopes[0]) else
                    STEP_TOO_SMALL if closed else OPEN_LOOP)
        runge_kutta.step(system, tableau, after, size, slopes, stage, out)
        control[WORK] += stages
        for i in range(count):
            last[i] = stage[i]
        if tableau.error[0, stages] != 0.0:
            motion.derivative(system, out, slopes[stages])
        error = error_norm(tableau, size, slopes, after, out, scale)
        # Written so that a NaN counts as an error too large.
        if error <= 1.0:
            part = motion.until_rest(
                system, after, out, size, max(
                    stick_slip.least(max(size, wanted), cuts), LEAST * abs(control[REACHED])))
            if part < size:
                motion.forget_contacts(system, after)
                size, cuts, sought = part, cuts + 1, -1
                continue
            part, sought, share = motion.until_contact(system, out, size, sought, 1.0)
            extended = share >= 0.0
            if extended:
                _extend(system, tableau, after, size, slopes, stage)
            while share >= 0.0:
                runge_kutta.interpolate(tableau, after, size, slopes, share, stage)
                motion.normalise(system, stage)
                part, sought, share = motion.until_contact(system, stage, size, sought, share)
            if part != size:
                size, cuts = part if sought >= -1 else size, cuts + 1
                continue
            if motion.stabilise(system, stabilisation, out):
                break
        motion.forget_contacts(system, after)
        rejected, sought = True, -1
        control[REJECTED] += 1.0
        # Loops that cannot be closed after a step can be after a shorter one.
        closed = not error <= 1.0
        cut = 0.5 if not closed else 0.0 if not error < 1e30 else (
            SAFETY * error ** (-1.0 / (tableau.error_order + 1)))
        size *= max(LARGEST_CUT, cut)
        wanted = size
    if not motion.equations_serve(system, stabilisation, out):
        motion.end_contacts(system, after)
        return POOR_EQUATIONS
    for i in range(count):
        before[i] = after[i]
        after[i] = out[i]
    motion.end_contacts(system, after)
    motion.rest(system, after)
    motion.pass_corners(system, after)
    growth = LARGEST_GROWTH if error < 1e-10 else min(
        LARGEST_GROWTH, SAFETY * error ** (-1.0 / (tableau.error_order + 1)))
    if rejected:
        growth = min(growth, 1.0)
    if size_before > 0.0 and error > TELLING:
        growth *= min(1.0, size / size_before * (error_before / error) ** (
            1.0 / (tableau.error_order + 1)))
    control[STEP_START] = control[REACHED]
    control[STEP_SIZE] = size
    control[REACHED] += size
    # A step cut short says nothing against the size that was to be tried.
    control[NEXT_STEP] = max(size * max(growth, LARGEST_CUT), wanted if size < wanted else 0.0)
    control[EXTENDED] = 1.0 if extended else 0.0
    control[ACCEPTED] += 1.0
    control[ERROR] = error
    control[LARGEST_ERROR] = max(control[LARGEST_ERROR], error)
    return DONE
