// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__FORMULATIONS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__FORMULATIONS_HPP_

#include "workspace.hpp"

// The system-level and the augmented formulation, by dense matrices: for comparison.

namespace closedloop
{

/// Accelerations and multipliers, after `outward` and the effects; false where a pivot is poor.
bool accelerate_dense(
  const Model &, const Workspace &, const DenseWorkspace &, Index formulation, Values tau,
  double baumgarte, Values qdd, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__FORMULATIONS_HPP_
