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

"""Project a state onto the loop closures, in the mass metric."""

import numpy as np

from .evaluation import CLOSURE_LIMIT, CLOSURE_TOLERANCE
from .motion import BY_LOOPS, CLOSE, CORRECT, FACTOR, FOLLOW_MOTIONS
from .registry import INDEPENDENT, PROJECTION, VELOCITY
from ..core import (
    articulated_inertia, elimination, forward_dynamics, kinematics, loop_closure, rank_revealing,
    refinement)
from ..core.codegen import function_table as calls
from ..core.codegen.records import call_at
from ..core.compiled import inlined, merged
from ..core.manifold import move, normalise, rates_begin
from ..core.types import CLOSURE, PROJECTION_ITERATIONS, RHS

# Newton's method doubles the digits each time: what eight corrections do not close stays open.
MOST_CORRECTIONS = 8
# Closure tolerance near a singular configuration, against the ordinary one.
SHARPER = 1e-3


@merged
def factor_by_loops(system, q, qd):
    """Do as ``factor_configuration`` does, by the kernels' loops, where nothing is unrolled."""
    model, work = system.model, system.work
    kinematics.outward(model, q, qd, work)
    # Behind the joints of the tree are cut joints.
    tau = system.tau[:system.qdd.shape[0]]
    if forward_dynamics.prepare(model, tau, work):
        return True
    kinematics.outward(model, q, qd, work)
    return refinement.prepare(model, tau, work)


@merged
def factor_configuration(system, q, qd):
    """
    Prepare corrections at a state: closure errors, responses, factors.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    q : ndarray, shape (nq,)
        Joint coordinates.
    qd : ndarray, shape (nv,)
        Their rates.

    Returns
    -------
    bool
        Whether the closure equations are independent there.

    """
    if system.moving.addresses[BY_LOOPS] != 0:
        return call_at(system.moving.addresses, FACTOR, 0, q, qd) != 0
    return (calls.call(system.table, calls.CORRECTION, q, qd) != 0
            or calls.call(system.table, calls.REFINED_CORRECTION, q, qd) != 0)


@merged
def correct_by_loops(system, level):
    """Do as ``correction`` does, by the kernels' loops, where nothing is unrolled."""
    model, work = system.model, system.work
    right = work.right
    for k in range(right.shape[0]):
        right[k] = (-work.closure[k] if level == rank_revealing.POSITION
                    else -work.closure_rate[k])
    elimination.solve(model, work, right)
    for i in range(work.body.shape[0]):
        work.body[i, RHS] = 0.0
    loop_closure.apply(model, work, right)
    articulated_inertia.outward_acceleration(model, work, system.qdd)


@merged
def correction(system, independent, level, q, qd, out):
    """
    Compute -I^-1 J^T (J I^-1 J^T)^+ times the error, the least change in the mass metric.

    Parameters
    ----------
    system : System
        After ``factor_configuration``.
    independent : bool
        What that returned.
    level : int
        ``rank_revealing.POSITION``: the error is psi; ``VELOCITY``: it is J qd.
    q : ndarray, shape (nq,)
        As for ``factor_configuration``.
    qd : ndarray, shape (nv,)
        As for ``factor_configuration``.
    out : ndarray, shape (nv,)
        Written in place; must be ``system.qdd``.

    """
    if independent and system.moving.addresses[BY_LOOPS] != 0:
        call_at(system.moving.addresses, CORRECT, level, q, qd)
    elif independent:
        row = 0 if level == rank_revealing.POSITION else 1
        for i in range(out.shape[0]):
            out[i] = system.corrections[row, i]
    elif level == rank_revealing.POSITION:
        calls.call(system.table, calls.RANK_REVEALING_POSITION, q, qd)
    else:
        calls.call(system.table, calls.RANK_REVEALING_VELOCITY, q, qd)


@merged
def project(system, q, qd, positions):
    """
    Correct rates, and positions if asked, so that the loops are closed.

    Parameters
    ----------
    system : System
        ``system.qdd`` is used as scratch.
    q : ndarray, shape (nq,)
        Corrected in place.
    qd : ndarray, shape (nv,)
        Corrected in place.
    positions : bool
        Whether q may be corrected too.

    Returns
    -------
    bool
        Whether the loops are closed, to the tolerance or, where closure equations
        are dependent, to the limit.

    """
    work, out, settings = system.work, system.qdd, system.settings
    corrections = 0
    independent = factor_configuration(system, q, qd)
    error = loop_closure.largest(work.closure)
    # Near a singular configuration a small closure error is a large one of the state.
    while positions and corrections < MOST_CORRECTIONS and error > settings[CLOSURE_TOLERANCE] * (
            1.0 if independent else SHARPER):
        correction(system, independent, rank_revealing.POSITION, q, qd, out)
        move(system.manifold, q, out, 1.0, 1)
        corrections += 1
        independent = factor_configuration(system, q, qd)
        before, error = error, loop_closure.largest(work.closure)
        if not error < 0.5 * before:
            break
    correction(system, independent, rank_revealing.VELOCITY, q, qd, out)
    for i in range(qd.shape[0]):
        qd[i] += out[i]
    work.health[PROJECTION_ITERATIONS] = corrections
    work.health[CLOSURE] = error
    return not positions or error <= settings[CLOSURE_LIMIT]


@merged
def stabilise(system, stabilisation, state):
    """
    Correct the state after a step.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    stabilisation : int
        ``NONE`` or ``BAUMGARTE`` (nothing is done), ``VELOCITY``, ``PROJECTION`` or
        ``INDEPENDENT``.
    state : ndarray, shape (ns,)
        Corrected in place.

    Returns
    -------
    bool
        Whether the loops are closed where positions were to be corrected.

    Notes
    -----
    Whatever the stabilisation, quaternions get norm 1: a projection that keeps the order of the
    method.

    """
    nv = system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    # A step leaves the unit sphere by its error.
    normalise(system.manifold, state, 1)
    if stabilisation < VELOCITY:
        return True
    if system.moving.addresses[FOLLOW_MOTIONS] != 0:
        call_at(system.moving.addresses, FOLLOW_MOTIONS, 0, state, state)
    if stabilisation == INDEPENDENT:
        return call_at(system.moving.addresses, CLOSE, 1, state, state) == 1
    return project(system, state[:nq], state[nq:nq + nv], stabilisation == PROJECTION)


@inlined
def all_finite(values):
    """Return whether no value is infinite or NaN."""
    for value in values:
        if not np.isfinite(value):
            return False
    return True
