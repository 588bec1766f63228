// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LU_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LU_HPP_

#include "array.hpp"

// Dense LU factors with partial pivoting, in place and kept for many right-hand sides: Eigen's
// allocate when they are made.

namespace closedloop
{

/// Factor a matrix of at least as many rows as columns in place, with a pivot for each column;
/// return the smallest pivot relative to the largest.
double factorize(Table matrix, Indices pivots);

/// Solve in place with the factors: the rows of the pivots, for as many unknowns as columns.
void solve(Table matrix, Indices pivots, Values right);

/// The same of several right-hand sides, side by side.
void solve(Table matrix, Indices pivots, Table right);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LU_HPP_
