// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__INDEPENDENT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__INDEPENDENT_HPP_

#include "workspace.hpp"

// Independent coordinates: the dependent ones follow from the loop closures by Newton's method.

namespace closedloop
{

/// Close the loops by the dependent coordinates and rates, in place, choosing independent ones
/// initially and, after a step, where their pivots have become too small; false where loops remain
/// open.
bool close_by_dependent(
  const Model &, const Workspace &, const Partition &, const Manifold &, Values q, Values qd,
  double tolerance, bool after_step);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INDEPENDENT_HPP_
