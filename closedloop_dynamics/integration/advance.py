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

from . import runge_kutta, semi_implicit_euler
from .projection import all_finite, stabilise
from .system import derivative
from ..core.compiled import compiled

# Status of ``advance`` and ``adaptive.advance``.
DONE, NOT_FINITE, OPEN_LOOP, STEP_TOO_SMALL = range(4)


@compiled
def advance(system, tableau, stabilisation, state, step_size, steps, scratch):
    """
    Advance a state by whole steps of fixed size.

    Parameters
    ----------
    system : System
        What moves.
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
    scratch : ndarray, shape (stages + 2, ns)
        Scratch, kept between calls.

    Returns
    -------
    status : int
        ``DONE``, ``NOT_FINITE`` or ``OPEN_LOOP``.
    done : int
        Steps completed.

    """
    slopes, stage, out = scratch[2:], scratch[0], scratch[1]
    for done in range(steps):
        derivative(system, state, slopes[0])
        if tableau.b.shape[0] == 0:
            semi_implicit_euler.step(state, system.qdd.shape[0], step_size, slopes[0], out)
        else:
            runge_kutta.step(system, tableau, state, step_size, slopes, stage, out)
        closed = stabilise(system, stabilisation, out)
        if not all_finite(out):
            return NOT_FINITE, done
        if not closed:
            return OPEN_LOOP, done
        for i in range(state.shape[0]):
            state[i] = out[i]
    return DONE, steps
