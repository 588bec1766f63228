// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "joint_reaction.hpp"

#include <algorithm>
#include <cmath>

#include "arms.hpp"
#include "cut_coordinates.hpp"
#include "evaluation.hpp"
#include "forces.hpp"
#include "least_forces.hpp"
#include "null_space.hpp"
#include "recursion.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
// Places in a planar wrench.
constexpr Index FORCE_X = 1, FORCE_Y = 2;
// Evaluations after which loads at the start count as found.
constexpr int MOST_ROUNDS = 20;

bool is_loaded(const EffectTable & table, Index row)
{
  return table.enabled[row] == 1 && table.feels[row] == 1;
}

/// The state of an effect follows a reaction [N].
void follow_load(const EffectTable & table, Index row, double size)
{
  const Index state = table.first_state[row] + 1;
  table.rates[state] =
    (size - table.states[state]) / table.values(row, effect::LOAD_TIME);
  table.output(row, 2) = size;
}

/// Force in a joint of the tree, across the axis of a prismatic one [N]: in the plane, in space.
double planar_load(Indexes tree, Table body, Table reaction, Index i)
{
  const double fx = reaction(i, FORCE_X), fy = reaction(i, FORCE_Y);
  if (tree(i, tree::TYPE) == tree::PRISMATIC) {
    return std::fabs(body(i, plane::SX) * fy - body(i, plane::SY) * fx);
  }
  return std::sqrt(fx * fx + fy * fy);
}

double spatial_load(Indexes tree, Table body, Table reaction, Index i)
{
  const Vector3 force = vector3(reaction.row(i) + 3);
  double square = dot(force, force);
  if (tree(i, tree::TYPE) == tree::PRISMATIC) {
    // Z of the row's frame, or the axis that it slides along.
    const double * axis = body.row(i) + space::FRAME + tree(i, tree::AXIS);
    const double along = axis[0] * force.x + axis[3] * force.y + axis[6] * force.z;
    square = std::max(0.0, square - along * along);
  }
  return std::sqrt(square);
}

/// Force in the cut joint of coordinate `k` [N].
double cut_load(
  const EffectTable & table, const Model & model, const Workspace & work, Values lam, Index k)
{
  const CutCoordinates & cuts = table.cuts;
  const Index a = cuts.index(k, cut_coordinate::CUT);
  const double * share = work.share.data;
  wrenches_of_cut(model, work.body, lam, work.share, a);
  const bool planar = cuts.index(k, cut_coordinate::IN_PLANE) == 1;
  Vector3 force = planar ? Vector3{share[FORCE_X], share[FORCE_Y], 0.0} : vector3(share + 3);
  if (cuts.index(k, cut_coordinate::ACROSS) == 0) {
    // Forces along the slides of the joint load it, too.
    const Index first = table.applied.size - cuts.index.rows;
    for (Index n = 0; n < cuts.index.rows; ++n) {
      if (cuts.index(n, cut_coordinate::CUT) == a && cuts.index(n, cut_coordinate::SLIDES) == 1) {
        force = force + table.applied[first + n] * cut_direction(
          work.body, cuts.index(n, cut_coordinate::ROW_B), planar, cuts.values, n,
          cut_coordinate::AXIS);
      }
    }
  }
  double square = dot(force, force);
  if (cuts.index(k, cut_coordinate::ACROSS) == 1) {
    const Vector3 axis = cut_direction(
      work.body, cuts.index(k, cut_coordinate::ROW_B), planar, cuts.values, k,
      cut_coordinate::AXIS);
    const double along = dot(axis, force);
    square = std::max(0.0, square - along * along);
  }
  return std::sqrt(square);
}
}  // namespace

void load_joints(
  const System & system, const Model & model, const Workspace & work, Values qd, Values qdd,
  Values lam)
{
  const Table & wrench = system.effects.reaction;
  joint_wrenches(model, work, qdd, lam, wrench);
  if (!system.whole.empty()) {
    DenseMatrix jac(model.equations(), model.joints());
    constraint_jacobian(model, work, view(jac));
    minimise_joint_wrenches(system, model, work, view(jac), wrench, lam, system.lam.size);
  }
  update_joint_loads(model, work, system.effects, qd, lam);
}

void update_joint_loads(
  const Model & model, const Workspace & work, const EffectTable & table, Values qd, Values lam)
{
  const bool planar = work.planar();
  for (Index row = 0; row < table.count(); ++row) {
    if (is_loaded(table, row) && joint_of(table, row) < qd.size) {
      const Index i = table.places_of(row)[1];
      follow_load(
        table, row, planar ? planar_load(model.tree, work.body, table.reaction, i) :
        spatial_load(model.tree, work.body, table.reaction, i));
    }
  }
  if (table.cuts.index.rows > 0) {
    for (Index row = 0; row < table.count(); ++row) {
      if (is_loaded(table, row) && joint_of(table, row) >= qd.size) {
        follow_load(
          table, row,
          cut_load(table, model, work, lam, joint_of(table, row) - qd.size));
      }
    }
  }
}

bool feel_loads(const System & system, Values states, double share)
{
  const EffectTable & table = system.effects;
  double change = 0.0, most = 0.0;
  for (Index row = 0; row < table.count(); ++row) {
    if (table.feels[row] != 0) {
      double & felt = states[table.first_state[row] + 1];
      const double load = table.output(row, 2);
      change = std::max(change, std::abs(felt - load));
      most = std::max(most, load);
      felt = load;
    }
  }
  return !(change > share * most);
}

void begin_loads(const System & system, Values state)
{
  bool felt = false;
  for (int n = 0; n < MOST_ROUNDS && !felt; ++n) {
    evaluate_with_poses(system, state);
    felt = feel_loads(system, state.part(system.own(), system.effects.states.size), 0.0);
  }
}

}  // namespace closedloop
