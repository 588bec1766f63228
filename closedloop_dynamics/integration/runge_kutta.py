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

"""One step of any explicit Runge-Kutta method, its error estimate and its dense output."""

from . import motion
from ..core.compiled import inlined, merged


@merged
def step(system, tableau, state, step_size, slopes, stage, out):
    """
    Make one step.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    tableau : Tableau
        Of the method.
    state : ndarray, shape (ns,)
        Coordinates, rates, and what effects add.
    step_size : float
        [s].
    slopes : ndarray, shape (>= stages, ns)
        ``slopes[0]`` is the slope at ``state``; the others are written.
    stage : ndarray, shape (ns,)
        Scratch.
    out : ndarray, shape (ns,)
        Written in place: the state after the step.

    """
    steps = tableau.b.shape[0]
    for k in range(1, steps):
        combine(tableau.a[k], k, state, step_size, slopes, stage)
        motion.derivative(system, stage, slopes[k])
    combine(tableau.b, steps, state, step_size, slopes, out)


@inlined
def combine(weights, count, state, step_size, slopes, out):
    """Compute ``state`` + ``step_size`` times the first ``count`` slopes, weighted."""
    for i in range(state.shape[0]):
        out[i] = 0.0
    for k in range(count):
        weight = weights[k]
        if weight != 0.0:
            for i in range(state.shape[0]):
                out[i] += weight * slopes[k, i]
    for i in range(state.shape[0]):
        out[i] = state[i] + step_size * out[i]


@merged
def extend(system, tableau, state, step_size, slopes, stage, first):
    """Evaluate the slopes from number ``first`` on that only dense output needs."""
    for k in range(first, tableau.a.shape[0]):
        combine(tableau.a[k], k, state, step_size, slopes, stage)
        motion.derivative(system, stage, slopes[k])


@merged
def interpolate(tableau, state, step_size, slopes, share, out):
    """
    Compute the state at a share of the step.

    Parameters
    ----------
    tableau, state, step_size, slopes
        As for ``step``, after it and ``extend``.
    share : float
        0 at the start of the step, 1 at its end.
    out : ndarray, shape (ns,)
        Written in place.

    """
    for i in range(state.shape[0]):
        out[i] = state[i]
    degree = tableau.dense.shape[1]
    for k in range(tableau.dense.shape[0]):
        weight = 0.0
        for power in range(degree - 1, -1, -1):
            weight = share * (tableau.dense[k, power] + weight)
        weight *= step_size
        if weight != 0.0:
            for i in range(state.shape[0]):
                out[i] += weight * slopes[k, i]
