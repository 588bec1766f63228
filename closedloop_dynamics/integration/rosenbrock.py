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
RODAS4, a linearly implicit method for stiff scenes: L-stable, stiffly accurate, order 4(3).

Each step solves six linear systems with one factorization of I - h gamma J; the
Jacobian J comes from finite differences of the derivative, so that it sees whatever
a scene simulates. Its cost grows with the cube of the number of states.

Source: Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed. (1996), section
VI.4, in the form that needs no product with J.

"""

import math

import numpy as np

from . import motion, stick_slip
from .adaptive import (
    ACCEPTED, ERROR, is_before, LARGEST_ERROR, LEAST, NEXT_STEP, REACHED, REJECTED, SAFETY,
    STIFFNESS, WORK)
from .advance import (
    DONE, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, STEP_TOO_SMALL, taken)
from .projection import all_finite
from ..core import lu
from ..core.compiled import compiled, inlined, merged

STAGES = 6
# Rows of the scratch before the slopes.
FIRST_SLOPE = 6
GAMMA = 0.25
A = np.array([
    [0.0, 0.0, 0.0, 0.0, 0.0],
    [1.544, 0.0, 0.0, 0.0, 0.0],
    [0.9466785280815826, 0.2557011698983284, 0.0, 0.0, 0.0],
    [3.314825187068521, 2.896124015972201, 0.9986419139977817, 0.0, 0.0],
    [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 0.0],
    [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0]])
C = np.array([
    [0.0, 0.0, 0.0, 0.0, 0.0],
    [-5.6688, 0.0, 0.0, 0.0, 0.0],
    [-2.430093356833875, -0.2063599157091915, 0.0, 0.0, 0.0],
    [-0.1073529058151375, -9.594562251023355, -20.47028614809616, 0.0, 0.0],
    [7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160, 0.0],
    [8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136,
     -6.058818238834054]])

# Step of the finite differences, relative to a state of size 1: half the digits each for
# truncation and rounding.
DIFFERENCE = 1.5e-8


@merged
def factor_jacobian(system, state, slope, step_size, matrix, pivots, direction, stage, moved):
    """
    Factor I / (h gamma) - J at a state, and estimate the fastest rate of the motion there.

    Parameters
    ----------
    system : System
        Whose derivative is differentiated.
    state, slope : ndarray, shape (ns,)
        State and its derivative.
    step_size : float
        [s].
    matrix : ndarray, shape (ns, ns)
        Written: the factors.
    pivots : ndarray of int, shape (ns,)
        Written: the row exchanges.
    direction : ndarray, shape (ns,)
        Of the fastest rate, improved from one call to the next; zero at first.
    stage, moved : ndarray, shape (ns,)
        Scratch.

    Returns
    -------
    float
        Largest eigenvalue of J, in magnitude [1/s], by one double step of the power iteration:
        of a conjugate pair two products show the magnitude.

    """
    n = state.shape[0]
    for i in range(n):
        stage[i] = state[i]
    for j in range(n):
        change = DIFFERENCE * max(1.0, abs(state[j]))
        stage[j] = state[j] + change
        # The change that the rounded sum really made.
        change = stage[j] - state[j]
        motion.derivative(system, stage, moved)
        stage[j] = state[j]
        for i in range(n):
            matrix[i, j] = (slope[i] - moved[i]) / change
    rate = _fastest_rate(matrix, direction, stage, moved)
    for i in range(n):
        matrix[i, i] += 1.0 / (step_size * GAMMA)
    lu.factorize(matrix, pivots)
    return rate


@merged
def _fastest_rate(matrix, direction, once, twice):
    """Multiply a direction by a matrix twice; return the root of what its length grew by."""
    n, length = direction.shape[0], 0.0
    for i in range(n):
        length += direction[i] ** 2
    for i in range(n):
        # Any direction that is no eigenvector to begin with.
        direction[i] = direction[i] / math.sqrt(length) if length > 0.0 else math.cos(i * i + 1.0)
    for i in range(n):
        once[i] = 0.0
        for j in range(n):
            once[i] += matrix[i, j] * direction[j]
    length = 0.0
    for i in range(n):
        twice[i] = 0.0
        for j in range(n):
            twice[i] += matrix[i, j] * once[j]
        length += twice[i] ** 2
    for i in range(n):
        direction[i] = twice[i] if length > 0.0 and np.isfinite(length) else 0.0
    return length ** 0.25


@merged
def step(system, state, step_size, matrix, pivots, slopes, stage, out):
    """
    Make one step with a factored Jacobian.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    state : ndarray, shape (ns,)
        Start of the step.
    step_size : float
        The one of the factors [s].
    matrix, pivots
        After ``factor_jacobian``.
    slopes : ndarray, shape (STAGES, ns)
        Written; the last one is the error estimate.
    stage : ndarray, shape (ns,)
        Scratch.
    out : ndarray, shape (ns,)
        Written in place: the state after the step.

    """
    n = state.shape[0]
    for k in range(STAGES):
        for i in range(n):
            stage[i] = state[i]
        for m in range(k):
            for i in range(n):
                stage[i] += A[k, m] * slopes[m, i]
        motion.derivative(system, stage, slopes[k])
        for m in range(k):
            for i in range(n):
                slopes[k, i] += C[k, m] / step_size * slopes[m, i]
        lu.solve(matrix, pivots, slopes[k])
    for i in range(n):
        out[i] = stage[i] + slopes[STAGES - 1, i]


@inlined
def _interpolate(state, slope, out, end, size, share, stage):
    """
    Compute a state within a step by the cubic through both states and their slopes.

    ``slope``, ``end``: at ``state`` and ``out``; ``stage``: written; all of shape (ns,).

    """
    left = 1.0 - share
    for i in range(state.shape[0]):
        rise = out[i] - state[i]
        stage[i] = left * state[i] + share * out[i] + share * left * (
            left * (size * slope[i] - rise) + share * (rise - size * end[i]))


@compiled
def advance_fixed(system, stabilisation, state, step_size, steps, matrix, pivots, scratch):
    """
    Advance a state by whole steps of one size.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    stabilisation : int
        One of ``projection``.
    state : ndarray, shape (ns,)
        Advanced in place; on failure the state before the failing step.
    step_size : float
        [s].
    steps : int
        How many.
    matrix, pivots
        Scratch.
    scratch : ndarray, shape (STAGES + FIRST_SLOPE, ns)
        Scratch.

    Returns
    -------
    status : int
        Of ``integration.advance``.
    done : int
        Steps completed.

    """
    stage, out, slope, moved, direction, start, slopes = (
        scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5],
        scratch[FIRST_SLOPE:])
    for done in range(steps):
        left, size, cuts = step_size, step_size, 0
        for i in range(state.shape[0]):
            start[i] = state[i]
        # Once, but where a joint under dry friction comes to rest within the step, or a force over
        # time has a corner.
        while left > 0.0:
            size = min(size, motion.until_corner(system, state))
            motion.derivative(system, state, slope)
            factor_jacobian(system, state, slope, size, matrix, pivots, direction, stage, moved)
            step(system, state, size, matrix, pivots, slopes, stage, out)
            closed = motion.stabilise(system, stabilisation, out)
            if not (closed and all_finite(out)):
                for i in range(state.shape[0]):
                    state[i] = start[i]
                return (OPEN_LOOP if all_finite(out) else NOT_FINITE), done
            if not motion.equations_serve(system, stabilisation, out):
                for i in range(state.shape[0]):
                    state[i] = start[i]
                return POOR_EQUATIONS, done
            left, size, cuts = taken(system, state, out, step_size, left, size, cuts)
    return DONE, steps


@compiled
def advance_adaptive(system, stabilisation, state, target, control, scale, matrix, pivots,
                     scratch):
    """
    Advance a state to a time by error-controlled steps, the last one ending there.

    Parameters
    ----------
    system, stabilisation, state, matrix, pivots, scratch
        As for ``advance_fixed``.
    target : float
        [s].
    control, scale
        As for ``adaptive.advance``.

    Returns
    -------
    int
        Status of ``integration.advance``; on failure ``state`` and REACHED are the
        latest good ones.

    """
    status = DONE
    while status == DONE and is_before(control[REACHED], target):
        status = accepted_step(system, stabilisation, state, target, control, scale, matrix,
                               pivots, scratch)
    return status


@compiled
def accepted_step(system, stabilisation, state, limit, control, scale, matrix, pivots, scratch):
    """
    Make one accepted step.

    Parameters
    ----------
    system, stabilisation, state, control, scale, matrix, pivots, scratch
        As for ``advance_adaptive``.
    limit : float
        Time that the step may reach at most [s].

    Returns
    -------
    int
        As for ``advance_adaptive``.

    """
    stage, out, slope, moved, direction, slopes = (
        scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[FIRST_SLOPE:])
    n, rest = state.shape[0], limit - control[REACHED]
    # A smaller step, at whose end a joint under dry friction comes to rest, or a force over time
    # has a corner.
    cut, cuts = motion.until_corner(system, state), 0
    size = control[NEXT_STEP] if control[NEXT_STEP] > 0.0 else 1e-4
    motion.derivative(system, state, slope)
    if not all_finite(slope):
        return NOT_FINITE
    motion.begin_contacts(system, state)
    closed, sought = True, -1
    while True:
        whole = min(size, rest)
        last, used = size >= rest and not cut < whole, min(whole, cut)
        if not used > LEAST * max(abs(limit), 1e-3):
            motion.end_contacts(system, state)
            return STEP_TOO_SMALL if closed else OPEN_LOOP
        rate = factor_jacobian(
            system, state, slope, used, matrix, pivots, direction, stage, moved)
        step(system, state, used, matrix, pivots, slopes, stage, out)
        control[WORK] += n + STAGES + 1 + n // 8
        total = 0.0
        for i in range(n):
            total += (slopes[STAGES - 1, i] / (
                scale[0, i] + scale[1, i] * max(abs(state[i]), abs(out[i])))) ** 2
        error = math.sqrt(total / n)
        factor = SAFETY * max(error, 1e-10) ** -0.25 if error < 1e30 else 0.0
        factor = min(6.0, max(0.2, factor))
        # Written so that a NaN counts as an error too large.
        if error <= 1.0 and motion.stabilise(system, stabilisation, out):
            part = motion.until_rest(system, state, out, used, max(
                stick_slip.least(whole, cuts), LEAST * max(abs(limit), 1e-3)))
            if not part < used:
                part, sought, share = motion.until_contact(system, out, used, sought, 1.0)
                if share >= 0.0:
                    motion.derivative(system, out, moved)
                while share >= 0.0:
                    _interpolate(state, slope, out, moved, used, share, stage)
                    motion.normalise(system, stage)
                    part, sought, share = motion.until_contact(system, stage, used, sought, share)
                if part == used:
                    break
                part = part if sought >= -1 else used
            else:
                motion.forget_contacts(system, state)
                sought = -1
            cut, cuts = part, cuts + 1
            continue
        closed, sought = not error <= 1.0, -1
        motion.forget_contacts(system, state)
        control[REJECTED] += 1.0
        size = used * (min(factor, SAFETY) if closed else 0.5)
    motion.end_contacts(system, state)
    if not motion.equations_serve(system, stabilisation, out):
        return POOR_EQUATIONS
    motion.rest(system, out)
    motion.pass_corners(system, out)
    for i in range(n):
        state[i] = out[i]
    control[REACHED] = limit if last else control[REACHED] + used
    control[ACCEPTED] += 1.0
    control[ERROR] = error
    control[LARGEST_ERROR] = max(control[LARGEST_ERROR], error)
    control[STIFFNESS] = rate
    # A step cut short says nothing against the size that was to be tried.
    shortened = last or cuts > 0 or cut <= used
    control[NEXT_STEP] = max(size, used * factor) if shortened else used * factor
    return DONE
