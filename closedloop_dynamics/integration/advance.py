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

from . import rk4, semi_implicit_euler
from ..core.compiled import compiled
from .projection import all_finite, project

# Integrators and stabilisations by the names that a scene gives them.
SEMI_IMPLICIT_EULER, RK4 = range(2)
INTEGRATORS = {'semi_implicit_euler': SEMI_IMPLICIT_EULER, 'rk4': RK4}
NONE, BAUMGARTE, PROJECTION = range(3)
STABILISATIONS = {'none': NONE, 'baumgarte': BAUMGARTE, 'projection': PROJECTION}
STAGES = max(rk4.STAGES, semi_implicit_euler.STAGES)

# Status of ``advance``.
DONE, NOT_FINITE, OPEN_LOOP = range(3)


@compiled
def advance(system, integrator, stabilisation, q, qd, step_size, steps, stages):
    """
    Advance a state by whole steps.

    Parameters
    ----------
    system : System
    integrator, stabilisation : int
        Values of ``INTEGRATORS`` and ``STABILISATIONS``.
    q, qd : ndarray, shape (nv,)
        Advanced in place; on failure the state before the failing step.
    step_size : float
        [s].
    steps : int
    stages : ndarray, shape (STAGES + 2, nv)
        Scratch; the last two rows keep the state before the step.

    Returns
    -------
    status : int
        ``DONE``, ``NOT_FINITE`` or ``OPEN_LOOP``.
    done : int
        Steps completed.

    """
    nv = q.shape[0]
    for done in range(steps):
        for i in range(nv):
            stages[STAGES, i] = q[i]
            stages[STAGES + 1, i] = qd[i]
        if integrator == RK4:
            rk4.step(system, q, qd, step_size, stages)
        else:
            semi_implicit_euler.step(system, q, qd, step_size, stages)
        closed = True
        if stabilisation == PROJECTION:
            closed = project(system, q, qd, True)
        finite = all_finite(q) and all_finite(qd)
        if not (finite and closed):
            for i in range(nv):
                q[i] = stages[STAGES, i]
                qd[i] = stages[STAGES + 1, i]
            return (OPEN_LOOP if finite else NOT_FINITE), done
    return DONE, steps
