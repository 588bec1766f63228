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
Whole runs of several mechanisms of one topology at once, one in every lane of a vector (SIMD).

The steps are those of ``fixed_step``, number by number; only the routines compute all lanes at
once. What a lane alone would do otherwise (the rank-revealing path, a failure) ends the run: its
mechanisms are then run one by one.

"""

from typing import NamedTuple, Optional

import numpy as np

from . import semi_implicit_euler
from .advance import DONE, NOT_FINITE, OPEN_LOOP
from .evaluation import BAUMGARTE_GAIN, CLOSURE_LIMIT, CLOSURE_TOLERANCE
from .projection import all_finite, MOST_CORRECTIONS
from .registry import INDEPENDENT, PROJECTION, VELOCITY
from .runge_kutta import combine
from ..core.codegen import function_table as calls, lanes
from ..core.codegen.lanes import LANES
from ..core.compiled import compiled, inlined, released
from ..core.manifold import (
    add_work, Manifold, move_lane, normalise, power_of_turns, rates_begin, rates_of_coordinates)

# Status of ``run`` beside those of ``advance``: a state that needs the rank-revealing path.
SINGULAR = 9


class Pack(NamedTuple):
    """Mechanisms of one topology in all lanes; arrays are stored lane by lane."""

    table: np.ndarray  # Of their routines
    # Shape (LANES * nv,): joint torques, accelerations.
    tau: np.ndarray
    qdd: np.ndarray
    closure: np.ndarray  # Shape (LANES * nc,): closure errors of the latest correction
    corrections: np.ndarray  # Shape (2, LANES * nv): of coordinates and rates
    # Shape (LANES,): closure error that projection leaves, and the one at which it gives up.
    tolerance: np.ndarray
    limit: np.ndarray
    error: np.ndarray  # Shape (LANES,): largest closure error of each
    moving: np.ndarray  # Shape (LANES,): whose coordinates are still corrected
    manifold: Optional[Manifold]  # Of all of them
    kept: tuple  # Tuple of ndarrays: what only the routines read and write


def fits(system, stabilisation):
    """
    Tell whether a system may take a lane.

    Returns
    -------
    bool
        False where nothing is unrolled or effects act by laws of their own.

    """
    return system.is_bare and stabilisation != INDEPENDENT


def build_pack(systems):
    """
    Allocate a pack.

    Returns
    -------
    Pack or None
        None where the systems cannot go together.

    """
    # Here, as there may be no compiler.
    from ..core.codegen.routines import topology
    systems = filled(systems)
    first = systems[0]
    settings = np.array([system.settings for system in systems])
    shape = topology(first.model)
    if (settings[:, BAUMGARTE_GAIN] != settings[0, BAUMGARTE_GAIN]).any() or any(
            topology(system.model) != shape for system in systems if system is not first):
        return None
    nv, nc = len(first.qdd), len(first.lam)
    arrays = lanes.allocate([system.model for system in systems], (nv, nc),
                            settings[0, BAUMGARTE_GAIN:BAUMGARTE_GAIN + 1].copy())
    return Pack(
        table=lanes.connect(first.model, arrays), tau=arrays[calls.TAU],
        qdd=arrays[calls.QDD], closure=arrays[calls.CLOSURE],
        corrections=arrays[calls.CORRECTIONS].reshape(2, -1),
        tolerance=settings[:, CLOSURE_TOLERANCE].copy(), limit=settings[:, CLOSURE_LIMIT].copy(),
        error=np.zeros(LANES), moving=np.zeros(LANES, dtype=np.bool_),
        manifold=first.manifold,
        kept=tuple(arrays.values()))


def filled(items):
    """Return one item for every lane."""
    return [*items, *[items[-1]] * (LANES - len(items))]


@inlined
def _derivative(manifold, table, tau, qdd, state, out):
    """Compute the time derivatives of all lanes; return whether the results are good."""
    n, nv = qdd.shape[0], qdd.shape[0] // LANES
    first = LANES * rates_begin(manifold, nv)
    good = calls.call(table, calls.EVALUATION, state[:first], state[first:first + n])
    rates_of_coordinates(manifold, state, nv, out, LANES)
    for i in range(n):
        out[first + i] = qdd[i]
    power_of_turns(manifold, tau, state, nv, out, LANES)
    return good != 0


@inlined
def _step(manifold, table, tau, qdd, tableau, state, step_size, slopes, stage, out):
    """Make one step; return whether all evaluations were good."""
    if not _derivative(manifold, table, tau, qdd, state, slopes[0]):
        return False
    stages = tableau.b.shape[0]
    if stages == 0:
        semi_implicit_euler.step(
            manifold, state, qdd.shape[0] // LANES, step_size, slopes[0], out, LANES)
        return True
    for k in range(1, stages):
        combine(tableau.a[k], k, state, step_size, slopes, stage)
        if not _derivative(manifold, table, tau, qdd, stage, slopes[k]):
            return False
    combine(tableau.b, stages, state, step_size, slopes, out)
    return True


@inlined
def _measure(closure, error):
    """Find the largest closure error of every lane; guards have excluded NaN."""
    for lane in range(LANES):
        error[lane] = 0.0
    for k in range(closure.shape[0] // LANES):
        for lane in range(LANES):
            error[lane] = max(error[lane], abs(closure[LANES * k + lane]))


@inlined
def _project(pack, q, qd, positions):
    """Do as ``projection.project`` does, in every lane; return a status."""
    error, moving, tolerance = pack.error, pack.moving, pack.tolerance
    n = pack.qdd.shape[0]
    if calls.call(pack.table, calls.CORRECTION, q, qd) == 0:
        return SINGULAR
    _measure(pack.closure, error)
    busy = False
    for lane in range(LANES):
        moving[lane] = positions and error[lane] > tolerance[lane]
        busy = busy or moving[lane]
    for _ in range(MOST_CORRECTIONS):
        if not busy:
            break
        _correct(pack.manifold, q, pack.corrections[0], moving)
        if calls.call(pack.table, calls.CORRECTION, q, qd) == 0:
            return SINGULAR
        busy = _go_on(pack.closure, error, moving, tolerance)
    for i in range(n):
        qd[i] += pack.corrections[1, i]
    for lane in range(LANES):
        if positions and not error[lane] <= pack.limit[lane]:
            return OPEN_LOOP
    return DONE


@inlined
def _correct(manifold, q, change, moving):
    """Correct the coordinates of the lanes that want it."""
    if manifold is None:
        for k in range(q.shape[0] // LANES):
            for lane in range(LANES):
                i = LANES * k + lane
                q[i] = q[i] + change[i] if moving[lane] else q[i]
    else:
        for lane in range(LANES):
            if moving[lane]:
                _move_lane(manifold, q, change, lane)


@compiled
def _move_lane(manifold, q, change, lane):
    """Change the coordinates of one lane."""
    move_lane(manifold, q, change, 1.0, LANES, lane)


@inlined
def _go_on(closure, error, moving, tolerance):
    """Find the lanes whose coordinates want another correction; return whether any does."""
    busy = False
    for lane in range(LANES):
        before, error[lane] = error[lane], 0.0
        for k in range(closure.shape[0] // LANES):
            error[lane] = max(error[lane], abs(closure[LANES * k + lane]))
        moving[lane] = (moving[lane] and error[lane] < 0.5 * before
                        and error[lane] > tolerance[lane])
        busy = busy or moving[lane]
    return busy


@inlined
def _note(state, position, velocity, instant):
    """Write one instant."""
    nq = position.shape[2]
    for lane in range(LANES):
        for k in range(nq):
            position[lane, instant, k] = state[LANES * k + lane]
        for k in range(velocity.shape[2]):
            velocity[lane, instant, k] = state[LANES * (nq + k) + lane]


@released
def run(pack, tableau, stabilisation, state, step_size, torque, zero_order_hold, decimation, steps,
        scratch, position, velocity, work):
    """
    Make whole runs of fixed steps in all lanes.

    Parameters
    ----------
    pack : Pack
        Mechanisms in all lanes.
    tableau, stabilisation, step_size, zero_order_hold, decimation, steps
        As for ``fixed_step.run``.
    state : ndarray, shape (LANES * ns,)
        At the start; advanced in place.
    torque : ndarray, shape (rows, LANES * nv)
        Joint torques, one row after the other.
    scratch : ndarray, shape (stages + 3, LANES * ns)
        Scratch.
    position : ndarray, shape (LANES, instants, nq)
        Written in place, for each mechanism apart.
    velocity : ndarray, shape (LANES, instants, nv)
        Likewise.
    work : ndarray, shape (LANES,)
        Written in place: of the torques [J].

    Returns
    -------
    int
        ``DONE``; or why all must be run one by one.

    """
    slopes, stage, out, since = scratch[3:], scratch[0], scratch[1], scratch[2]
    n, manifold = pack.qdd.shape[0], pack.manifold
    first = LANES * rates_begin(manifold, n // LANES)
    _note(state, position, velocity, 0)
    for lane in range(LANES):
        work[lane] = 0.0
    for i in range(state.shape[0]):
        since[i] = state[i]
    for done in range(steps):
        if done % zero_order_hold == 0:
            _work(manifold, pack.tau, state, since, work)
            for i in range(n):
                pack.tau[i] = torque[done // zero_order_hold, i]
        if not _step(manifold, pack.table, pack.tau, pack.qdd, tableau, state, step_size,
                     slopes, stage, out):
            return SINGULAR
        normalise(manifold, out, LANES)
        if stabilisation >= VELOCITY:
            status = _project(
                pack, out[:first], out[first:first + n], stabilisation == PROJECTION)
            if status != DONE:
                return status
        if not all_finite(out):
            return NOT_FINITE
        for i in range(out.shape[0]):
            state[i] = out[i]
        if (done + 1) % decimation == 0:
            _note(state, position, velocity, (done + 1) // decimation)
    _work(manifold, pack.tau, state, since, work)
    return DONE


@inlined
def _work(manifold, tau, state, since, work):
    """Add the work of the torques held since the last call."""
    add_work(manifold, tau, since, state, LANES, work)
    for i in range(state.shape[0]):
        since[i] = state[i]
