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

/// Terms of the norm: of tree joints, cut joints and other equations.
void fill_terms(
  const JointPlaces & joints, const Model & model, const Workspace & work, double size,
  Vector<Arms> arms, Table wrench, Values lam, Values out)
{
  const Indices & row = joints.row;
  const Index count = arms.size;
  const double unit = std::sqrt(0.5) / size;
  const bool planar = work.planar();
  double * next = out.data;
  for (Index k = 0; k < row.size; ++k) {
    next = terms_of_wrench(wrench.row(row[k]), planar, arms[k], unit, next);
  }
  for (Index a = 0; a < model.cut.rows; ++a) {
    const Index k = row.size + model.cut(a, cut::NUMBER), first = model.cut(a, cut::CUT_ROW);
    if (k < count && !carries(model.cut, lam, a)) {
      next = std::fill_n(next, planar ? 4 : 9, 0.0);
    } else if (k < count) {
      wrenches_of_cut(model, work.body, lam, work.share, a);
      next = terms_of_wrench(work.share.data, planar, arms[k], unit, next);
    } else {
      for (Index n = first; n < first + model.cut(a, cut::ROWS); ++n) {
        *next++ = lam[n] / size;
      }
    }
  }
  std::fill(next, out.end(), 0.0);
}
}  // namespace

void spread_multipliers(const System & system, Values lam)
{
  Index next = 0;
  for (Index n = 0; n < lam.size; ++n) {
    lam[n] = system.whole.kept[n] ? system.lam[next++] : 0.0;
  }
}

void fill_null_multipliers(Table factor, Indices order, Index rank, Table out)
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
  const Index nc = jac.rows;
  Scratch<Index, COUNTS> counts(nc + jac.columns);
  const Indices order = counts.take(nc);
  Scratch<double, NUMBERS> scratch(nc * (jac.columns + nc));
  const Table factor = scratch.take(nc, jac.columns);
  copy(jac.all(), factor.all());
  const Index rank = std::min(
    independent, factorize_fully(factor, order, counts.take(jac.columns), REPEATED));
  const Table null_multipliers = scratch.take(nc - rank, nc);
  fill_null_multipliers(factor, order, rank, null_multipliers);
  minimise_joint_wrenches(system, system.joints, model, work, null_multipliers, wrench, lam);
}

void minimise_joint_wrenches(
  const System & system, const JointPlaces & joints, const Model & model, const Workspace & work,
  Table null_multipliers, Table wrench, Values lam)
{
  const Index idle = null_multipliers.rows, nc = null_multipliers.columns, size = work.size();
  if (idle == 0) {
    return;
  }
  const Index count = (work.planar() ? 4 : 9) * joints.body.rows + nc;
  const Index rows = work.force.rows, columns = work.force.columns;
  const double length = system.settings->size;
  Scratch<double, NUMBERS> scratch(idle * (count + idle + 1 + rows * columns) + count);
  const Table response = scratch.take(idle, count), normal = scratch.take(idle, idle);
  const Table felt = scratch.take(idle, rows * columns);
  const Values share = scratch.take(idle), now = scratch.take(count);
  Scratch<Arms, COUNTS> places(joints.body.rows);
  const Vector<Arms> arms = places.take(joints.body.rows);
  find_arms(joints, work, arms);
  fill_terms(joints, model, work, length, arms, wrench, lam, now);
  for (Index k = 0; k < idle; ++k) {
    const Table each{felt.row(k), rows, columns};
    if (joints.body.rows > 0) {
      wrenches_of_multipliers(model, work, null_multipliers[k], each);
    }
    fill_terms(joints, model, work, length, arms, each, null_multipliers[k], response[k]);
    share[k] = -dot(response[k], now);
    // The rows are of one size and far from dependent: normal equations do, and cost less.
    for (Index m = 0; m <= k; ++m) {
      normal(k, m) = dot(response[k], response[m]);
    }
  }
  if (!factorize_positive(normal)) {
    return;
  }
  solve_positive(normal, share);
  for (Index k = 0; k < idle; ++k) {
    const Table each{felt.row(k), rows, columns};
    for (Index i = 0; i < nc; ++i) {
      lam[i] += share[k] * null_multipliers(k, i);
    }
    for (Index i = 0; joints.body.rows > 0 && i < wrench.rows; ++i) {
      for (Index n = 0; n < size; ++n) {
        wrench(i, n) += share[k] * each(i, n);
      }
    }
  }
}

}  // namespace closedloop
