// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_PLACES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_PLACES_HPP_

#include "branch_equations.hpp"

// The branch at a singular position, as the limit along the motion.

namespace closedloop
{

/// Position, rates, accelerations and tangents of a component at a state, from places ahead and
/// behind, where its closure equations are independent. `point` is at the state, but for these, and
/// its tangents are zero. False where no branch through the state is found, or where it bends too
/// much between the places.
bool interpolate(
  BranchEquations &, Component &, Values q, Values qd, const BranchPoint & point);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_PLACES_HPP_
