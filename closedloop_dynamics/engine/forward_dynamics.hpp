// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__FORWARD_DYNAMICS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__FORWARD_DYNAMICS_HPP_

#include "workspace.hpp"

// The subsystem-level forward dynamics by loops over bodies (doc/theory.md).

namespace closedloop
{

/// Eliminate the joints, factor the constraint matrix; return whether no pivot is small.
bool prepare(const Model &, Values tau, const Workspace &);

/// Accelerations and multipliers, after `outward` and the effects; false where a pivot is small.
bool accelerate(
  const Model &, const Workspace &, Values tau, double baumgarte, Values qdd, Values lam);

/// Put torques on the joints in the place of all forces and of the motion, for the factors that
/// `prepare` or `prepare_refined` has left in the workspace.
void load_torques(const Model &, const Workspace &, Values tau);

/// Accelerations and multipliers from what is loaded and the factors of `prepare`.
void accelerate_prepared(
  const Model &, const Workspace &, double baumgarte, Values qdd, Values lam);

/// Right-hand side of the multipliers from the accelerations of the closure errors in `right`.
void constraint_right_side(const Workspace &, double baumgarte, Values right);

/// Kinematics, accelerations and multipliers of a state under joint torques alone.
bool forward_dynamics(
  const Model &, const Workspace &, Values q, Values qd, Values tau, Values qdd, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__FORWARD_DYNAMICS_HPP_
