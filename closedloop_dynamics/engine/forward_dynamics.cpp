// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "forward_dynamics.hpp"

#include "elimination.hpp"
#include "loop_closure.hpp"
#include "recursion.hpp"
#include "routines.hpp"

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
  work.health[health::EVALUATIONS] += 1.0;
  if (!prepare(model, tau, work)) {
    return false;
  }
  accelerate_prepared(model, work, baumgarte, qdd, lam);
  return true;
}

void accelerate_prepared(
  const Model & model, const Workspace & work, double baumgarte, Values qdd, Values lam)
{
  const Values & right = work.right;
  free_acceleration(model, work, right);
  constraint_right_side(work, baumgarte, right);
  solve(model, work, right);
  apply(model, work, right);
  outward_acceleration(model, work, qdd);
  to_user_order(model, right, lam);
}

void load_torques(const Model & model, const Workspace & work, Values tau)
{
  const Indexes & tree = model.tree;
  const Table & body = work.body, & arrived = work.force;
  const Values & share = work.share;
  for (Index i = 0; i < work.torque.size; ++i) {
    work.torque[i] = tau[i];
  }
  turn_spherical(tree, body, work.torque.data, true);
  arrived.fill(0.0);
  work.bias.fill(0.0);
  body(0, work::RHS) = 0.0;
  for (Index i = tree.rows - 1; i > 0; --i) {
    share[0] = work.torque[tree(i, tree::DOF)];
    share[1] = 0.0;
    call_joint_kernel(
      model.kernel(i, kernel::REDUCE_COUPLED), model.body.row(i), body.row(i), body.row(i),
      arrived.row(i), share.data);
    body(i, work::RHS) = share[0];
    for (Index n = 0; n < 6; ++n) {
      arrived(tree(i, tree::PARENT), n) += arrived(i, n);
    }
  }
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
