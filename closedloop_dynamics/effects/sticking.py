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
Joints that dry friction holds at rest: what holds them, and how they come to rest.

Between rigid bodies, friction at rest is whatever keeps the joint at rest, up to its limit F:

    a = a_0 + W tau,     a_i = 0 with |tau_i| <= F_i,  or  tau_i = -F_i sign(a_i)

for the accelerations a of all joints at rest; a_0 are those without their friction, W is the
response of the mechanism, its loops closed. These are the conditions of a convex problem,
min tau W tau / 2 + a_0 tau in a box, so that a is unique, even where several joints share
one freedom and tau is not. A rotor of inertia I at a cut joint is one more unknown without bounds,
tau = -I a: it adds tau^2 / (2 I) to what is least.

"""

import math

from .table import CUT_ROTOR, FIRST
from ..core.compiled import compiled, inlined

# Rates below this are rest while a step is made [rad/s; m/s]; wide enough for the finite
# differences that stiff methods and rate estimates take.
REST = 1e-6
# Joints whose responses agree to this share one freedom: the first of them bears its load.
DEPENDENT = 1e-8
# Accelerations below this part of what they are a sum of are rounding.
ROUNDING = 1e-10
# Changes of the active set, for each joint; more are a circle among equals.
MOST_CHANGES = 5


@compiled
def solve(sticking, count, out):
    """
    Minimise x matrix x / 2 + right x in a box, by the active-set method.

    Parameters
    ----------
    sticking : Sticking
        ``matrix`` (symmetric, positive semidefinite), ``right``, and ``bound``: the largest
        magnitude of each unknown; zero leaves it out.
    count : int
        Number of unknowns.
    out : ndarray, shape (nf,)
        Written in place.

    Notes
    -----
    Nocedal and Wright, Numerical Optimization, 2nd ed. (2006), section 16.5.

    """
    matrix, bound, free, move = sticking.matrix, sticking.bound, sticking.free, sticking.move
    for a in range(count):
        out[a] = 0.0
        free[a] = 1 if bound[a] > 0.0 and matrix[a, a] > 0.0 else 0
    for _ in range(MOST_CHANGES * (count + 1)):
        _move(sticking, count, out)
        share, blocking = 1.0, -1
        for a in range(count):
            if abs(out[a] + move[a]) > bound[a] and free[a] == 1:
                most = (math.copysign(bound[a], move[a]) - out[a]) / move[a]
                if most < share:
                    share, blocking = most, a
        for a in range(count):
            out[a] += share * move[a]
        if blocking >= 0:
            free[blocking] = 0
            out[blocking] = math.copysign(bound[blocking], move[blocking])
        else:
            loose = _loose(sticking, count, out)
            if loose < 0:
                return
            free[loose] = 1


@compiled
def _move(sticking, count, out):
    """Compute the move to the minimum in the free unknowns, by a factorization L D L^T."""
    matrix, factor, free, move = sticking.matrix, sticking.factor, sticking.free, sticking.move
    for a in range(count):
        move[a] = -sticking.right[a] * free[a]
        for b in range(count):
            move[a] -= matrix[a, b] * out[b] * free[a]
        for b in range(a + 1):
            entry = matrix[a, b] * free[a] * free[b]
            for c in range(b):
                entry -= factor[a, c] * factor[b, c] * factor[c, c]
            if b == a:
                factor[a, a] = entry if entry > DEPENDENT * matrix[a, a] else 0.0
            else:
                factor[a, b] = entry / factor[b, b] if factor[b, b] > 0.0 else 0.0
        for b in range(a):
            move[a] -= factor[a, b] * move[b]
    for a in range(count - 1, -1, -1):
        move[a] = move[a] / factor[a, a] if factor[a, a] > 0.0 else 0.0
        for b in range(a + 1, count):
            move[a] -= factor[b, a] * move[b]


@compiled
def _loose(sticking, count, out):
    """Return which unknown wants to leave its bound most; less than zero if none does."""
    loose, strongest = -1, 0.0
    for a in range(count):
        if sticking.free[a] == 1 or out[a] == 0.0:
            continue
        slope, size = sticking.right[a], abs(sticking.right[a])
        for b in range(count):
            slope += sticking.matrix[a, b] * out[b]
            size += abs(sticking.matrix[a, b] * out[b])
        pull = math.copysign(slope, slope * out[a])
        if pull > ROUNDING * size and pull * pull > strongest * sticking.matrix[a, a]:
            loose, strongest = a, pull * pull / sticking.matrix[a, a]
    return loose


@inlined
def keep(table, qdd, lam):
    """Keep accelerations and multipliers without the friction of the joints at rest."""
    base, nv = table.sticking.response[table.sticking.response.shape[0] - 1], qdd.shape[0]
    for i in range(nv):
        base[i] = qdd[i]
    for i in range(lam.shape[0]):
        base[nv + i] = lam[i]


@inlined
def respond(table, place, qdd, lam):
    """
    Take the response to the limit of one friction.

    Parameters
    ----------
    table : EffectTable
        After an evaluation with that friction in ``hold``.
    place : int
        Of the friction among the joints at rest.
    qdd, lam : ndarray
        Of that evaluation.

    """
    sticking, nv = table.sticking, qdd.shape[0]
    base, response = sticking.response[sticking.response.shape[0] - 1], sticking.response[place]
    for i in range(nv):
        response[i] = qdd[i] - base[i]
    for i in range(lam.shape[0]):
        response[nv + i] = lam[i] - base[nv + i]
    row = sticking.rows[place + 1]
    table.applied[table.index[row, FIRST]] -= sticking.hold[row]
    sticking.hold[row] = 0.0


@inlined
def balance(table, qdd, lam):
    """
    Find the friction at rest, and the accelerations and multipliers with it.

    Parameters
    ----------
    table : EffectTable
        After ``keep`` and ``respond``. ``applied`` and the readings are completed.
    qdd, lam : ndarray
        Written in place.

    """
    sticking, nv = table.sticking, qdd.shape[0]
    count, response = sticking.rows[0], sticking.response
    base = response[response.shape[0] - 1]
    for a in range(count):
        row = sticking.rows[a + 1]
        joint, limit = table.index[row, FIRST], table.output[row, 3]
        sticking.right[a] = limit * base[joint]
        sticking.bound[a] = 1.0
        for b in range(count):
            sticking.matrix[a, b] = limit * response[b, joint]
        if table.kind[row] == CUT_ROTOR:
            # Its limit is its inertia: the force of a unit acceleration.
            sticking.bound[a] = math.inf
            sticking.matrix[a, a] += limit
    solve(sticking, count, sticking.share)
    for i in range(nv):
        qdd[i] = base[i]
    for i in range(lam.shape[0]):
        lam[i] = base[nv + i]
    for a in range(count):
        row, share = sticking.rows[a + 1], sticking.share[a]
        friction = share * table.output[row, 3]
        table.applied[table.index[row, FIRST]] += friction
        table.output[row, 1] = friction
        for i in range(nv):
            qdd[i] += share * response[a, i]
        for i in range(lam.shape[0]):
            lam[i] += share * response[a, nv + i]
    for a in range(count):
        if _holds(table, a):
            qdd[table.index[sticking.rows[a + 1], FIRST]] = 0.0


@compiled
def _holds(table, place):
    """Return whether a joint at rest stays there."""
    sticking = table.sticking
    return (table.kind[sticking.rows[place + 1]] != CUT_ROTOR
            and abs(sticking.share[place]) < 1.0 and sticking.matrix[place, place] > 0.0)


@inlined
def stop(table, qd):
    """
    Take what is left of their rates from the joints that stay at rest, by an impulse.

    ``qd``: shape (nv,); joint rates, corrected in place.

    """
    sticking = table.sticking
    count = sticking.rows[0]
    for a in range(count):
        row = sticking.rows[a + 1]
        sticking.right[a] = table.output[row, 3] * qd[table.index[row, FIRST]]
        sticking.bound[a] = math.inf if _holds(table, a) else 0.0
    solve(sticking, count, sticking.impulse)
    for a in range(count):
        for i in range(qd.shape[0]):
            qd[i] += sticking.impulse[a] * sticking.response[a, i]
    for a in range(count):
        if sticking.bound[a] > 0.0:
            qd[table.index[sticking.rows[a + 1], FIRST]] = 0.0
