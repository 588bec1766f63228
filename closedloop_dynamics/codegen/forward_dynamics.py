# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The subsystem-level forward dynamics on one page (doc/theory.md)."""

from . import elimination
from ..engine.types import CUT_ROW, EVALUATIONS, PATH_A, PATH_END, REDUCED, RHS, ROW, ROWS


def prepare(recursion, model, tau, work):
    """
    Factor the inertias of the trees and the constraint matrix; return whether pivots are good.

    ``work``: after ``outward`` and whatever subtracted applied forces from FZ, FX, FY; ``tau``,
    shape (nv,): joint torques [N m] and forces [N].
    """
    recursion.inward(model, tau, work)
    recursion.update(model, work, REDUCED)
    elimination.assemble(model, work)
    return elimination.factorize_well(model, work)


def accelerate(recursion, model, work, tau, baumgarte, qdd, lam):
    """
    Compute joint accelerations and multipliers after ``outward``.

    Parameters
    ----------
    recursion : spatial.Recursion
        Of the bodies.
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``outward`` and whatever subtracted applied forces from FZ, FX, FY.
    tau : ndarray, shape (nv,)
        Joint torques [N m] and forces [N].
    baumgarte : float
        Rate [1/s] at which closure errors decay, critically damped; 0 for none.
    qdd : ndarray, shape (nv,)
        Written in place [rad/s^2, m/s^2].
    lam : ndarray, shape (nc,)
        Written in place, the force on body A of each cut joint [N, N m].

    Returns
    -------
    bool
        Whether every pivot was good. If not, nothing is written, and ``refinement.accelerate``
        must be asked, after the outward recursion again.

    Notes
    -----
    Koul, Shah, Saha and Manivannan (2014), eq. (3)-(6), for any number of cut joints in any
    order of elimination. Departure: what the paper computes as I_k^-1 J^T by recursions
    outward and inward is left half done, at the factors, where it already gives Ibar.

    """
    work.health[EVALUATIONS] += 1.0
    if not prepare(recursion, model, tau, work):
        return False
    solve(model, work, baumgarte)
    recursion.outward_acceleration(model, work, qdd)
    to_user_order(model, work.right, lam)
    return True


def correct(recursion, model, work, error, out, prepare=prepare):
    """
    Find the least change of coordinates or rates, in the mass metric, that closes an error.

    Parameters
    ----------
    recursion : joint_space.JointSpace
        Of the bodies, at rest and without gravity.
    model, work
        As for ``accelerate``.
    error : ndarray, shape (nc,)
        Of the closures' positions or rates, in elimination order [m, rad; m/s, rad/s].
    out : ndarray, shape (nv,)
        Written in place [rad, m; rad/s, m/s].
    prepare : callable
        This module's, or that of ``refinement``.

    Returns
    -------
    bool
        As of ``accelerate``.

    """
    if not prepare(recursion, model, len(out) * [0.0], work):
        return False
    right = -error
    elimination.solve(model, work, right)
    work.body[:, RHS] = 0.0
    apply(model, work, right)
    recursion.outward_acceleration(model, work, out)
    return True


def solve(model, work, baumgarte):
    """Compute the multipliers, in ``work.right``, and add their forces to the joints' RHS."""
    free_acceleration(model, work, work.right)
    constraint_right_side(work, baumgarte, work.right)
    elimination.solve(model, work, work.right)
    apply(model, work, work.right)


def free_acceleration(model, work, out):
    """
    Compute J I^-1 phi, the acceleration of each closure error without cut forces.

    ``out``, shape (nc,), is written in elimination order, after ``update``.
    """
    body, scaled = work.body, work.response_scaled
    cut, path_body = model.cut, model.path_body
    for a in range(cut.shape[0]):
        for k in range(cut[a, ROWS]):
            total = 0.0
            for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
                total += scaled[entry, k] * body[path_body[entry], RHS]
            out[cut[a, ROW] + k] = total


def apply(model, work, lam):
    """
    Add J^T lambda, reduced, to the right-hand sides RHS of the joints, after ``update``.

    ``lam``, shape (nc,), in elimination order.
    """
    body, response = work.body, work.response
    cut, path_body = model.cut, model.path_body
    for a in range(cut.shape[0]):
        for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
            i = path_body[entry]
            total = body[i, RHS]
            for k in range(cut[a, ROWS]):
                total += response[entry, k] * lam[cut[a, ROW] + k]
            body[i, RHS] = total


def constraint_right_side(work, baumgarte, right):
    """
    Turn J I^-1 phi (or zeros), shape (nc,), into the right-hand side of the multipliers.

    In place: - Jdot qd - Baumgarte's terms, of a decay rate [1/s] of closure errors, less that.
    """
    for k in range(right.shape[0]):
        right[k] = -right[k] - work.bias[k] - baumgarte * (
            2.0 * work.closure_rate[k] + baumgarte * work.closure[k])


def to_user_order(model, ordered, out):
    """Copy closure-sized values from elimination order to the order of the mechanism."""
    cut = model.cut
    for a in range(cut.shape[0]):
        for k in range(cut[a, ROWS]):
            out[cut[a, CUT_ROW] + k] = ordered[cut[a, ROW] + k]
