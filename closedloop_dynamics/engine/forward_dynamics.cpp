// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "forward_dynamics.hpp"

#include "elimination.hpp"
#include "loop_closure.hpp"
#include "recursion.hpp"

namespace closedloop
{

bool prepare(const Model & model, Values tau, const Workspace & work)
{
  inward(model, tau, work, false);
  update(model, work, Responses::REDUCED);
  assemble(model, work);
  return factorize_well(model, work);
}

bool accelerate(
  const Model & model, const Workspace & work, Values tau, double baumgarte, Values qdd,
  Values lam)
{
  const Values & right = work.right;
  work.health[health::EVALUATIONS] += 1.0;
  if (!prepare(model, tau, work)) {
    return false;
  }
  free_acceleration(model, work, right);
  constraint_right_side(work, baumgarte, right);
  solve(model, work, right);
  apply(model, work, right);
  outward_acceleration(model, work, qdd);
  to_user_order(model, right, lam);
  return true;
}

void constraint_right_side(const Workspace & work, double baumgarte, Values right)
{
  for (Index k = 0; k < right.size; ++k) {
    right[k] = -right[k] - work.bias[k] - baumgarte * (
      2.0 * work.closure_rate[k] + baumgarte * work.closure[k]);
  }
}

bool forward_dynamics(
  const Model & model, const Workspace & work, Values q, Values qd, Values tau, Values qdd,
  Values lam)
{
  outward(model, q, qd, work);
  return accelerate(model, work, tau, 0.0, qdd, lam);
}

}  // namespace closedloop
