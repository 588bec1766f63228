// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "validation.hpp"

#include <algorithm>

namespace closedloop
{

namespace
{
constexpr Index TREE_COLUMNS = 6, CUT_COLUMNS = 14, HEALTH_COLUMNS = 10, SETTINGS = 7;
constexpr Index BODY_STAGES = 13, TABLE_COLUMNS = 23;

/// Whether all entries of a column are within bounds.
bool within(Indexes table, Index column, Index first, Index low, Index high)
{
  for (Index i = first; i < table.rows; ++i) {
    if (table(i, column) < low || table(i, column) > high) {
      return false;
    }
  }
  return true;
}

bool within(Indices values, Index low, Index high)
{
  return std::all_of(
    values.begin(), values.end(), [=](Index each) {return each >= low && each <= high;});
}

const char * misfit(const Model & model, Index nq)
{
  const Index bodies = model.tree.rows, nv = bodies - 1, cuts = model.cut.rows;
  const Index nc = model.equations(), entries = model.path_body.size;
  if (bodies < 1 || model.tree.columns != TREE_COLUMNS || model.body.rows != bodies) {
    return "model.tree and model.body";
  }
  if (model.gravity.size != 2 && model.gravity.size != 3) {
    return "model.gravity";
  }
  for (Index i = 1; i < bodies; ++i) {
    if (model.tree(i, tree::PARENT) < 0 || model.tree(i, tree::PARENT) >= i) {
      return "model.tree: parents come before their children";
    }
  }
  if (!within(model.tree, tree::DOF, 1, 0, nv - 1) ||
    !within(model.tree, tree::COORDINATE, 1, 0, nq - 1))
  {
    return "model.tree: places of coordinates";
  }
  if (model.cut.columns != CUT_COLUMNS || model.cut_point.rows != cuts) {
    return "model.cut and model.cut_point";
  }
  for (Index a = 0; a < cuts; ++a) {
    const Index * cut = model.cut.row(a);
    if (cut[cut::ROWS] < 0 || cut[cut::ROW] < 0 || cut[cut::ROW] + cut[cut::ROWS] > nc ||
      cut[cut::CUT_ROW] < 0 || cut[cut::CUT_ROW] + cut[cut::ROWS] > nc ||
      cut[cut::NUMBER] < 0 || cut[cut::NUMBER] >= cuts)
    {
      return "model.cut: places of equations";
    }
    if (cut[cut::PATH_A] < 0 || cut[cut::PATH_B] < cut[cut::PATH_A] ||
      cut[cut::PATH_COMMON] < cut[cut::PATH_B] || cut[cut::PATH_END] < cut[cut::PATH_COMMON] ||
      cut[cut::PATH_END] > entries)
    {
      return "model.cut: paths";
    }
  }
  if (!within(model.cut, cut::BODY_A, 0, 0, nv) || !within(model.cut, cut::BODY_B, 0, 0, nv) ||
    !within(model.path_body, 0, nv))
  {
    return "model.cut and model.path_body: bodies";
  }
  return nullptr;
}

const char * misfit(const Workspace & work, const Model & model)
{
  const Index bodies = model.tree.rows, nv = bodies - 1, nc = model.equations();
  const Index size = model.gravity.size == 2 ? 3 : 6, entries = model.path_body.size;
  const Index most = std::max<Index>(3, work.response.columns);
  const bool fits =
    work.body.rows == bodies && work.response.rows == entries &&
    work.response_scaled.rows == entries && work.lever.rows == entries &&
    work.response_scaled.columns == work.response.columns &&
    work.lever.columns == work.response.columns && work.scale.size == nc &&
    work.joint.rows == bodies && work.joint.columns == 3 && work.change.size == nv &&
    work.pivot_inverse.size == nc && work.right.size == nc && work.scatter.size == nc &&
    work.closure.size == nc && work.closure_rate.size == nc && work.bias.size == nc &&
    work.equation.size >= most * (3 + 2 * size) && work.wrench.rows == 2 &&
    work.wrench.columns == size && work.share.size == 3 * size && work.torque.size == nv &&
    work.force.rows == bodies && work.force.columns == 2 * size && work.piece.rows == bodies &&
    work.piece.columns == BODY_STAGES && work.cut_piece.rows == model.cut.rows &&
    work.cut_piece.columns == 2 && work.health.size == HEALTH_COLUMNS;
  return fits ? nullptr : "workspace";
}

bool fits(const Contacts & contacts, Index count)
{
  const Cube<double> & nodes = contacts.nodes;
  return within(contacts.rows, 0, count - 1) && contacts.mode.size == count &&
         contacts.now.rows == count && contacts.now.columns == contact::NODE_COLUMNS &&
         contacts.start.rows == count && contacts.start.columns == contact::NODE_COLUMNS &&
         contacts.trial.rows == count && contacts.trial.columns == contact::TRIAL_COLUMNS &&
         nodes.pages == contact::LEVELS + 3 && nodes.rows == count &&
         nodes.columns == contact::NODE_COLUMNS && contacts.search.size == contact::SEARCH_LENGTH;
}

const char * misfit(const EffectTable & effects, const System & system)
{
  const Index count = effects.count(), bodies = system.model.tree.rows;
  const bool good =
    effects.enabled.size == count && effects.index.rows == count && effects.index.columns == 6 &&
    effects.values.rows == count && effects.values.columns == 13 &&
    effects.output.rows == count && effects.output.columns == 5 &&
    effects.rates.size == effects.states.size && effects.scale.size == effects.states.size &&
    effects.applied.size == system.tau.size &&
    effects.applied.size == system.nv() + effects.cuts.index.rows &&
    effects.sticking.rows.size >= 1 && effects.sticking.hold.size == count &&
    fits(effects.contacts, count) &&
    within(effects.index, effect::STATE, 0, 0, effects.states.size) &&
    within(effects.index, effect::DATA, 0, 0, effects.data.size) &&
    (effects.reaction.rows == 0 || effects.reaction.rows == bodies);
  return good ? nullptr : "effects";
}
}  // namespace

const char * misfit(const System & system)
{
  if (const char * found = misfit(system.model, system.nq())) {
    return found;
  }
  if (const char * found = misfit(system.work, system.model)) {
    return found;
  }
  const Index nv = system.model.joints();
  if (system.qdd.size != nv || system.tau.size < nv || system.applied.size != nv ||
    system.lam.size != system.model.equations())
  {
    return "tau, qdd, applied and lam";
  }
  if (system.settings.size != SETTINGS || system.table.size != TABLE_COLUMNS) {
    return "settings and table";
  }
  if (system.corrections.rows != 2 || (system.is_unrolled() && system.corrections.columns != nv)) {
    return "corrections";
  }
  if (!system.manifold.empty() && (
      system.manifold.balls.columns != 2 || system.manifold.place.size != nv ||
      system.manifold.number.size != nv || !within(system.manifold.place, -1, system.nq() - 1) ||
      !within(system.manifold.balls, 0, 0, 0, system.nq() - 4) ||
      !within(system.manifold.balls, 1, 0, 0, nv - 3)))
  {
    return "manifold";
  }
  if (system.is_independent() && (
      system.partition.order.size != nv || system.partition.jac.columns != nv ||
      system.partition.jac.rows != system.lam.size))
  {
    return "partition";
  }
  if (!system.whole.empty()) {
    if (const char * found = misfit(system.whole.work, system.whole.model)) {
      return found;
    }
    if (const char * found = misfit(system.whole.own, system.whole.model)) {
      return found;
    }
    if (system.whole.numbers.size != 4 || system.whole.energy.size != 2) {
      return "numbers of all equations";
    }
    if (system.whole.lam.size != system.whole.model.equations() ||
      system.whole.kept.size != system.whole.lam.size ||
      std::count_if(
        system.whole.kept.begin(), system.whole.kept.end(), [](Index each) {return each != 0;}) !=
      system.lam.size)
    {
      return "all equations";
    }
  }
  const JointPlaces & joints = system.joints;
  if (joints.point.rows != 2 * joints.body.rows || joints.row.size > joints.body.rows ||
    (joints.body.rows > 0 && (joints.body.columns != 2 || joints.point.columns !=
    (system.work.planar() ? 2 : 3))) || !within(joints.row, 1, nv) ||
    !within(joints.body, 0, 0, 0, nv) || !within(joints.body, 1, 0, 0, nv))
  {
    return "joints";
  }
  return system.has_effects() ? misfit(system.effects, system) : nullptr;
}

}  // namespace closedloop
