// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_

#include "system.hpp"

// Accelerations beside a singular position, where the closure equations that the elimination works on
// are still independent.

namespace closedloop
{

/// Accelerations and multipliers on the branch next to a state, free of the effect of closure
/// errors. Call after `accelerate_refined` has found a small pivot of the geometry and returned
/// false; false where equations may be dependent: use `accelerate_rank_revealing` then. Poses and
/// closure errors remain those of the state itself.
bool accelerate_on_branch(const System &, Values q, Values qd);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_
