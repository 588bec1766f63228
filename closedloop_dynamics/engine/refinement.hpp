// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__REFINEMENT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__REFINEMENT_HPP_

#include "elimination.hpp"
#include "workspace.hpp"

// Forward dynamics by iterative refinement, where links differ much in mass or are massless.

namespace closedloop
{

/// Factor the constraint matrix of the geometry, then that of the masses; return whether the
/// closure equations are well apart.
bool prepare_refined(
  const Model &, Values tau, const Workspace &, double limit = POOR_PIVOT);

/// Accelerations and multipliers, refined; false where the smallest pivot of the geometry is below a
/// limit, or the refinement does not converge.
bool accelerate_refined(
  const Model &, const Workspace &, Values tau, double baumgarte, Values qdd, Values lam,
  double limit = POOR_PIVOT);

/// The same of what is loaded, with the factors of `prepare_refined`.
bool accelerate_prepared_refined(
  const Model &, const Workspace &, double baumgarte, Values qdd, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__REFINEMENT_HPP_
