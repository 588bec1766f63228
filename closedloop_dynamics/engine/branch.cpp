// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch.hpp"

#include <algorithm>

#include "branch_equations.hpp"
#include "branch_motion.hpp"
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
// Most corrections onto the branch by loops over bodies: from 1e-4 beside it, two reach rounding.
constexpr int MOST_CORRECTIONS = 4;
// Closure error, against the size of the mechanism, that counts as on the branch; and the one,
// against the smallest pivot, from which the nearest branch is certain to be that of the state.
constexpr double SETTLED = 1e-10, CERTAIN = 0.01;
// Smallest pivot of equations that are evaluated at the state only, beside singular ones.
constexpr double REGULAR = 0.02;
// Numbers of all arrays that are needed here: at most, and on the stack.
constexpr Index ROOM = 1024;

/// Whether the nearest branch is certain to be that of a state with such a closure error.
bool is_certain(const System & system, double error, double pivot)
{
  return error <= CERTAIN * pivot * system.settings[setting::SIZE];
}

/// Bring a state onto the branch next to it by loops over bodies, in place; return whether it is
/// there.
bool return_to_branch(const System & system, Values q, Values qd, double pivot)
{
  const double size = system.settings[setting::SIZE];
  for (int count = 0; ; ++count) {
    outward(system.model, q, qd, system.work);
    // The pivots of the geometry count, not those of the state.
    if (!prepare_refined(
        system.model, system.tau.part(0, system.nv()), system.work, NEAR_PIVOT))
    {
      return false;
    }
    const double error = largest(system.work.closure);
    if (count == 0 && !is_certain(system, error, pivot)) {
      return false;
    }
    if (!(error > ROUNDING * size && count < MOST_CORRECTIONS)) {
      correct_by_loops(system, Level::VELOCITY);
      for (Index i = 0; i < qd.size; ++i) {
        qd[i] += system.qdd[i];
      }
      return error <= SETTLED * size;
    }
    correct_by_loops(system, Level::POSITION);
    move(system.manifold, q, system.qdd, 1.0);
  }
}

/// Accelerations on the nearest branch by loops over bodies, which take no longer for each body of
/// many; the state is moved there. False without a branch near.
bool accelerate_by_loops(const System & system, Values q, Values qd, Table added, double pivot)
{
  if (!return_to_branch(system, q, qd, pivot)) {
    return false;
  }
  outward(system.model, q, qd, system.work);
  add_forces(system.work, added);
  return accelerate_refined(
    system.model, system.work, system.applied, 0.0, system.qdd, system.lam, NEAR_PIVOT);
}

/// Bring a point onto the branch next to it, with its derivatives; return whether it is there.
bool find_beside(BranchEquations & equations, const BranchPoint & point, double pivot)
{
  if (!is_certain(equations.system, largest(equations.closure), pivot)) {
    return false;
  }
  for (Component & part : equations.components) {
    equations.evaluate(point.q, point.rate);
    if (!(equations.choose(part, 0.0) > 0.0 &&
      equations.settle(part, point.q, point.rate)))
    {
      return false;
    }
    equations.count_moving(part);
    equations.factor(part);
    equations.follow(part, point.q, point.rate, point.bend);
    equations.add_tangents(part, point.tangent, 1.0);
  }
  return true;
}

/// Find the branch through a state from places around it where components are singular; regular
/// ones are evaluated at the state, the others being on their branches.
bool find_through(BranchEquations & equations, Values q, Values qd, const BranchPoint & point)
{
  bool regular = true;
  for (Component & part : equations.components) {
    // A single component is singular, or this function is not called.
    part.regular = equations.components.size > 1 && equations.choose(part, REGULAR) > 0.0;
    regular = regular && part.regular;
  }
  for (Component & part : equations.components) {
    if (part.regular) {
      equations.count_moving(part);
    } else if (!interpolate(equations, part, q, qd, point)) {
      return false;
    }
  }
  equations.evaluate(point.q, point.rate);
  for (const Component & part : equations.components) {
    if (part.regular) {
      equations.factor(part);
      equations.bend(part, point.bend);
      equations.add_tangents(part, point.tangent, 1.0);
    }
  }
  return !regular;
}

/// Accelerations by dense factors of the closure equations, at the state or from places around it.
bool accelerate_by_factors(const System & system, Values q, Values qd, Table added, double pivot)
{
  Scratch<double, ROOM> scratch(q.size + qd.size * (2 + qd.size));
  const BranchPoint point{
    scratch.copy_of(q), scratch.copy_of(qd), scratch.take(qd.size),
    scratch.take(qd.size, qd.size)};
  point.bend.fill(0.0);
  point.tangent.fill(0.0);
  BranchEquations equations(system);
  equations.evaluate(q, qd);
  return equations.find_components() &&
         (good(system.model, pivot, NEAR_PIVOT) ? find_beside(equations, point, pivot) :
         find_through(equations, q, qd, point)) &&
         accelerate_along(equations, point, added);
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
    place_bodies(system, q, qd);
    bias_forces(work, added);
    apply_listed(system, q, qd);
    for (Index i = 0; i < bodies; ++i) {
      for (Index n = 0; n < size; ++n) {
        added(i, n) = work.body(i, work.first_force() + n) - added(i, n);
      }
    }
  }
  const bool beside = good(system.model, pivot, NEAR_PIVOT);
  const bool driven = system.has_effects() && system.effects.motions.rows > 0;
  bool found = false;
  if (beside && system.table[routine::LOOP_EQUATIONS] == 0) {
    found = accelerate_by_loops(
      system, scratch.copy_of(q), scratch.copy_of(qd), added, pivot);
  } else if ((beside || !driven) && system.lam.size < qd.size) {
    found = accelerate_by_factors(system, q, qd, added, pivot);
  }
  if (found) {
    health[health::RANK_REVEALING_COUNT] += 1.0;
    health[health::SINGULAR_COUNT] += 1.0;
  }
  place_bodies(system, q, qd);
  add_forces(work, added);
  update(system.model, work, Responses::NONE);
  return found;
}

}  // namespace closedloop
