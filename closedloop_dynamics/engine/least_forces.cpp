// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "least_forces.hpp"

#include <algorithm>
#include <cmath>

#include "forces.hpp"
#include "recursion.hpp"
#include "scratch.hpp"
#include "small_factors.hpp"

namespace closedloop
{

namespace
{
// Pivots below this times the largest belong to redundant equations.
constexpr double REPEATED = 1e-9;
// Numbers, and joints with their equations, that fit on the stack.
constexpr Index NUMBERS = 1024, COUNTS = 64;

/// From the reference point of a wrench to the joint's points on its two bodies [m].
struct Arms
{
  Vector3 a, b;
};

/// The place of a joint's point on one of its bodies.
Vector3 joint_point(const JointPlaces & joints, const Workspace & work, Index k, Index side)
{
  const Index row = joints.body(k, side);
  const double * point = joints.point.row(2 * k + side);
  if (work.planar()) {
    const Vector2 place = position(work.body, row, vector2(point));
    return {place.x, place.y, 0.0};
  }
  return position(work.body, row, vector3(point));
}

/// Those of all joints: wrenches in the tree refer to origins, those of cut joints to A's point.
void find_arms(const JointPlaces & joints, const Workspace & work, Vector<Arms> out)
{
  for (Index k = 0; k < joints.body.rows; ++k) {
    const Vector3 a = joint_point(joints, work, k, 0), b = joint_point(joints, work, k, 1);
    Vector3 reference = a;
    if (k < joints.row.size && work.planar()) {
      const Vector2 origin = origin_in_plane(work.body, joints.row[k]);
      reference = {origin.x, origin.y, 0.0};
    } else if (k < joints.row.size) {
      reference = origin_in_space(work.body, joints.row[k]);
    }
    out[k] = {reference - a, reference - b};
  }
}

/// Write the terms of a wrench: the force and both moments; return the place of the next ones.
double * terms_of_wrench(
  const double * wrench, bool planar, const Arms & arms, double unit, double * out)
{
  if (planar) {
    out[0] = wrench[1];
    out[1] = wrench[2];
    out[2] = unit * (wrench[0] + arms.a.x * wrench[2] - arms.a.y * wrench[1]);
    out[3] = unit * (wrench[0] + arms.b.x * wrench[2] - arms.b.y * wrench[1]);
    return out + 4;
  }
  const Vector3 force = vector3(wrench + 3), moment = vector3(wrench);
  for (const Vector3 & each : {
      force, unit * (moment + cross(arms.a, force)), unit * (moment + cross(arms.b, force))})
  {
    *out++ = each.x;
    *out++ = each.y;
    *out++ = each.z;
  }
  return out;
}

/// Number of terms of the norm.
Index number_of_terms(bool planar, Index joints, Index equations)
{
  return (planar ? 4 : 9) * joints + equations;
}

/// Terms of the norm: of tree joints, cut joints and other equations.
void fill_terms(
  const System & system, const Model & model, const Workspace & work, Vector<Arms> arms,
  Table wrench, Values lam, Values out)
{
  const Indices & row = system.joints.row;
  const Index count = arms.size;
  const double size = system.settings[setting::SIZE], unit = std::sqrt(0.5) / size;
  const bool planar = work.planar();
  double * next = out.data;
  for (Index k = 0; k < row.size; ++k) {
    next = terms_of_wrench(wrench.row(row[k]), planar, arms[k], unit, next);
  }
  for (Index a = 0; a < model.cut.rows; ++a) {
    const Index k = row.size + model.cut(a, cut::NUMBER), first = model.cut(a, cut::CUT_ROW);
    if (k < count) {
      wrenches_of_cut(model.cut, model.cut_point, work.cut_kernel, work.body, lam, work.share, a);
      next = terms_of_wrench(work.share.data, planar, arms[k], unit, next);
    } else {
      for (Index n = first; n < first + model.cut(a, cut::ROWS); ++n) {
        *next++ = lam[n] / size;
      }
    }
  }
  std::fill(next, out.end(), 0.0);
}

/// Write multipliers without joint forces, a row each, from the factors of J, of which so many rows
/// are independent.
void fill_unfelt(Table factor, Indices order, Index rank, Table out)
{
  out.fill(0.0);
  for (Index n = 0; n < out.rows; ++n) {
    const Values lam = out[n];
    lam[order[rank + n]] = 1.0;
    for (Index k = rank - 1; k >= 0; --k) {
      double total = factor(rank + n, k);
      for (Index i = k + 1; i < rank; ++i) {
        total += factor(i, k) * lam[order[i]];
      }
      lam[order[k]] = -total;
    }
  }
}
}  // namespace

void spread_multipliers(const System & system, Values lam)
{
  Index next = 0;
  for (Index n = 0; n < lam.size; ++n) {
    lam[n] = system.whole.kept[n] ? system.lam[next++] : 0.0;
  }
}

void minimise_joint_wrenches(
  const System & system, const Model & model, const Workspace & work, Table jac, Table wrench,
  Values lam, Index independent)
{
  const auto finite = [](double value) {return std::isfinite(value);};
  if (!(std::all_of(jac.all().begin(), jac.all().end(), finite) &&
    std::all_of(lam.begin(), lam.end(), finite)))
  {
    return;
  }
  const Index nc = jac.rows, joints = system.joints.body.rows;
  Scratch<Index, COUNTS> counts(nc + jac.columns);
  const Indices order = counts.take(nc);
  Scratch<double, NUMBERS> factors(nc * jac.columns);
  const Table factor = factors.take(nc, jac.columns);
  copy(jac.all(), factor.all());
  const Index rank = std::min(
    independent, factorize_fully(factor, order, counts.take(jac.columns), REPEATED));
  const Index idle = nc - rank, count = number_of_terms(work.planar(), joints, nc);
  if (idle == 0) {
    return;
  }
  Scratch<double, NUMBERS> scratch(
    idle * (nc + count + idle + 1) + count + nc + work.force.rows * work.force.columns);
  const Table unfelt = scratch.take(idle, nc), response = scratch.take(idle, count);
  const Table normal = scratch.take(idle, idle);
  const Values share = scratch.take(idle), now = scratch.take(count), change = scratch.take(nc);
  const Table felt = scratch.take(work.force.rows, work.force.columns);
  Scratch<Arms, COUNTS> places(joints);
  const Vector<Arms> arms = places.take(joints);
  find_arms(system.joints, work, arms);
  fill_terms(system, model, work, arms, wrench, lam, now);
  fill_unfelt(factor, order, rank, unfelt);
  for (Index k = 0; k < idle; ++k) {
    wrenches_of_multipliers(model, work, unfelt[k], felt);
    fill_terms(system, model, work, arms, felt, unfelt[k], response[k]);
    share[k] = 0.0;
    for (Index n = 0; n < count; ++n) {
      share[k] -= response(k, n) * now[n];
    }
  }
  // The rows are of one size and far from dependent: normal equations do, and cost less.
  fill_products(normal, response, count);
  if (!factorize_positive(normal)) {
    return;
  }
  solve_positive(normal, share);
  change.fill(0.0);
  for (Index k = 0; k < idle; ++k) {
    for (Index i = 0; i < nc; ++i) {
      change[i] += share[k] * unfelt(k, i);
    }
  }
  for (Index i = 0; i < nc; ++i) {
    lam[i] += change[i];
  }
  wrenches_of_multipliers(model, work, change, felt);
  for (Index i = 0; i < wrench.rows; ++i) {
    for (Index n = 0; n < work.size(); ++n) {
      wrench(i, n) += felt(i, n);
    }
  }
}

}  // namespace closedloop
