// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ELIMINATION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ELIMINATION_HPP_

#include "workspace.hpp"

// The sparse constraint matrix J I^-1 J^T and its factors L D L^T, in elimination order.

namespace closedloop
{

/// Between the angles of bodies a pivot is a squared sine. One this small (equations 0.01 rad from
/// dependent) passes errors of a stage's positions into the accelerations a hundredfold: the
/// rank-revealing path takes over, which weighs them.
constexpr double POOR_PIVOT = 1e-4;

/// Sum up the entries of the constraint matrix from the responses of the trees.
void assemble(const Model &, const Workspace &);

/// Factor the constraint matrix in place; return the smallest pivot relative to the largest
/// diagonal entry of its cut point.
double factorize(const Model &, const Workspace &);

/// Factor, and report; return whether no pivot is small.
bool factorize_well(const Model &, const Workspace &);

/// Whether a smallest pivot is good enough, in view of the number of joints.
bool good(const Model &, double smallest, double limit);

/// Report a smallest pivot in Workspace.health.
void record_pivot(const Model &, const Workspace &, double smallest);

/// Solve in place, in elimination order, shape (nc,).
void solve(const Model &, const Workspace &, Values right);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ELIMINATION_HPP_
