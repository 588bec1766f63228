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
Motion and least-norm multipliers from equations that may be dependent.

The null-space method: with the singular value decomposition of J (its rows and
columns scaled by their levers, so that neither units nor masses decide what is
small), the equations fix the coordinates along the strong right singular
vectors; along the others the equations of motion decide (Gauss's principle of
least constraint). I is never inverted, so that it may be singular as long as
the motions that the loops allow carry inertia. Dense, O(n^3).

"""

import numpy as np

from .compiled import allocating
from .types import CUT_ROW, DOF, LENGTHS, PRISMATIC, ROWS, TYPE

# What is asked for: a change of positions, of rates, or accelerations.
POSITION, VELOCITY, ACCELERATION = range(3)

# Singular values of the scaled J below this times the largest are rounding: equations that
# repeat others.
DEPENDENT = 1e-11
# Those below this belong to a singular configuration nearby: whether such an equation is
# taken depends on whether what it says can be told from its error.
WEAK = 0.1
# Rounding of scaled places and terms.
ROUNDING = 2e-15
# What an equation says must exceed its estimated error by this factor.
DOUBT = 3.0
# Entries of J against the largest: less is the rounding of a zero, not to be scaled up.
NOTHING = 1e-12
# Inertia of a motion against the largest: less is none.
NO_INERTIA = 1e-14


@allocating
def scales(model, jac, row_scale, column_scale):
    """
    Scale J so that neither units nor the sizes of loops decide what is small.

    Turns are scaled by the longest lever of any turn in the same loops, slides are not; then
    each cut joint by its largest entry. The lever of the turn itself would hide that it vanishes
    in a singular configuration. The equations of a cut point share their scale, so
    that the direction of the world's axes makes no difference.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    jac : ndarray, shape (nc, nv)
        Constraint Jacobian.
    row_scale : ndarray, shape (nc,)
        Written in place.
    column_scale : ndarray, shape (nv,)
        Written in place.

    """
    nv, tree, cut = jac.shape[1], model.tree, model.cut
    lever = np.zeros(nv)
    longest = 0.0
    for a in range(cut.shape[0]):
        first = cut[a, CUT_ROW]
        last = first + cut[a, LENGTHS]
        here = 0.0
        for body in range(1, tree.shape[0]):
            if tree[body, TYPE] != PRISMATIC:
                for i in range(first, last):
                    here = max(here, abs(jac[i, tree[body, DOF]]))
        longest = max(longest, here)
        for i in range(first, last):
            for j in range(nv):
                if abs(jac[i, j]) > NOTHING * here:
                    lever[j] = max(lever[j], here)
    for body in range(1, tree.shape[0]):
        j = tree[body, DOF]
        if tree[body, TYPE] == PRISMATIC:
            lever[j] = 1.0
        elif lever[j] == 0.0:
            lever[j] = longest if longest > 0.0 else 1.0
        column_scale[j] = 1.0 / lever[j]
    for a in range(cut.shape[0]):
        first, rows = cut[a, CUT_ROW], cut[a, ROWS]
        together = cut[a, LENGTHS]
        for begin, end in ((first, first + together), (first + together, first + rows)):
            most = 0.0
            for i in range(begin, end):
                for j in range(nv):
                    most = max(most, abs(jac[i, j]) * column_scale[j])
            for i in range(begin, end):
                row_scale[i] = 1.0 / most if most > NOTHING else 1.0


@allocating
def _motion(taken, singular, right_vectors, wanted, column_scale, gim, force, out):
    """
    Find the motion that the taken equations and, beyond them, least constraint ask for.

    Returns whether every motion that is left carries inertia or needs none.

    """
    nv = gim.shape[0]
    strong = np.zeros(nv)
    free = np.zeros((nv, nv))
    count = 0
    for k in range(nv):
        if k < taken.shape[0] and taken[k]:
            share = wanted[k] / singular[k]
            for j in range(nv):
                strong[j] += right_vectors[k, j] * share * column_scale[j]
        else:
            for j in range(nv):
                free[count, j] = right_vectors[k, j] * column_scale[j]
            count += 1
    for j in range(nv):
        out[j] = strong[j]
    if count == 0:
        return True
    basis = np.ascontiguousarray(free[:count])
    inertia = basis @ (gim @ basis.T)
    push = basis @ (force - gim @ strong)
    root = np.ones(count)
    for k in range(count):
        if inertia[k, k] > 0.0:
            root[k] = 1.0 / np.sqrt(inertia[k, k])
    for k in range(count):
        for j in range(count):
            inertia[k, j] *= root[k] * root[j]
    values, vectors = np.linalg.eigh(inertia)
    push = vectors.T @ (push * root)
    determined = True
    largest_push = np.abs(push).max()
    for k in range(count):
        if values[k] > NO_INERTIA * values[count - 1]:
            push[k] /= values[k]
        else:
            determined = determined and abs(push[k]) <= 1e-9 * largest_push
            push[k] = 0.0
    motion = basis.T @ ((vectors @ push) * root)
    for j in range(nv):
        out[j] += motion[j]
    return determined


@allocating
def _worth_taking(level, singular, residual, gap, drift, gap_along, drift_along, speed, size):
    """
    Decide on one equation near a singular configuration.

    Parameters
    ----------
    level : int
        ``POSITION``, ``VELOCITY`` or ``ACCELERATION``.
    singular : float
        Its scaled singular value: about the angle to the singular configuration.
    residual : float
        How far the motion without it violates it.
    gap, drift : float
        Closure error of the positions, and of the rates (scaled).
    gap_along, drift_along : float
        Their shares in this equation.
    speed : float
        Largest angular velocity [rad/s].
    size : float
        Size of the motion's terms.

    Notes
    -----
    Along the weak direction the position is known to gap / singular, or, as closure
    is quadratic there, to sqrt(gap), and the rate to drift / singular. Where the
    equation's turning with that error explains the residual, taking it would divide noise by
    a small number; left out for a step, it is made up for by the projection. A correction of
    positions beyond the reach of Newton's method, the singular value itself, would jump to
    another branch.

    """
    if level == POSITION:
        return residual <= 0.25 * singular * singular
    gap_along += ROUNDING
    known = gap + min(gap_along / singular, np.sqrt(gap_along))
    if level == VELOCITY:
        error = speed * known + ROUNDING * (speed + size)
    else:
        error = speed * (speed * known + 2.0 * (drift + drift_along / singular)) + ROUNDING * (
            speed * speed + size)
    return residual > DOUBT * error


@allocating
def solve(model, jac, gim, right, force, psi, rate, speed, level, motion, lam):
    """
    Solve J x = right, I x = force + J^T lambda with the equations that can be told apart.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    jac : ndarray, shape (nc, nv)
        Constraint Jacobian.
    gim : ndarray, shape (nv, nv)
        Inertia matrix of the trees.
    right : ndarray, shape (nc,)
        Right-hand side of the closure equations.
    force : ndarray, shape (nv,)
        Right-hand side of the equations of motion.
    psi, rate : ndarray, shape (nc,)
        Closure errors of the positions, and of the rates.
    speed : float
        Largest angular velocity [rad/s].
    level : int
        ``POSITION``, ``VELOCITY`` or ``ACCELERATION``.
    motion : ndarray, shape (nv,)
        x, written in place; NaN where a motion without inertia is pushed.
    lam : ndarray, shape (nc,)
        Written in place: of all that give the same motion the least ones.

    Returns
    -------
    rank : int
        Number of equations taken.
    weakest : float
        Smallest scaled singular value of an equation that is not merely another one's repetition.
    distinct : int
        Number of equations that are not.

    """
    nc, nv = jac.shape
    row_scale, column_scale = np.ones(nc), np.ones(nv)
    scales(model, jac, row_scale, column_scale)
    scaled = np.empty((nc, nv))
    for i in range(nc):
        for j in range(nv):
            scaled[i, j] = jac[i, j] * row_scale[i] * column_scale[j]
    if not (np.isfinite(scaled).all() and np.isfinite(right).all() and np.isfinite(force).all()):
        motion[:] = np.nan
        lam[:] = np.nan
        return 0, 1.0, 0
    left, singular, right_vectors = np.linalg.svd(scaled, full_matrices=True)
    wanted = left.T @ (right * row_scale)
    taken = singular > WEAK * singular[0]
    determined = _motion(
        taken, singular, right_vectors, wanted, column_scale, gim, force, motion)
    gap = np.abs(psi * row_scale).max() + ROUNDING
    drift = np.abs(rate * row_scale).max()
    size = np.abs(motion / column_scale).max()
    added, weakest, distinct = False, 1.0, 0
    for k in range(singular.shape[0]):
        if singular[k] > DEPENDENT * singular[0]:
            weakest = singular[k]
            distinct += 1
        if not taken[k] and singular[k] > DEPENDENT * singular[0]:
            residual, gap_along, drift_along = wanted[k], 0.0, 0.0
            for i in range(nc):
                gap_along += left[i, k] * psi[i] * row_scale[i]
                drift_along += left[i, k] * rate[i] * row_scale[i]
            for j in range(nv):
                residual -= singular[k] * right_vectors[k, j] * motion[j] / column_scale[j]
            if level == POSITION:
                residual = wanted[k]
            if _worth_taking(level, singular[k], abs(residual), gap, drift, abs(gap_along),
                             abs(drift_along), speed, size):
                taken[k] = True
                added = True
    if added:
        determined = _motion(
            taken, singular, right_vectors, wanted, column_scale, gim, force, motion)
    if not determined:
        motion[:] = np.nan
    need = (gim @ motion - force) * column_scale
    lam[:] = 0.0
    rank = 0
    for k in range(singular.shape[0]):
        if taken[k]:
            rank += 1
            share = 0.0
            for j in range(nv):
                share += right_vectors[k, j] * need[j]
            for i in range(nc):
                lam[i] += left[i, k] * (share / singular[k]) * row_scale[i]
    if rank < nc and determined:
        _least_norm(left, taken, row_scale, lam)
    return rank, weakest, distinct


@allocating
def _least_norm(left, taken, row_scale, lam):
    """Remove from the multipliers what the equations left out would not notice."""
    nc = lam.shape[0]
    beyond = np.zeros((nc, nc))
    count = 0
    for k in range(nc):
        if k >= taken.shape[0] or not taken[k]:
            for i in range(nc):
                beyond[i, count] = left[i, k] * row_scale[i]
            count += 1
    idle = np.ascontiguousarray(beyond[:, :count])
    share = np.linalg.lstsq(idle, lam, 1e-13)[0]
    lam -= idle @ share
