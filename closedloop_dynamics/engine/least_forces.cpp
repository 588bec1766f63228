// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "least_forces.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>

#include "forces.hpp"
#include "null_space.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
// Pivots below this times the largest belong to equations that repeat others.
constexpr double REPEATED = 1e-9;
// Of one joint: a force and two moments.
constexpr Index TERMS = 9;

void write(Vector3 from, double * to)
{
  to[0] = from.x;
  to[1] = from.y;
  to[2] = from.z;
}

/// What counts of a wrench about the place `about`.
void terms_of_wrench(
  const double * wrench, bool planar, Vector3 about, Vector3 a, Vector3 b, double size,
  double * out)
{
  const Vector3 force = planar ? Vector3{wrench[1], wrench[2], 0.0} : vector3(wrench + 3);
  const Vector3 moment = planar ? Vector3{0.0, 0.0, wrench[0]} : vector3(wrench);
  const double unit = std::sqrt(0.5) / size;
  write(force, out);
  write(unit * (moment + cross(about - a, force)), out + 3);
  write(unit * (moment + cross(about - b, force)), out + 6);
}

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

/// All that counts: of the joints of the tree and the cut joints, and of other equations.
Eigen::VectorXd terms(
  const System & system, const Model & model, const Workspace & work, Table wrench, Values lam)
{
  const JointPlaces & joints = system.joints;
  const Index in_tree = joints.row.size, count = joints.body.rows, cuts = count - in_tree;
  const double size = system.settings[setting::SIZE];
  Eigen::VectorXd found = Eigen::VectorXd::Zero(TERMS * count + lam.size);
  for (Index k = 0; k < in_tree; ++k) {
    const Index i = joints.row[k];
    Vector3 origin;
    if (work.planar()) {
      const Vector2 place = origin_in_plane(work.body, i);
      origin = {place.x, place.y, 0.0};
    } else {
      origin = origin_in_space(work.body, i);
    }
    terms_of_wrench(
      wrench.row(i), work.planar(), origin, joint_point(joints, work, k, 0),
      joint_point(joints, work, k, 1), size, found.data() + TERMS * k);
  }
  for (Index a = 0; a < model.cut.rows; ++a) {
    const Index number = model.cut(a, cut::NUMBER), first = model.cut(a, cut::CUT_ROW);
    if (number >= cuts) {
      for (Index n = first; n < first + model.cut(a, cut::ROWS); ++n) {
        found[TERMS * count + n] = lam[n] / size;
      }
      continue;
    }
    wrenches_of_cut(model.cut, model.cut_point, work.cut_piece, work.body, lam, work.share, a);
    const Index k = in_tree + number;
    const Vector3 place = joint_point(joints, work, k, 0);
    terms_of_wrench(
      work.share.data, work.planar(), place, place, joint_point(joints, work, k, 1), size,
      found.data() + TERMS * k);
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
  const System & system, const Model & model, const Workspace & work, Table wrench, Values lam,
  Index independent)
{
  const Index nc = model.equations();
  DenseMatrix jac(nc, model.joints());
  constraint_jacobian(model, work, view(jac));
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
  const Eigen::MatrixXd turned = columns.householderQ() * Eigen::MatrixXd::Identity(nc, nc);
  const Eigen::MatrixXd unfelt = turned.rightCols(idle);
  const Eigen::VectorXd now = terms(system, model, work, wrench, lam);
  Eigen::MatrixXd response(now.size(), idle);
  DenseMatrix scratch(work.force.rows, work.force.columns);
  DenseVector change(nc);
  for (Index k = 0; k < idle; ++k) {
    change = unfelt.col(k);
    wrenches_of_multipliers(model, work, view(change), view(scratch));
    response.col(k) = terms(system, model, work, view(scratch), view(change));
  }
  change = -unfelt * response.colPivHouseholderQr().solve(now);
  dense(lam) += change;
  wrenches_of_multipliers(model, work, view(change), view(scratch));
  for (Index i = 0; i < wrench.rows; ++i) {
    for (Index n = 0; n < work.size(); ++n) {
      wrench(i, n) += scratch(i, n);
    }
  }
}

}  // namespace closedloop
