// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__REFINEMENT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__REFINEMENT_HPP_

#include "model.hpp"

// Forward dynamics by iterative refinement, where links differ much in mass or have none.

namespace closedloop
{

/// Factor the constraint matrix of the geometry, then that of the masses; return whether the
/// closure equations are well apart.
bool prepare_refined(const Model &, Values tau, const Workspace &);

/// Accelerations and multipliers, refined; false where the refinement does not converge.
bool accelerate_refined(
  const Model &, const Workspace &, Values tau, double baumgarte, Values qdd, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__REFINEMENT_HPP_
