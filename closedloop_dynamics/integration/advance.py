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

"""Whole steps of a chosen scheme with a chosen stabilisation, compiled as one loop."""

from . import motion, runge_kutta, stick_slip
from .projection import all_finite
from ..core.compiled import compiled, inlined

# Status of ``advance`` and ``adaptive.advance``.
DONE, NOT_FINITE, OPEN_LOOP, STEP_TOO_SMALL, TOO_MUCH_WORK, POOR_EQUATIONS = range(6)


@compiled
def advance(system, tableau, stabilisation, state, step_size, steps, scratch):
    """
    Advance a state by whole steps of fixed size.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    tableau : Tableau
        One without weights (order 1) stands for semi-implicit Euler.
    stabilisation : int
        One of ``projection``.
    state : ndarray, shape (ns,)
        Advanced in place; on failure the state before the failing step.
    step_size : float
        [s].
    steps : int
        How many.
    scratch : ndarray, shape (stages + 3, ns)
        Scratch, kept between calls.

    Returns
    -------
    status : int
        ``DONE``, ``NOT_FINITE``, ``OPEN_LOOP`` or ``POOR_EQUATIONS``.
    done : int
        Steps completed.

    """
    stage, out, start, slopes = scratch[0], scratch[1], scratch[2], scratch[3:]
    for done in range(steps):
        left, size, cuts = step_size, step_size, 0
        for i in range(state.shape[0]):
            start[i] = state[i]
        # Once, but where a joint under dry friction comes to rest within the step, or a force over
        # time has a corner.
        while left > 0.0:
            size = min(size, motion.until_corner(system, state))
            motion.derivative(system, state, slopes[0])
            if tableau.b.shape[0] == 0:
                motion.semi_implicit_step(system, state, size, slopes[0], out)
            else:
                runge_kutta.step(system, tableau, state, size, slopes, stage, out)
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


@inlined
def taken(system, state, out, step_size, left, size, cuts):
    """
    Take a part of a step, or find that it must be shorter as a joint turns round within it.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    state, out : ndarray, shape (ns,)
        Before and after the part; where it is taken, the state is advanced.
    step_size : float
        Of the whole step [s].
    left, size : float
        What is left of the step, and the part [s].
    cuts : int
        How often the step has been cut.

    Returns
    -------
    left, size : float
        What is left then, and the next part [s].
    cuts : int

    """
    part = motion.until_rest(
        system, state, out, size, stick_slip.least(step_size, cuts))
    if part < size:
        return left, part, cuts + 1
    motion.rest(system, out)
    motion.pass_corners(system, out)
    for i in range(state.shape[0]):
        state[i] = out[i]
    left -= size
    if left <= stick_slip.LEAST_PART * step_size:
        left = 0.0
    return left, left, cuts
