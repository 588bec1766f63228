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
from .compiled import allocating
from .forward_dynamics import constraint_right_side, to_user_order
from .inverse_dynamics import tree_torque
from .jacobian import constraint_jacobian, generalized_inertia_matrix
from .loop_closure import update
from .null_space import ACCELERATION, POSITION, ROUNDING, solve, VELOCITY, WEAK
from .types import FX, FY, FZ, OMEGA, RANK, RANK_REVEALING_COUNT

# Corrections that bring a stage onto its branch: beside it by 1e-4, two leave rounding.
MOST_CORRECTIONS = 4
# Closure error, against the size of J's entries, that counts as on the branch.
SETTLED = 1e-10
# Singular values below this: rounding, divided three times by s, would show in accelerations.
CLOSE = 1e-3
# How far ahead and behind the branch is asked instead [rad], by cubic interpolation: places at
# -2, -1, 1 and 2 times this, with these weights. Its fourth power is the error.
ASIDE = 0.03
OUTER, INNER = -1.0 / 6.0, 4.0 / 6.0


@allocating
def _fastest(work):
    """Return the largest angular velocity of any body [rad/s]."""
    most = 0.0
    for i in range(1, work.body.shape[0]):
        most = max(most, abs(work.body[i, OMEGA]))
    return most


@allocating
def _largest(values):
    """Return the largest absolute value, NaN if there is one."""
    most = 0.0
    for value in values:
        if not abs(value) <= most:
            most = abs(value)
    return most


@allocating
def _solve_here(model, work, tau, beside, qdd, lam):
    """
    Compute accelerations and multipliers of the state and the forces in the workspace.

    ``beside``, shape (nc,), is added to the right-hand side. Returns rank and weakest singular
    value as ``null_space.solve`` does, and the largest entry of J.

    """
    nv, nc = qdd.shape[0], lam.shape[0]
    jac, gim = np.zeros((nc, nv)), np.zeros((nv, nv))
    right, psi, rate, force = np.zeros(nc), np.zeros(nc), np.zeros(nc), np.zeros(nv)
    constraint_jacobian(model, work, jac)
    update(model, work, False)
    for k in range(nc):
        work.right[k] = 0.0
    constraint_right_side(work, 0.0, work.right)
    to_user_order(model, work.right, right)
    to_user_order(model, work.closure, psi)
    to_user_order(model, work.closure_rate, rate)
    largest = 0.0
    for k in range(nc):
        right[k] += beside[k]
        largest = max(largest, _largest(jac[k]))
    for i in range(nv):
        qdd[i] = 0.0
    tree_torque(model, work, qdd, force)
    for i in range(nv):
        force[i] = tau[i] - force[i]
    generalized_inertia_matrix(model, work, gim)
    rank, weakest = solve(
        model, jac, gim, right, force, psi, rate, _fastest(work), ACCELERATION, qdd, lam)
    return rank, weakest, largest


@allocating
def accelerate(model, work, tau, baumgarte, q, qd, qdd, lam):
    """
    Compute accelerations and multipliers, as ``forward_dynamics.accelerate`` does.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``kinematics.outward`` and the applied forces, afresh: the elimination has used
        both up. ``health`` tells the rank; what else is left in it belongs to the state, too.
    tau, baumgarte, qdd, lam
        As for ``forward_dynamics.accelerate``.
    q, qd : ndarray, shape (nv,)
        The state.

    """
    nv, nc = qdd.shape[0], lam.shape[0]
    beside = np.zeros(nc)
    update(model, work, False)
    for k in range(nc):
        work.right[k] = -baumgarte * (2.0 * work.closure_rate[k] + baumgarte * work.closure[k])
    to_user_order(model, work.right, beside)
    applied = np.empty((work.body.shape[0], 3))
    for i in range(applied.shape[0]):
        applied[i, 0], applied[i, 1], applied[i, 2] = (
            work.body[i, FZ], work.body[i, FX], work.body[i, FY])
    rank, weakest, size = _solve_here(model, work, tau, beside, qdd, lam)
    work.health[RANK] = rank
    work.health[RANK_REVEALING_COUNT] += 1.0
    speed = _fastest(work)
    if weakest >= WEAK or not speed > 0.0:
        return
    kinematics.outward(model, q, qd, work)
    for i in range(applied.shape[0]):
        applied[i, 0] -= work.body[i, FZ]
        applied[i, 1] -= work.body[i, FX]
        applied[i, 2] -= work.body[i, FY]
    # On the branch, or, too close to the singular configuration, around it.
    near, near_rate = np.empty(nv), np.empty(nv)
    found, forces = np.empty(nv), np.empty(nc)
    count, weakest = _solve_beside(
        model, work, tau, beside, q, qd, 0.0, applied, size, near, near_rate, found, forces)
    if weakest >= CLOSE:
        work.health[RANK] = count
        for i in range(nv):
            qdd[i] = found[i]
        for k in range(nc):
            lam[k] = forces[k]
    else:
        total, clear = np.zeros(nv), True
        for k in range(nc):
            beside[k] = 0.0
        for place, share in ((-2.0, OUTER), (-1.0, INNER), (1.0, INNER), (2.0, OUTER)):
            if clear:
                count, weakest = _solve_beside(
                    model, work, tau, beside, q, qd, place * ASIDE / speed, applied, size, near,
                    near_rate, found, forces)
                clear = weakest >= 2.0 * CLOSE
                for i in range(nv):
                    total[i] += share * found[i]
        for i in range(nv):
            qdd[i] = total[i] if clear else qdd[i]
    kinematics.outward(model, q, qd, work)
    update(model, work, False)


@allocating
def _solve_beside(model, work, tau, beside, q, qd, time, applied, size, near, near_rate, qdd, lam):
    """
    Compute accelerations on the branch, ``time`` ahead of a state and under its forces.

    Returns rank and weakest singular value; of this zero where no branch is found.

    """
    for i in range(q.shape[0]):
        near[i], near_rate[i] = q[i] + time * qd[i], qd[i]
    error = _settle(model, work, near, near_rate, size)
    kinematics.outward(model, near, near_rate, work)
    for i in range(applied.shape[0]):
        work.body[i, FZ] += applied[i, 0]
        work.body[i, FX] += applied[i, 1]
        work.body[i, FY] += applied[i, 2]
    rank, weakest, _ = _solve_here(model, work, tau, beside, qdd, lam)
    # Written so that a NaN counts as none.
    return rank, weakest if error <= SETTLED * size else 0.0


@allocating
def _settle(model, work, q, qd, size):
    """Bring a state onto the branch next to it, as far as can be told; return what is left."""
    change = np.zeros(q.shape[0])
    for _ in range(MOST_CORRECTIONS):
        kinematics.outward(model, q, qd, work)
        update(model, work, False)
        if _largest(work.closure) <= ROUNDING * size:
            break
        correct(model, work, POSITION, change)
        for i in range(q.shape[0]):
            q[i] += change[i]
    kinematics.outward(model, q, qd, work)
    correct(model, work, VELOCITY, change)
    for i in range(q.shape[0]):
        qd[i] += change[i]
    return _largest(work.closure)


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
    psi, rate, lam = np.zeros(nc), np.zeros(nc), np.zeros(nc)
    constraint_jacobian(model, work, jac)
    update(model, work, False)
    to_user_order(model, work.closure, psi)
    to_user_order(model, work.closure_rate, rate)
    generalized_inertia_matrix(model, work, gim)
    solve(model, jac, gim, -psi if level == POSITION else -rate, np.zeros(nv), psi, rate,
          _fastest(work), level, out, lam)
