// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_MOTION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_MOTION_HPP_

#include "branch_equations.hpp"

// The equations of motion along a branch.

namespace closedloop
{

/// Accelerations and, if wanted, multipliers at a place on the branch into System.qdd and System.lam;
/// for the latter the equations have been evaluated there. `added` are the forces of effects on the bodies, shape
/// (bodies, components) or empty. Where equations vanish, multipliers are those of the least joint
/// forces. False where a motion along the branch has no inertia.
bool accelerate_along(BranchEquations &, const BranchPoint &, Table added, bool multipliers);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_MOTION_HPP_
