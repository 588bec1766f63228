// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_PLACES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_PLACES_HPP_

#include "system.hpp"

// Accelerations at a singular position, as their limit along the branch of the motion.

namespace closedloop
{

/// Accelerations and multipliers of a state whose motion, after `outward`, is in the workspace, from
/// places ahead and behind, where the closure equations are independent; `added` are the forces of
/// effects on the bodies, shape (bodies, components) or empty. False where no branch through the
/// state is found, or where it bends too much between the places.
bool accelerate_by_places(const System &, Values q, Values qd, Table added);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_PLACES_HPP_
