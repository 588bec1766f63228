// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch.hpp"

#include <algorithm>
#include <limits>

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
// The least pivots with complete pivoting that serve beside a state without places around it; and
// pivots of the elimination, against the squares of theirs: of parallelograms and four-bars 0.5 to
// 10.
constexpr double NEAR = 2e-3, SQUARED = 3.0;
// Smallest pivots of equations that are evaluated at the state only, beside singular ones; and of
// those that are not rounding there.
constexpr double REGULAR = 0.02, CHOSEN = 1e-8;
// Equations whose factors cost less than to ask the elimination of the geometry first.
constexpr Index FEW_EQUATIONS = 8;
// Share of the derivatives at a single place, which is at all places.
constexpr Lanes FIRST{Lanes::Pair{1.0, 0.0}, Lanes::Pair{0.0, 0.0}};
// Numbers of all arrays that are needed here: at most, and on the stack.
constexpr Index ROOM = 1024;

/// Whether the nearest branch is certain to be that of a state with such a closure error.
bool is_certain(const System & system, double error, double pivot)
{
  return error <= CERTAIN * pivot * system.settings->size;
}

/// Bring a state onto the branch next to it by loops over bodies, in place; return whether it is
/// there.
bool return_to_branch(const System & system, Values q, Values qd, double pivot)
{
  const double size = system.settings->size;
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

/// Bring a point onto the branch next to it, with its derivatives, where it has been evaluated; return
/// whether it is there.
bool find_beside(BranchEquations & equations, const BranchPoint & point, double pivot)
{
  double gap = 0.0;
  for (Index i = 0; i < equations.nc; ++i) {
    gap = std::max(gap, std::abs(equations.gap(i)));
  }
  if (!is_certain(equations.system, gap, pivot)) {
    return false;
  }
  const LaneValues q = equations.place, rate = equations.rate;
  Scratch<double, ROOM> scratch(PLACES * rate.size);
  const LaneValues bend{&Lanes::at(scratch.take(PLACES * rate.size).data), rate.size};
  bend.fill(Lanes::of(0.0));
  for (Component & part : equations.components) {
    if (!equations.settle(part, q, rate)) {
      return false;
    }
    equations.count_moving(part);
    equations.follow(part, q, rate, bend);
    equations.add_tangents(part, point.tangent, FIRST);
  }
  for (Index i = 0; i < q.size; ++i) {
    point.q[i] = q[i][0];
  }
  for (Index i = 0; i < rate.size; ++i) {
    point.rate[i] = rate[i][0];
    point.path_acceleration[i] = bend[i][0];
  }
  return true;
}

/// Record how far open the loops are at the latest state, between places around it, where components
/// are singular: as far as these places are on two branches, not on one that goes through.
void record_passage(BranchEquations & equations, const BranchPoint & point)
{
  double gap = 0.0;
  for (const Component & part : equations.components) {
    for (Index i = 0; part.pivot <= REGULAR && i < part.rows; ++i) {
      gap = std::max(gap, std::abs(equations.gap(equations.row(part, i))));
    }
  }
  const Values & passage = equations.system.passage;
  if (gap > passage[0]) {
    passage[0] = gap;
    copy(point.q, passage.from(1));
  }
}

/// Find the branch through a state from places around it where components are singular; regular
/// ones are evaluated at the state, the others being on their branches.
bool find_through(
  BranchEquations & equations, Values q, Values qd, const BranchPoint & point)
{
  for (Component & part : equations.components) {
    if (part.pivot > REGULAR) {
      equations.count_moving(part);
    }
  }
  for (Component & part : equations.components) {
    if (part.pivot <= REGULAR && !interpolate(equations, part, q, qd, point)) {
      return false;
    }
  }
  equations.evaluate(point.q, point.rate);
  for (const Component & part : equations.components) {
    if (part.pivot > REGULAR) {
      // Rates are those of the point itself.
      const LaneValues bend = equations.rate;
      equations.factor(part);
      equations.find_path_acceleration(part, bend);
      equations.add_tangents(part, point.tangent, FIRST);
      for (Index k = 0; k < part.rows; ++k) {
        const Index j = equations.column(part, k);
        point.path_acceleration[j] = bend[j][0];
      }
    }
  }
  return true;
}

/// Evaluate the equations at a state, and choose dependent coordinates; return about what the
/// smallest pivot of the geometry would be, not a number where an equation has no coordinate.
double choose_dependent(BranchEquations & equations, Values q, Values qd)
{
  equations.evaluate(q, qd);
  if (!equations.find_components()) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  double least = 1.0;
  for (Component & part : equations.components) {
    part.pivot = equations.choose(part, CHOSEN);
    least = std::min(least, part.pivot);
  }
  return SQUARED * least * least;
}

/// Accelerations by dense factors of the closure equations: from places around the state, or, where
/// there are none, at the branch beside it. Beside it rounding is divided three times by the
/// smallest singular value, which is several times as large at those places.
bool accelerate_by_factors(
  BranchEquations & equations, Values q, Values qd, Table added, double pivot, Outputs outputs)
{
  const System & system = equations.system;
  Scratch<double, ROOM> scratch(q.size + qd.size * (2 + qd.size));
  const BranchPoint point{
    scratch.take(q.size), scratch.take(qd.size), scratch.take(qd.size),
    scratch.take(qd.size, qd.size)};
  const auto begin = [&]() {
      copy(q, point.q);
      copy(qd, point.rate);
      point.path_acceleration.fill(0.0);
      point.tangent.fill(0.0);
    };
  const bool multipliers = outputs >= Outputs::FORCES;
  begin();
  // Driven motions are elsewhere at other places.
  const bool driven = system.has_effects() && system.effects.motions.rows > 0;
  bool found = !driven && find_through(equations, q, qd, point);
  if (found) {
    record_passage(equations, point);
  }
  if (!found && pivot >= SQUARED * NEAR * NEAR) {
    begin();
    choose_dependent(equations, q, qd);
    found = find_beside(equations, point, pivot);
  }
  return found && accelerate_along(equations, point, added, multipliers);
}
}  // namespace

bool accelerate_on_branch(
  const System & system, Values q, Values qd, bool singular, Outputs outputs)
{
  const Workspace & work = system.work;
  const Values & health = work.health;
  const Index size = work.size(), bodies = work.body.rows;
  const Index numbers = q.size + qd.size + bodies * size;
  const bool by_loops = system.table[routine::LOOP_EQUATIONS] == 0;
  if (!(system.settings->baumgarte_gain == 0.0 && system.lam.size < qd.size &&
    numbers <= ROOM && (singular || (!by_loops && system.lam.size <= FEW_EQUATIONS))))
  {
    return false;
  }
  double pivot = health[health::SMALLEST_PIVOT];
  const bool beside = by_loops && good(system.model, pivot, NEAR_PIVOT);
  BranchEquations equations(system);
  if (!beside) {
    pivot = choose_dependent(equations, q, qd);
    if (!(pivot >= 0.0) || (!singular && good(system.model, pivot, POOR_PIVOT))) {
      return false;
    }
    record_pivot(system.model, work, pivot);
  }
  Scratch<double, ROOM> scratch(numbers);
  // Forces of effects on bodies are those at the state itself.
  const Table added = scratch.take(bodies, size);
  if (!system.has_effects()) {
    added.fill(0.0);
  } else {
    bias_forces(work, added);
    place_bodies(system, q, qd);
    for (Index i = 0; i < bodies; ++i) {
      for (Index n = 0; n < size; ++n) {
        added(i, n) -= work.body(i, work.first_force() + n);
      }
    }
  }
  if (!(beside ? accelerate_by_loops(
      system, scratch.copy_of(q), scratch.copy_of(qd), added, pivot) :
    accelerate_by_factors(equations, q, qd, added, pivot, outputs)))
  {
    return false;
  }
  health[health::RANK_REVEALING_COUNT] += 1.0;
  health[health::SINGULAR_COUNT] += 1.0;
  if (outputs == Outputs::POSES) {
    place_bodies(system, q, qd);
    add_forces(work, added);
    update(system.model, work, Responses::NONE);
  }
  return true;
}

}  // namespace closedloop
