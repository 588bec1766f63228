// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "refinement.hpp"

#include <algorithm>

#include "elimination.hpp"
#include "forward_dynamics.hpp"
#include "loop_closure.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
// The error shrinks each time by the rounding of the smallest pivot, and by the ratio of substitute
// inertias to those around them: three suffice for masses that differ by 12 decades.
constexpr int REFINEMENTS = 3;
// Remainders before the last refinement: of the closure accelerations against their terms; of the
// forces on joints without inertia against those on all joints, as they may be zero, or, without
// any constraint force, against the first ones; and, without any acceleration, of the closure
// accelerations against those without constraint forces.
constexpr double CONVERGED = 1e-8;
constexpr double ROUNDING = 1e-13;
// Mobility of a joint without inertia, against that of the lightest one beside it.
constexpr double VERY_MOBILE = 1e8;

/// Factor the constraint matrix of the geometry alone; return its smallest pivot.
double factor_geometry(const Model & model, const Workspace & work)
{
  const Indexes & tree = model.tree, & cut = model.cut;
  const Indices & path_body = model.path_body;
  const Table & response = work.response, & joint = work.joint;
  update(model, work, Responses::LEVERS);
  for (Index i = 0; i < tree.rows; ++i) {
    joint(i, joint::SQUARE) = 0.0;
  }
  for (Index a = 0; a < cut.rows; ++a) {
    // Couplings act on coordinates, without a lever.
    if (cut(a, cut::LENGTHS) == 0) {
      continue;
    }
    double most = 0.0;
    for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
      if (tree(path_body[entry], tree::TYPE) != tree::PRISMATIC) {
        double square = response(entry, 0) * response(entry, 0);
        if (cut(a, cut::TYPE) != cut::PRISMATIC && cut(a, cut::LENGTHS) > 1) {
          square += response(entry, 1) * response(entry, 1);
        }
        most = std::max(most, square);
      }
    }
    for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
      const Index i = path_body[entry];
      joint(i, joint::SQUARE) =
        tree(i, tree::TYPE) == tree::PRISMATIC ? 1.0 : std::max(joint(i, joint::SQUARE), most);
    }
  }
  for (Index i : path_body) {
    // Joints on which no equation has a lever, as joints held by couplings only.
    double & square = joint(i, joint::SQUARE);
    square = square > 0.0 ? square : 1.0;
  }
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
      for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
        work.lever(entry, k) = response(entry, k);
        work.response_scaled(entry, k) =
          response(entry, k) / joint(path_body[entry], joint::SQUARE);
      }
    }
  }
  assemble(model, work);
  return factorize(model, work);
}

/// Give joints without inertia a small substitute; false where no path leads to such a joint.
bool substitute_inertias(const Model & model, const Workspace & work)
{
  const Table & body = work.body, & joint = work.joint;
  double most = 0.0;
  bool held = true;
  for (Index i : model.path_body) {
    most = std::max(most, body(i, work::DINV) * joint(i, joint::SQUARE));
  }
  for (Index i = 1; i < body.rows; ++i) {
    const double mobility = VERY_MOBILE * most / joint(i, joint::SQUARE);
    const bool heavy = body(i, work::DINV) > 0.0;
    joint(i, joint::STAND_IN) = heavy ? 0.0 : 1.0 / mobility;
    if (!heavy) {
      body(i, work::DINV) = mobility;
      held = held && joint(i, joint::SQUARE) > 0.0;
    }
  }
  return held;
}

/// Add the accelerations so far to those of the closure errors; return squares of their terms, and
/// of the forces on joints.
void unclosed(
  const Model & model, const Workspace & work, Values lam, Values right, double & size,
  double & load)
{
  const Indexes & cut = model.cut;
  const Table & joint = work.joint;
  size = load = 0.0;
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
      const Index row = cut(a, cut::ROW) + k;
      const double force = lam[cut(a, cut::CUT_ROW) + k];
      size += work.bias[row] * work.bias[row];
      for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
        const Index i = model.path_body[entry];
        double term = work.lever(entry, k) * joint(i, joint::TOTAL);
        right[row] += term;
        size += term * term;
        term = work.response(entry, k) * force;
        load += term * term / joint(i, joint::SQUARE);
      }
    }
  }
}

/// Apply the forces of the small inertias instead of these; return the sum of their squares.
double hand_over(const Model & model, const Workspace & work)
{
  const Indexes & tree = model.tree;
  const Table & body = work.body, & joint = work.joint;
  double total = 0.0;
  for (Index i = 1; i < tree.rows; ++i) {
    const double latest = tree(i, tree::TYPE) == tree::PRISMATIC ?
      work.change[tree(i, tree::DOF)] : body(i, work::DZ);
    joint(i, joint::TOTAL) += latest;
    const double force = joint(i, joint::STAND_IN) * latest;
    body(i, work::RHS) = force;
    total += joint(i, joint::STAND_IN) > 0.0 ? force * force / joint(i, joint::SQUARE) : 0.0;
  }
  return total;
}
}  // namespace

bool prepare_refined(const Model & model, Values tau, const Workspace & work, double limit)
{
  const double smallest = factor_geometry(model, work);
  record_pivot(model, work, smallest);
  if (!good(model, smallest, limit)) {
    return false;
  }
  inward(model, tau, work, true);
  if (!substitute_inertias(model, work)) {
    return false;
  }
  update(model, work, Responses::REDUCED);
  assemble(model, work);
  return factorize(model, work) > 0.0;
}

bool accelerate_refined(
  const Model & model, const Workspace & work, Values tau, double baumgarte, Values qdd,
  Values lam, double limit)
{
  return prepare_refined(model, tau, work, limit) &&
         accelerate_prepared_refined(model, work, baumgarte, qdd, lam);
}

bool accelerate_prepared_refined(
  const Model & model, const Workspace & work, double baumgarte, Values qdd, Values lam)
{
  const Indexes & cut = model.cut;
  const Values & right = work.right, & change = work.change;
  qdd.fill(0.0);
  lam.fill(0.0);
  double first = 0.0, error = 0.0, left = 0.0, first_left = 0.0, size = 0.0, load = 0.0;
  for (int n = 0; n < 1 + REFINEMENTS; ++n) {
    if (n == 0) {
      for (Index i = 0; i < work.joint.rows; ++i) {
        work.joint(i, joint::TOTAL) = 0.0;
      }
    } else {
      left = hand_over(model, work);
    }
    if (n == 1) {
      first_left = left;
    }
    free_acceleration(model, work, right);
    unclosed(model, work, lam, right, size, load);
    constraint_right_side(work, baumgarte, right);
    error = 0.0;
    for (double each : right) {
      error += each * each;
    }
    if (n == 0) {
      first = error;
    }
    solve(model, work, right);
    apply(model, work, right);
    outward_acceleration(model, work, change);
    for (Index i = 0; i < qdd.size; ++i) {
      qdd[i] += change[i];
    }
    for (Index a = 0; a < cut.rows; ++a) {
      for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
        lam[cut(a, cut::CUT_ROW) + k] += right[cut(a, cut::ROW) + k];
      }
    }
  }
  if (!(error <= CONVERGED * CONVERGED * size + ROUNDING * ROUNDING * first)) {
    return false;
  }
  return left <= CONVERGED * CONVERGED * (load + first_left);
}

}  // namespace closedloop
