// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_

#include "evaluation.hpp"
#include "data.hpp"

// Accelerations beside a singular position, where the closure equations that the elimination works on
// are still independent.

namespace closedloop
{

/// Accelerations and, if wanted, multipliers on the branch next to a state, free of the effect of
/// closure errors; of all multipliers that give this motion, those of the least joint forces. The
/// bodies have poses and forces at the state where there are effects. With `singular`,
/// `accelerate_refined` has found a small pivot of the geometry; otherwise false where there are many
/// equations, or where a generated routine does not show them to be nearly dependent. False where they may be dependent
/// everywhere, too: use `accelerate_rank_revealing` then.
bool accelerate_on_branch(const System &, Values q, Values qd, bool singular, Outputs);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_HPP_
