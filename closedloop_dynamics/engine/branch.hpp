// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_

#include "system.hpp"

// Accelerations beside a singular position, where the closure equations that the elimination works on
// are still independent.

namespace closedloop
{

/// Accelerations and multipliers on the branch next to a state, where errors of closure do not show
/// in them. After `accelerate_refined`, which has found a small pivot of the geometry, and returned
/// false; false where equations may be dependent: `accelerate_rank_revealing` must be asked. Poses
/// and closure errors of the state itself are left.
bool accelerate_on_branch(const System &, Values q, Values qd);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_
