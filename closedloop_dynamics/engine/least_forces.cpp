// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "least_forces.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <vector>

#include "forces.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
// Pivots below this times the largest belong to redundant equations.
constexpr double REPEATED = 1e-9;

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
std::vector<Arms> arms_of_joints(const JointPlaces & joints, const Workspace & work)
{
  std::vector<Arms> found;
  for (Index k = 0; k < joints.body.rows; ++k) {
    const Vector3 a = joint_point(joints, work, k, 0), b = joint_point(joints, work, k, 1);
    Vector3 reference = a;
    if (k < joints.row.size && work.planar()) {
      const Vector2 origin = origin_in_plane(work.body, joints.row[k]);
      reference = {origin.x, origin.y, 0.0};
    } else if (k < joints.row.size) {
      reference = origin_in_space(work.body, joints.row[k]);
    }
    found.push_back({reference - a, reference - b});
  }
  return found;
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
Eigen::VectorXd terms(
  const System & system, const Model & model, const Workspace & work,
  const std::vector<Arms> & arms, Table wrench, Values lam)
{
  const Indices & row = system.joints.row;
  const Index count = static_cast<Index>(arms.size());
  const double size = system.settings[setting::SIZE], unit = std::sqrt(0.5) / size;
  const bool planar = work.planar();
  Eigen::VectorXd found = Eigen::VectorXd::Zero((planar ? 4 : 9) * count + lam.size);
  double * next = found.data();
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
  return found;
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
  const System & system, const Model & model, const Workspace & work, const DenseMatrix & jac,
  Table wrench, Values lam, Index independent)
{
  const Index nc = jac.rows();
  if (!(jac.allFinite() && dense(lam).allFinite())) {
    return;
  }
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> columns;
  columns.setThreshold(REPEATED);
  columns.compute(jac);
  const Index idle = nc - std::min(independent, static_cast<Index>(columns.rank()));
  if (idle == 0) {
    return;
  }
  Eigen::MatrixXd unfelt = Eigen::MatrixXd::Zero(nc, idle);
  unfelt.bottomRows(idle).setIdentity();
  unfelt.applyOnTheLeft(columns.householderQ());
  const std::vector<Arms> arms = arms_of_joints(system.joints, work);
  const Eigen::VectorXd now = terms(system, model, work, arms, wrench, lam);
  Eigen::MatrixXd response(now.size(), idle);
  DenseMatrix scratch(work.force.rows, work.force.columns);
  DenseVector change(nc);
  for (Index k = 0; k < idle; ++k) {
    change = unfelt.col(k);
    wrenches_of_multipliers(model, work, view(change), view(scratch));
    response.col(k) = terms(system, model, work, arms, view(scratch), view(change));
  }
  // The columns are of one size and far from dependent: normal equations do, and cost less.
  const Eigen::MatrixXd normal = response.transpose().lazyProduct(response);
  change = -unfelt * normal.ldlt().solve(response.transpose() * now);
  dense(lam) += change;
  wrenches_of_multipliers(model, work, view(change), view(scratch));
  for (Index i = 0; i < wrench.rows; ++i) {
    for (Index n = 0; n < work.size(); ++n) {
      wrench(i, n) += scratch(i, n);
    }
  }
}

}  // namespace closedloop
