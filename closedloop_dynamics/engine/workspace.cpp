// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "workspace.hpp"

#include <algorithm>
#include <numeric>

namespace closedloop
{

namespace
{
constexpr Index HEALTH_COLUMNS = 11, JOINT_COLUMNS = 3;
constexpr Index WORK_COLUMNS = 31, COUPLED_WORK_COLUMNS = 33, SPATIAL_WORK_COLUMNS = 81;

Index columns_of_bodies(const Model & model)
{
  if (!model.planar()) {
    return SPATIAL_WORK_COLUMNS;
  }
  for (Index i = 0; i < model.tree.rows; ++i) {
    // In the plane: whether a coupling reads the joint.
    if (model.tree(i, tree::AXIS) != 0) {
      return COUPLED_WORK_COLUMNS;
    }
  }
  return WORK_COLUMNS;
}

/// The most equations that a cut joint works on, or may: three at least.
Index most_equations(const Model & model, cut::Column column)
{
  Index most = 3;
  for (Index a = 0; a < model.cut.rows; ++a) {
    most = std::max(most, count_equations(model.cut(a, column)));
  }
  return most;
}
}  // namespace

Workspace::Workspace(const Model & model)
: body(model.tree.rows, columns_of_bodies(model)),
  response(model.path_body.size, most_equations(model, cut::KEPT)),
  response_scaled(response.rows, response.columns), factor(model.row.size),
  scale(model.equations()), lever(response.rows, response.columns),
  joint(model.tree.rows, JOINT_COLUMNS), change(model.joints()), pivot_inverse(scale.size),
  right(scale.size), scatter(scale.size), closure(scale.size), closure_rate(scale.size),
  bias(scale.size), equation(most_equations(model, cut::POSSIBLE) * (3 + 2 * model.size())),
  wrench(2, model.size()), share(3 * model.size()), torque(model.joints()),
  force(model.tree.rows, 2 * model.size()), health(HEALTH_COLUMNS)
{
  // The ground's axes.
  if (model.planar()) {
    body(0, plane::COS) = 1.0;
  } else {
    body(0, space::FRAME) = body(0, space::FRAME + 4) = body(0, space::FRAME + 8) = 1.0;
  }
}

bool Workspace::fits(const Model & model) const
{
  return body.rows == model.tree.rows && body.columns >= columns_of_bodies(model) &&
         size() == model.size() && response.rows == model.path_body.size &&
         response.columns >= most_equations(model, cut::KEPT) && factor.size == model.row.size &&
         scale.size == model.equations() &&
         equation.size >= most_equations(model, cut::POSSIBLE) * (3 + 2 * size());
}

Partition::Partition(const Model & model)
: order(model.joints()), jac(model.equations(), model.joints()), scaled(jac.rows, jac.columns),
  matrix(jac.rows, jac.rows), pivots(jac.rows), right(jac.rows), change(model.joints()), record(3)
{
  forget();
}

void Partition::forget()
{
  std::iota(order.begin(), order.end(), 0);
  record.fill(0.0);
}

}  // namespace closedloop
