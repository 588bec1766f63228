// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__RANK_REVEALING_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__RANK_REVEALING_HPP_

#include "workspace.hpp"

// Accelerations and corrections where closure equations depend on one another: next to singular
// positions, and where loops are redundant.

namespace closedloop
{

/// Accelerations and multipliers, after `outward` and the effects; `aside` [rad] is the
/// distance of the positions on the branch at which they are found where the state does not
/// determine them. At most so many equations are independent: others that seem so, too, repeat them
/// in all but the last digits of lengths.
void accelerate_rank_revealing(
  const Model &, const Workspace &, Index most, Values tau, double baumgarte, double aside,
  const Manifold &, Values q, Values qd, Values qdd, Values lam);

/// Smallest singular value, scaled, of so many independent equations, after `outward`.
double weakest_equation(const Model &, const Workspace &, Index most);

/// Least change in the mass metric that closes positions or rates, after `outward`; shape (nv,).
void correct_rank_revealing(const Model &, const Workspace &, Index most, Level, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__RANK_REVEALING_HPP_
