// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "projection.hpp"

#include <cmath>

#include "elimination.hpp"
#include "evaluation.hpp"
#include "forward_dynamics.hpp"
#include "independent.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "rank_revealing.hpp"
#include "recursion.hpp"
#include "refinement.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
// Closure tolerance near a singular configuration, against the ordinary one.
constexpr double SHARPER = 1e-3;
// Smallest singular value of the equations that the elimination works on, against that of all, from
// which on they close the loops as well.
constexpr double AS_GOOD = 0.1;

/// What computes the corrections of a state; all but the last change it least in the mass metric.
enum class Corrector {ROUTINE, LOOPS, RANK, DEPENDENT};

/// Factor by loops over bodies; return whether the closure equations are independent.
bool factor_by_loops(const System & system, Values q, Values qd)
{
  // Behind the joints of the tree are cut joints.
  const Values tau = system.tau.part(0, system.nv());
  outward(system.model, q, qd, system.work);
  if (prepare(system.model, tau, system.work)) {
    return true;
  }
  outward(system.model, q, qd, system.work);
  return prepare_refined(system.model, tau, system.work);
}

/// Prepare corrections at a state: closure errors, responses, factors.
Corrector factor_configuration(const System & system, Values q, Values qd)
{
  if (system.is_independent()) {
    factor_dependent(system, q, qd);
    return Corrector::DEPENDENT;
  }
  if (system.is_unrolled()) {
    if (call(system.table, routine::CORRECTION, q, qd)) {
      return Corrector::ROUTINE;
    }
    if (system.table[routine::REFINED_CORRECTION] != 0) {
      return call(system.table, routine::REFINED_CORRECTION, q, qd) ?
             Corrector::ROUTINE : Corrector::RANK;
    }
  }
  return factor_by_loops(system, q, qd) ? Corrector::LOOPS : Corrector::RANK;
}

/// The change that closes the loops into System.qdd: -I^-1 J^T (J I^-1 J^T)^+ times the error, the
/// least in the mass metric, or that of the dependent coordinates.
void correction(
  const System & system, Corrector corrector, bool kept, Level level, Values q, Values qd)
{
  if (corrector == Corrector::DEPENDENT) {
    correct_dependent(system, level, qd);
  } else if (corrector == Corrector::LOOPS) {
    correct_by_loops(system, level);
  } else if (corrector == Corrector::ROUTINE) {
    copy(system.corrections[level == Level::POSITION ? 0 : 1], system.qdd);
  } else {
    const Model & model = kept ? system.model : system.whole.model;
    const Workspace & work = kept ? system.work : system.whole.work;
    outward(model, q, qd, work);
    correct_rank_revealing(model, work, system.model.equations(), level, system.qdd);
  }
}

/// Whether the equations that the elimination works on close the loops as well as all of them.
bool kept_serve(const System & system, Values q, Values qd)
{
  const AllEquations & all = system.whole;
  if (all.empty()) {
    return true;
  }
  const Index independent = system.model.equations();
  outward(system.model, q, qd, system.work);
  const double kept = weakest_equation(system.model, system.work, independent);
  return kept >= AS_GOOD * weakest_equation(all.model, all.work, independent);
}

/// Correct rates, and positions if requested; return whether the loops are closed, to the tolerance
/// or, where closure equations are dependent, to the limit.
bool project(const System & system, Values q, Values qd, bool positions)
{
  const Workspace & work = system.work;
  const Values & out = system.qdd;
  const Settings & settings = *system.settings;
  int corrections = 0;
  Corrector corrector = factor_configuration(system, q, qd);
  double error = largest(work.closure);
  const bool kept = corrector != Corrector::RANK || kept_serve(system, q, qd);
  // Near a singular configuration a small closure error is a large one of the state.
  while (positions && corrections < MOST_POSITION_CORRECTIONS &&
    error > settings.closure_tolerance * (corrector == Corrector::RANK ? SHARPER : 1.0))
  {
    correction(system, corrector, kept, Level::POSITION, q, qd);
    move(system.manifold, q, out, 1.0);
    ++corrections;
    corrector = factor_configuration(system, q, qd);
    const double before = error;
    error = largest(work.closure);
    if (!(error < 0.5 * before)) {
      break;
    }
  }
  correction(system, corrector, kept, Level::VELOCITY, q, qd);
  for (Index i = 0; i < qd.size; ++i) {
    qd[i] += out[i];
  }
  work.health[health::PROJECTION_ITERATIONS] = corrections;
  work.health[health::CLOSURE] = error;
  return !positions || error <= settings.closure_limit;
}

bool stabilise(
  const System & system, Stabilisation stabilisation, Values state, bool after_step)
{
  // A step leaves the unit sphere by its error.
  normalise(system.manifold, state);
  if (stabilisation < Stabilisation::VELOCITY) {
    return true;
  }
  update_motions(system, state);
  const Values q = system.q(state), qd = system.qd(state);
  const bool closed = project(system, q, qd, stabilisation != Stabilisation::VELOCITY);
  if (!(after_step && system.is_independent() && are_worn(system.partition))) {
    return closed;
  }
  choose_dependent(system.partition);
  return project(system, q, qd, true);
}
}  // namespace

void correct_by_loops(const System & system, Level level)
{
  const Workspace & work = system.work;
  const Values & error = level == Level::POSITION ? work.closure : work.closure_rate;
  for (Index k = 0; k < work.right.size; ++k) {
    work.right[k] = -error[k];
  }
  solve(system.model, work, work.right);
  for (Index i = 0; i < work.body.rows; ++i) {
    work.body(i, work::RHS) = 0.0;
  }
  apply(system.model, work, work.right);
  outward_acceleration(system.model, work, system.qdd);
}

void close_by_dependent(const System & system, Values state)
{
  project(system, system.q(state), system.qd(state), true);
}

bool stabilise(const System & system, Stabilisation stabilisation, Values state)
{
  return stabilise(system, stabilisation, state, true);
}

bool stabilise_between(const System & system, Stabilisation stabilisation, Values state)
{
  return stabilise(system, stabilisation, state, false);
}

bool all_finite(Values values)
{
  for (double value : values) {
    if (!std::isfinite(value)) {
      return false;
    }
  }
  return true;
}

}  // namespace closedloop
