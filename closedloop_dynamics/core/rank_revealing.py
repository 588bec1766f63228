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
Motion and multipliers where the block elimination fails.

Entered only after a poor pivot: closure equations that repeat one another, a
singular configuration at hand, bodies without mass. The linear algebra is that of
``null_space``; this is what it is asked.

Near a singular configuration a *weak* equation, of singular value s, divides every error of the
state by s. The stages of an integrator lie beside the branch on which the mechanism moves, by the
square of the step, so that their accelerations would be noise where s is smaller than a
step. They are therefore taken on the branch: at the state beside the stage that closes
the loops. Where s is too small even for rounding, they are interpolated between
states of the branch ahead and behind, which is what continuing the velocity means: the
accelerations are smooth along a branch, though the equations lose them for an instant.

"""

import numpy as np

from . import kinematics
from .codegen.space import FORCE, SPIN
from .compiled import allocating, merged
from .forward_dynamics import constraint_right_side, to_user_order
from .jacobian import constraint_jacobian, generalized_inertia_matrix
from .joint_wrenches import tree_torque
from .loop_closure import largest, update
from .manifold import move
from .null_space import ACCELERATION, POSITION, ROUNDING, solve, VELOCITY, WEAK
from .types import (
    FZ, LOOKED_BESIDE, MOST_DISTINCT, NO_RESPONSES, OMEGA, RANK, RANK_REVEALING_COUNT,
    SINGULAR_COUNT)

# Corrections that bring a stage onto its branch: beside it by 1e-4, two leave rounding.
MOST_CORRECTIONS = 4
# Closure error, against the size of J's entries, that counts as on the branch.
SETTLED = 1e-10
# Singular values below this: rounding, divided three times by s, would show in accelerations.
CLOSE = 1e-3
# How far ahead and behind the branch is asked instead [rad]: places at -4 to 4 times this, but not
# at 0. Its eighth power is the error of the interpolation, which is nothing beside the tightest
# tolerance; that of four places, 1e-7, was found by step after step of an error-controlled method.
ASIDE = 0.015
PLACES = 8
# Smallest singular value at which a place is asked. Where many loops come to lie in one line at
# once, singular values grow slowly with the distance. The places are then taken farther away, at
# most FARTHEST times as far, asked if singular values there are BETTER times those here, and
# believed if all but the outermost tell the same: up to APART of the largest acceleration, or
# what rounding, NOISE, makes of the state's own.
ENOUGH, LEAST_ENOUGH = 2.0 * CLOSE, 0.1 * CLOSE
FARTHEST, BETTER, APART, NOISE = 8.0, 2.0, 1e-6, 1e-18


@allocating
def _fastest(work):
    """Return the largest angular velocity of any body [rad/s]."""
    most = 0.0
    for i in range(1, work.body.shape[0]):
        if work.wrench.shape[1] == 3:
            most = max(most, abs(work.body[i, OMEGA]))
        else:
            x, y, z = work.body[i, SPIN], work.body[i, SPIN + 1], work.body[i, SPIN + 2]
            most = max(most, np.sqrt(x * x + y * y + z * z))
    return most


@merged
def _solve_here(model, work, tau, beside, qdd, lam):
    """
    Compute accelerations and multipliers of the state and the forces in the workspace.

    ``beside``, shape (nc,), is added to the right-hand side. Returns what ``null_space.solve``
    does, and the largest entry of J.

    """
    nv, nc = qdd.shape[0], lam.shape[0]
    jac, gim = np.zeros((nc, nv)), np.zeros((nv, nv))
    right, psi, rate, force = np.zeros(nc), np.zeros(nc), np.zeros(nc), np.zeros(nv)
    constraint_jacobian(model, work, jac)
    update(model, work, NO_RESPONSES)
    for k in range(nc):
        work.right[k] = 0.0
    constraint_right_side(work, 0.0, work.right)
    to_user_order(model, work.right, right)
    to_user_order(model, work.closure, psi)
    to_user_order(model, work.closure_rate, rate)
    size = 0.0
    for k in range(nc):
        right[k] += beside[k]
        for i in range(nv):
            size = max(size, abs(jac[k, i]))
    for i in range(nv):
        qdd[i] = 0.0
    tree_torque(model, work, qdd, force)
    for i in range(nv):
        force[i] = tau[i] - force[i]
    generalized_inertia_matrix(model, work, gim)
    rank, weakest, distinct = solve(
        model, jac, gim, right, force, psi, rate, _fastest(work), ACCELERATION, qdd, lam)
    return rank, weakest, distinct, size


@allocating
def correct(model, work, level, out):
    """
    Compute the least change of positions or rates, in the mass metric, that closes the loops.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``kinematics.outward``, afresh.
    level : int
        ``POSITION`` or ``VELOCITY``.
    out : ndarray, shape (nv,)
        Written in place.

    """
    nv, nc = out.shape[0], work.right.shape[0]
    jac, gim = np.zeros((nc, nv)), np.zeros((nv, nv))
    psi, rate, right, lam = np.zeros(nc), np.zeros(nc), np.zeros(nc), np.zeros(nc)
    constraint_jacobian(model, work, jac)
    update(model, work, NO_RESPONSES)
    to_user_order(model, work.closure, psi)
    to_user_order(model, work.closure_rate, rate)
    for k in range(nc):
        right[k] = -psi[k] if level == POSITION else -rate[k]
    generalized_inertia_matrix(model, work, gim)
    solve(model, jac, gim, right, np.zeros(nv), psi, rate, _fastest(work), level, out, lam)


@merged
def _return_to_branch(model, work, manifold, q, qd, size):
    """Bring a state onto the branch next to it, as far as can be told; return what is left."""
    change = np.zeros(qd.shape[0])
    error = np.inf
    for count in range(MOST_CORRECTIONS + 1):
        kinematics.outward(model, q, qd, work)
        update(model, work, NO_RESPONSES)
        error = largest(work.closure)
        positions = error > ROUNDING * size and count < MOST_CORRECTIONS
        correct(model, work, POSITION if positions else VELOCITY, change)
        if not positions:
            for i in range(qd.shape[0]):
                qd[i] += change[i]
            break
        move(manifold, q, change, 1.0, 1)
    return error


@allocating
def accelerate(model, work, tau, baumgarte, aside, manifold, q, qd, qdd, lam):
    """
    Compute accelerations and multipliers, as ``forward_dynamics.accelerate`` does.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``kinematics.outward`` and the applied forces, afresh: the elimination has used
        both up. ``health`` tells the rank; what else is left in it, forces included, belongs to
        the state.
    tau, baumgarte, qdd, lam
        As for ``forward_dynamics.accelerate``.
    aside : float
        Distance of the places that are interpolated between [rad]; usually ``ASIDE``. Where
        singular values there are too small, up to FARTHEST times as much.
    manifold : Manifold or None
        Of the mechanism.
    q, qd : ndarray, shape (nq,), (nv,)
        The state.

    """
    nv, nc = qdd.shape[0], lam.shape[0]
    size_of_force = work.wrench.shape[1]
    first = FZ if size_of_force == 3 else FORCE
    last = first + size_of_force
    beside = np.zeros(nc)
    near, near_rate = np.empty(q.shape[0]), np.empty(nv)
    total, inner = np.zeros(nv), np.zeros(nv)
    found, forces = np.empty(nv), np.empty(nc)
    update(model, work, NO_RESPONSES)
    for k in range(nc):
        work.right[k] = -baumgarte * (2.0 * work.closure_rate[k] + baumgarte * work.closure[k])
    to_user_order(model, work.right, beside)
    applied = work.body[:, first:last].copy()
    health = work.health
    health[RANK_REVEALING_COUNT] += 1.0
    speed, size, error, here, close = _fastest(work), 0.0, 0.0, 0, False
    weak, few, farther, attempt = 0.0, 0, False, -1
    # First the state itself, then the branch beside it, then places around it. One call of each
    # kernel serves them all: a second one would be compiled again.
    while attempt < 1 + PLACES:
        attempt += 1
        if attempt > 0:
            ahead = (0.0 if attempt == 1 else _place(attempt - 2) * aside / speed)
            near[:], near_rate[:] = q, qd
            move(manifold, near, qd, ahead, 1)
            error = _return_to_branch(model, work, manifold, near, near_rate, size)
            kinematics.outward(model, near, near_rate, work)
            work.body[:, first:last] += applied
        rank, weakest, distinct, levers = _solve_here(model, work, tau, beside, found, forces)
        if attempt == 0:
            size, here = levers, distinct
        settled = error <= SETTLED * size
        if attempt == 0 or (attempt == 1 and close and settled and weakest >= CLOSE
                            and distinct >= health[MOST_DISTINCT]):
            health[RANK] = rank
            for i in range(nv):
                qdd[i] = found[i]
            for k in range(nc):
                lam[k] = forces[k]
            if attempt == 1:
                break
        if attempt == 0:
            close = weakest < WEAK or here < health[MOST_DISTINCT]
            if close:
                health[SINGULAR_COUNT] += 1.0
            # An ordinary place, repeated equations aside, or nothing moves.
            if not ((close or (here < nc and health[LOOKED_BESIDE] == 0.0)) and speed > 0.0):
                return
            kinematics.outward(model, q, qd, work)
            applied -= work.body[:, first:last]
        elif attempt == 1:
            # Baumgarte's terms are divided by s as well: around here by another one.
            for k in range(nc):
                beside[k] = 0.0
            weak, few = weakest, distinct
        else:
            # On the branch only: beside it equations that repeat one another seem not to.
            if settled:
                health[LOOKED_BESIDE] = 1.0
                health[MOST_DISTINCT] = max(health[MOST_DISTINCT], distinct)
            # No branch there, or none that leads out of here, or equations that are repeated
            # there, too: what was found first must do.
            if not close and here < health[MOST_DISTINCT]:
                close = True
                health[SINGULAR_COUNT] += 1.0
            if not (close and settled):
                break
            if distinct > few:
                # What vanished at the state.
                weak = 0.0
            if weakest < ENOUGH and not farther:
                # Singular values grow in proportion to the distance.
                needed = abs(_place(attempt - 2)) * (ENOUGH + weak)
                aside *= FARTHEST if needed > FARTHEST * (weakest - weak) else (
                    needed / (weakest - weak))
                farther, attempt = True, 1
                for i in range(nv):
                    total[i] = inner[i] = 0.0
                continue
            if weakest < ENOUGH and weakest < max(LEAST_ENOUGH, BETTER * weak):
                break
            place = _place(attempt - 2)
            for i in range(nv):
                total[i] += _share(place, PLACES // 2) * found[i]
                inner[i] += _share(place, PLACES // 2 - 1) * found[i]
            if attempt == 1 + PLACES:
                apart, most = 0.0, 0.0
                for i in range(nv):
                    apart = max(apart, abs(total[i] - inner[i]))
                    most = max(most, abs(total[i]))
                # Divided by s twice: the states are on the branch.
                if not farther or (
                        apart * weak * weak <= most * max(APART * weak * weak, NOISE)):
                    for i in range(nv):
                        qdd[i] = total[i]
    kinematics.outward(model, q, qd, work)
    update(model, work, NO_RESPONSES)
    work.body[:, first:last] += applied


@allocating
def _place(k):
    """Return where the k-th place around a state is, in units of the distance ``aside``."""
    half = PLACES // 2
    return float(k - half if k < half else k - half + 1)


@allocating
def _share(place, half):
    """Return the weight of a place around a state, of so many places on either side."""
    share = -1.0
    # Lagrange's polynomial: (half!)^2 / ((half - n)! (half + n)!) for the places n and -n, with
    # the sign of (-1)^(n + 1); nothing for places farther away.
    for i in range(1, int(abs(place)) + 1):
        share *= -(half - i + 1.0) / (half + i)
    return share
