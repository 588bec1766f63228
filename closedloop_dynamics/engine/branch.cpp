// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch.hpp"

#include "branch_places.hpp"
#include "elimination.hpp"
#include "evaluation.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "projection.hpp"
#include "recursion.hpp"
#include "refinement.hpp"
#include "routines.hpp"
#include "scratch.hpp"

namespace closedloop
{

namespace
{
// Pivots below this, the square of twice the singular value at which a state is interpolated from
// places around it: rounding, divided three times by its root, would show in accelerations.
constexpr double NEAR_PIVOT = 4e-6;
// Most corrections onto the branch: from 1e-4 beside it, two reach rounding.
constexpr int MOST_CORRECTIONS = 4;
// Closure error, against the size of the mechanism, that counts as on the branch; and the one,
// against the smallest pivot, from which the nearest branch is certain to be that of the state.
constexpr double SETTLED = 1e-10, CERTAIN = 0.01;
// Numbers of all arrays that are needed here.
constexpr Index ROOM = 1024;

/// Add forces to those on the bodies.
void add_forces(const Workspace & work, Table forces)
{
  for (Index i = 0; i < forces.rows; ++i) {
    for (Index n = 0; n < forces.columns; ++n) {
      work.body(i, work.first_force() + n) += forces(i, n);
    }
  }
}

/// Evaluate closure errors of a state, and their corrections in System.corrections or factors for
/// the loops over bodies. The pivots of the geometry count, not those of the state.
bool prepare_corrections(const System & system, Values q, Values qd)
{
  if (system.is_unrolled()) {
    call(system.table, routine::CORRECTION, q, qd);
    return true;
  }
  outward(system.model, q, qd, system.work);
  return prepare_refined(
    system.model, system.tau.part(0, system.nv()), system.work, NEAR_PIVOT);
}

/// The least change that corrects errors of positions or rates, shape (nv,).
Values correction(const System & system, Level level)
{
  if (system.is_unrolled()) {
    return system.corrections[level == Level::POSITION ? 0 : 1];
  }
  correct_by_loops(system, level);
  return system.qdd;
}

/// Bring a state onto the branch next to it, in place; return whether it is there.
bool return_to_branch(const System & system, Values q, Values qd, double pivot)
{
  const double size = system.settings[setting::SIZE];
  for (int count = 0; ; ++count) {
    if (!prepare_corrections(system, q, qd)) {
      return false;
    }
    const double error = largest(system.work.closure);
    if (count == 0 && !(error <= CERTAIN * pivot * size)) {
      return false;
    }
    if (!(error > ROUNDING * size && count < MOST_CORRECTIONS)) {
      const Values change = correction(system, Level::VELOCITY);
      for (Index i = 0; i < qd.size; ++i) {
        qd[i] += change[i];
      }
      return error <= SETTLED * size;
    }
    move(system.manifold, q, correction(system, Level::POSITION), 1.0);
  }
}

/// Accelerations on the nearest branch, to which the state is moved; false without a branch near.
bool accelerate_beside(const System & system, Values q, Values qd, Table added, double pivot)
{
  if (!return_to_branch(system, q, qd, pivot)) {
    return false;
  }
  outward(system.model, q, qd, system.work);
  add_forces(system.work, added);
  return accelerate_refined(
    system.model, system.work, system.applied, 0.0, system.qdd, system.lam, NEAR_PIVOT);
}
}  // namespace

bool accelerate_on_branch(const System & system, Values q, Values qd)
{
  const Workspace & work = system.work;
  const Values & health = work.health;
  const double pivot = health[health::SMALLEST_PIVOT];
  const Index size = work.size(), bodies = system.has_effects() ? work.body.rows : 0;
  const Index numbers = q.size + qd.size + bodies * size;
  if (!(system.settings[setting::BAUMGARTE_GAIN] == 0.0 && !good(system.model, pivot, POOR_PIVOT) &&
    numbers <= ROOM))
  {
    return false;
  }
  Scratch<double, ROOM> scratch(numbers);
  // Forces of effects on bodies are evaluated at the state itself.
  const Table added = scratch.take(bodies, size);
  if (bodies > 0) {
    outward(system.model, q, qd, work);
    bias_forces(work, added);
    apply_listed(system, q, qd);
    for (Index i = 0; i < bodies; ++i) {
      for (Index n = 0; n < size; ++n) {
        added(i, n) = work.body(i, work.first_force() + n) - added(i, n);
      }
    }
  }
  const bool found = good(system.model, pivot, NEAR_PIVOT) ?
    accelerate_beside(system, scratch.copy_of(q), scratch.copy_of(qd), added, pivot) :
    accelerate_by_places(system, q, qd, added);
  if (found) {
    health[health::RANK_REVEALING_COUNT] += 1.0;
    health[health::SINGULAR_COUNT] += 1.0;
  }
  outward(system.model, q, qd, work);
  add_forces(work, added);
  update(system.model, work, Responses::NONE);
  return found;
}

}  // namespace closedloop
