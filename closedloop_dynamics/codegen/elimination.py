# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Block elimination for the multipliers, in a static order with static sparsity.

The constraint matrix Ibar = J I^-1 J^T is symmetric and, while the closure
equations are independent, positive definite: eliminated in any order without
pivoting it stays stable, so the order is chosen once, for low fill. Each cut
joint's rows are neighbours, so the block pivots are its 2 x 2 or 3 x 3 blocks.
"""

from .expression_graph import chosen, larger
from .vectors import is_zero
from ..engine.types import (
    CUT_PRISMATIC, CUT_TYPE, LENGTHS, PATH_A, PATH_END, RANK, ROW, ROWS, SMALLEST_PIVOT,
    SMALLEST_PIVOT_EVER)

# A pivot is compared with the largest diagonal entry of its cut point. In the mass metric it is
# small next to a singular configuration, but also where links differ much in mass: below this,
# ``refinement`` asks the geometry.
SMALL_PIVOT = 1e-3
# Between the angles of the bodies it is a squared sine. This small (closure equations 0.01 rad
# from dependent), it passes errors of a stage's positions into the accelerations a hundredfold:
# the rank-revealing path takes over, which weighs them.
POOR_PIVOT = 1e-4
# In long chains small pivots show the size, not the configuration: the smallest one of a
# regular ladder or chain is 0.3 / nv or 0.9 / nv. From so many joints on the limit falls likewise.
MANY_JOINTS = 100.0


def assemble(model, work):
    """
    Assemble Ibar, lower blocks only, from the reduced responses of the cut forces.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``Recursion.update``; ``factor`` is written, and ``scale``, the same for
        all equations of a cut point, whatever the direction of the world's axes.

    Notes
    -----
    doc/theory.md section 5. With I = L D L^T in each subsystem,
    J_a I^-1 J_b^T is the sum of u_a u_b / D over the joints that both cut forces pass: no
    acceleration is ever computed for a unit force.

    """
    response, scaled, factor, scale = (
        work.response, work.response_scaled, work.factor, work.scale)
    cut, block, pair = model.cut, model.block, model.pair
    column, entry = model.column, model.entry
    for t in range(factor.shape[0]):
        factor[t] = 0.0
    for a in range(cut.shape[0]):
        for c in range(cut[a, ROWS]):
            place = column[cut[a, ROW] + c]
            for k in range(c, cut[a, ROWS]):
                total = 0.0
                for p in range(cut[a, PATH_A], cut[a, PATH_END]):
                    total += response[p, k] * scaled[p, c]
                factor[place + k - c] = total
            scale[cut[a, ROW] + c] = factor[place]
        share_scale(cut[a], scale)
    for n in range(block.shape[0]):
        later, earlier = block[n, 0], block[n, 1]
        for c in range(cut[earlier, ROWS]):
            place = entry[n, c]
            for k in range(cut[later, ROWS]):
                total = 0.0
                for m in range(block[n, 2], block[n, 3]):
                    total += response[pair[m, 0], k] * scaled[pair[m, 1], c]
                factor[place + k] = total


def share_scale(cut, scale):
    """Give the first two equations of a cut joint the larger scale of both."""
    if cut[CUT_TYPE] != CUT_PRISMATIC and cut[LENGTHS] > 1:
        first = cut[ROW]
        scale[first] = scale[first + 1] = larger(scale[first], scale[first + 1])


def factorize(model, work):
    """
    Factor the assembled Ibar = L D L^T in place; keep L D, and 1/D apart.

    Returns the smallest relative pivot; 0 where one is not positive or not a number.
    """
    column, row, dependency = model.column, model.row, model.dependency
    factor, scatter, inverse, scale = work.factor, work.scatter, work.pivot_inverse, work.scale
    places = model.dependency_place
    smallest = 1.0
    for j in range(column.shape[0] - 1):
        first, last = column[j], column[j + 1]
        if dependency[j] < dependency[j + 1]:
            for t in range(first, last):
                scatter[row[t]] = factor[t]
            for d in range(dependency[j], dependency[j + 1]):
                k, place = places[d, 0], places[d, 1]
                share = factor[place] * inverse[k]
                for t in range(place, column[k + 1]):
                    scatter[row[t]] -= factor[t] * share
            for t in range(first, last):
                factor[t] = scatter[row[t]]
        ratio, inverse[j] = compared(factor[first], scale[j])
        # Written so that a NaN (0/0: an equation no motion can change) counts as poor.
        smallest = chosen(ratio >= smallest, smallest, chosen(ratio > 0.0, ratio, 0.0))
    return smallest


def compared(pivot, scale):
    """Return a pivot relative to its reference value, and one over it; zeros where it is none."""
    # Before equations are left out: an equation that no motion changes, or that repeats another.
    return (0.0, 0.0) if is_zero((pivot,)) else (pivot / scale, 1.0 / pivot)


def good(model, smallest, limit):
    """Return whether a smallest pivot is above ``SMALL_PIVOT`` or ``POOR_PIVOT``, the limit."""
    return smallest >= limit * min(1.0, MANY_JOINTS / model.tree.shape[0])


def factorize_well(model, work):
    """
    Factorise as ``factorize``; record a good smallest pivot in ``health``.

    Returns whether every pivot is good; if not, ``refinement`` must be asked.
    """
    return record_good_pivot(model, work, factorize(model, work))


def record_good_pivot(model, work, smallest):
    """Record a smallest pivot in ``health`` where it is good; return whether it is."""
    fine = good(model, smallest, SMALL_PIVOT)
    # A small one may be that of the masses alone: the one reported comes from ``refinement``.
    record_pivot(model, work, chosen(fine, smallest, 1.0))
    return fine


def record_pivot(model, work, smallest):
    """Record the smallest pivot of ``factorize`` in ``health``."""
    health = work.health
    health[RANK] = model.column.shape[0] - 1
    health[SMALLEST_PIVOT] = smallest
    ever = health[SMALLEST_PIVOT_EVER]
    health[SMALLEST_PIVOT_EVER] = chosen(smallest < ever, smallest, ever)


def solve(model, work, right):
    """Solve Ibar x = ``right`` with the factors, in place, in elimination order."""
    column, row, factor, inverse = model.column, model.row, work.factor, work.pivot_inverse
    rows = column.shape[0] - 1
    for k in range(rows):
        scaled = right[k] * inverse[k]
        right[k] = scaled
        for t in range(column[k] + 1, column[k + 1]):
            right[row[t]] -= factor[t] * scaled
    for k in range(rows - 2, -1, -1):
        total = 0.0
        for t in range(column[k] + 1, column[k + 1]):
            total += factor[t] * right[row[t]]
        right[k] -= total * inverse[k]
