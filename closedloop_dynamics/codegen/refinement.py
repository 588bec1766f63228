# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The block elimination with iterative refinement, for links much lighter than others.

Entered after a small pivot. In the mass metric the closure equations of a light link are nearly
parallel: all of them move it. So the pivots are formed once more for the angles of the bodies and
the slides alone, without masses. If one is small there, too, a singular configuration is near.
If not, the configuration is regular and only the arithmetic has lost digits: what is left of the
closure accelerations is computed directly, as J qdd + Jdot qd, and eliminated with the
same factors.

A joint without any inertia gets a small one as a stand-in, whose effect the same
refinement removes.
"""

from . import elimination, forward_dynamics
from .expression_graph import chosen, larger
from .forward_dynamics import apply, constraint_right_side, free_acceleration
from ..engine.types import (
    CUT_PRISMATIC, CUT_ROW, CUT_TYPE, DINV, DOF, DZ, LENGTHS, LEVERS, PATH_A, PATH_END, PRISMATIC,
    REDUCED, RHS, ROW, ROWS, SQUARE, STAND_IN, TOTAL, TYPE)

# The error shrinks each time by the rounding of the smallest pivot, and by the share that the
# stand-ins have in the inertia around them: three times is enough for masses that differ by 12
# decades.
REFINEMENTS = 3
# What is left before the last refinement: of the closure accelerations against their terms; of the
# forces on joints without inertia against those on all joints, as they may be none, or, where no
# constraint force acts at all, against the first ones; and, where nothing accelerates, of the
# closure accelerations against those without constraint forces.
CONVERGED = 1e-8
ROUNDING = 1e-13
# Mobility of a joint without inertia, against that of the lightest one beside it.
VERY_MOBILE = 1e8


def _geometry(recursion, model, work):
    """
    Factor J W J^T for the angles of the bodies and the slides, weighted by W.

    Angles are scaled by the longest lever of any in the same loops, so that they compare with
    slides. Keeps J, by path entries, in ``lever``. Returns the smallest relative pivot.
    """
    tree, cut, path_body = model.tree, model.cut, model.path_body
    response, scaled, lever, joint = (
        work.response, work.response_scaled, work.lever, work.joint)
    recursion.update(model, work, LEVERS)
    for i in range(tree.shape[0]):
        joint[i, SQUARE] = 0.0
    for a in range(cut.shape[0]):
        most = 0.0
        # What a coupling reads has no lever.
        if cut[a, LENGTHS] == 0:
            continue
        for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
            if tree[path_body[entry], TYPE] != PRISMATIC:
                square = response[entry, 0] * response[entry, 0]
                if cut[a, CUT_TYPE] != CUT_PRISMATIC and cut[a, LENGTHS] > 1:
                    square += response[entry, 1] * response[entry, 1]
                most = larger(most, square)
        for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
            i = path_body[entry]
            joint[i, SQUARE] = (
                1.0 if tree[i, TYPE] == PRISMATIC else larger(joint[i, SQUARE], most))
    for entry in range(path_body.shape[0]):
        # Joints that no equation has a lever on, such as those that only couplings hold.
        i = path_body[entry]
        joint[i, SQUARE] = chosen(joint[i, SQUARE] > 0.0, joint[i, SQUARE], 1.0)
    for a in range(cut.shape[0]):
        for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
            for k in range(cut[a, ROWS]):
                lever[entry, k] = response[entry, k]
                scaled[entry, k] = response[entry, k] / joint[path_body[entry], SQUARE]
    elimination.assemble(model, work)
    return elimination.factorize(model, work)


def _stand_in(model, work):
    """
    Give joints without inertia a small one.

    Returns whether cut forces act on all of these: nothing else can hold them.
    """
    body, joint, path_body = work.body, work.joint, model.path_body
    most, held = 0.0, 1.0
    for entry in range(path_body.shape[0]):
        i = path_body[entry]
        most = larger(most, body[i, DINV] * joint[i, SQUARE])
    for i in range(1, body.shape[0]):
        mobility = VERY_MOBILE * most / joint[i, SQUARE]
        heavy = body[i, DINV] > 0.0
        joint[i, STAND_IN] = chosen(heavy, 0.0, 1.0 / mobility)
        body[i, DINV] = chosen(heavy, body[i, DINV], mobility)
        held = chosen(heavy, held, chosen(joint[i, SQUARE] > 0.0, held, 0.0))
    return held > 0.0


def prepare(recursion, model, tau, work):
    """
    Check the configuration, and factor the constraint matrix; return whether it is regular.

    ``work``: after ``outward``, afresh, and the applied forces; its ``health`` gives the smallest
    relative pivot, without masses. ``tau``, shape (nv,): joint torques [N m] and forces [N].
    """
    smallest = _geometry(recursion, model, work)
    elimination.record_pivot(model, work, smallest)
    if not elimination.good(model, smallest, elimination.POOR_PIVOT):
        return False
    recursion.inward(model, tau, work, True)
    if not _stand_in(model, work):
        return False
    recursion.update(model, work, REDUCED)
    elimination.assemble(model, work)
    return elimination.factorize(model, work) > 0.0


def correct(recursion, model, work, error, out):
    """Find a least change, as ``forward_dynamics.correct`` does."""
    return forward_dynamics.correct(recursion, model, work, error, out, prepare)


def _unclosed(model, work, lam, right):
    """
    Add J qdd to ``right``.

    Returns the squares of all terms of J qdd and Jdot qd, and of all forces on joints.
    """
    cut, path_body = model.cut, model.path_body
    lever, response, joint = work.lever, work.response, work.joint
    size, load = 0.0, 0.0
    for a in range(cut.shape[0]):
        for k in range(cut[a, ROWS]):
            row, force = cut[a, ROW] + k, lam[cut[a, CUT_ROW] + k]
            size += work.bias[row] * work.bias[row]
            for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
                i = path_body[entry]
                term = lever[entry, k] * joint[i, TOTAL]
                right[row] += term
                size += term * term
                term = response[entry, k] * force
                load += term * term / joint[i, SQUARE]
    return size, load


def _hand_over(model, work):
    """
    Add the latest change to the accelerations, and leave the residual for refinement.

    That is the forces on the stand-ins; the sum of their squares is returned.
    """
    tree, body, joint = model.tree, work.body, work.joint
    total = 0.0
    for i in range(1, tree.shape[0]):
        latest = work.change[tree[i, DOF]] if tree[i, TYPE] == PRISMATIC else body[i, DZ]
        joint[i, TOTAL] += latest
        force = joint[i, STAND_IN] * latest
        body[i, RHS] = force
        total += chosen(joint[i, STAND_IN] > 0.0, force * force / joint[i, SQUARE], 0.0)
    return total


def accelerate(recursion, model, work, tau, baumgarte, qdd, lam):
    """
    Compute accelerations and multipliers, as ``forward_dynamics.accelerate`` does.

    Parameters
    ----------
    recursion : spatial.Recursion
        Of the bodies.
    model, tau, baumgarte, qdd, lam
        As for ``forward_dynamics.accelerate``.
    work : Workspace
        After ``outward`` and the applied forces, afresh: the elimination has used
        both up.

    Returns
    -------
    bool
        Whether the configuration is regular, with masses that double precision can distinguish.
        If not, ``engine/rank_revealing.cpp`` must be asked, after the outward recursion again.

    Notes
    -----
    With stand-ins E, (I + E) dqdd = J^T dlam + E dqdd' leaves E dqdd for the next one.

    """
    cut, joint, right, change = model.cut, work.joint, work.right, work.change
    if not prepare(recursion, model, tau, work):
        return False
    for i in range(qdd.shape[0]):
        qdd[i] = 0.0
    for k in range(lam.shape[0]):
        lam[k] = 0.0
    first, error, left, first_left, size, load = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(1 + REFINEMENTS):
        if n == 0:
            for i in range(joint.shape[0]):
                joint[i, TOTAL] = 0.0
        else:
            left = _hand_over(model, work)
        if n == 1:
            first_left = left
        free_acceleration(model, work, right)
        size, load = _unclosed(model, work, lam, right)
        constraint_right_side(work, baumgarte, right)
        error = 0.0
        for k in range(right.shape[0]):
            error += right[k] * right[k]
        if n == 0:
            first = error
        elimination.solve(model, work, right)
        apply(model, work, right)
        recursion.outward_acceleration(model, work, change)
        for i in range(qdd.shape[0]):
            qdd[i] += change[i]
        for a in range(cut.shape[0]):
            for k in range(cut[a, ROWS]):
                lam[cut[a, CUT_ROW] + k] += right[cut[a, ROW] + k]
    if not error <= CONVERGED * CONVERGED * size + ROUNDING * ROUNDING * first:
        return False
    return left <= CONVERGED * CONVERGED * (load + first_left)
