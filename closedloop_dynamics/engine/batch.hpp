// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BATCH_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BATCH_HPP_

#include <vector>

#include "run.hpp"

// Whole runs of several states at a time, side by side in vector lanes.

namespace closedloop
{

/// Lanes of a batch; codegen/function_table.py has the same number.
constexpr Index LANES = 8;

/// Mechanisms of one topology in all lanes; arrays are stored lane by lane.
struct Batch
{
  Indices table;  ///< Of their routines
  Values tau;  ///< Shape (LANES * nv,): joint torques
  Values qdd;  ///< Shape (LANES * nv,): accelerations
  Values closure;  ///< Shape (LANES * nc,): closure errors of the latest correction
  Table corrections;  ///< Shape (2, LANES * nv): of coordinates and rates
  Values tolerance;  ///< Shape (LANES,): closure tolerance of the projection
  Values limit;  ///< Shape (LANES,): closure error at which it gives up
  Values error;  ///< Shape (LANES,): largest closure error of each lane
  Manifold manifold;  ///< Of all of them
  Values rates;  ///< Shape (LANES * nz,): of the effects' states
  /// Gaps of effects, shape (LANES * rows * columns,): as Contacts.now and Contacts.trial.
  Values gaps;
  Values trials;
  /// Shape (LANES * 3,): results of the routine of energies, where there is one: as of Stored.
  Values energies;
  /// Shape (LANES * nf * (nv + nc),): what each friction changes of accelerations and multipliers;
  /// and (LANES * nf,): its limit, zero where its joint slides.
  Values response;
  Values friction;

  Index nv() const {return qdd.size / LANES;}
  /// The routine that evaluates states: EVALUATION where closure errors decay.
  Index evaluation() const
  {
    return table[routine::MOTION] != 0 ? routine::MOTION : routine::EVALUATION;
  }
  Index nq() const {return nv() + manifold.balls.rows;}

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "table, tau, qdd, closure, corrections, tolerance, limit, error, manifold, rates, gaps, "
      "trials, energies, response, friction", table, tau, qdd, closure, corrections, tolerance,
      limit, error, manifold, rates, gaps, trials, energies, response, friction);
  }
};

/// A run of a lane by itself, for its guards (simulation/batch.py).
struct Lane
{
  const System * system = nullptr;
  const Run * run = nullptr;

  template<class Visitor>
  void fields(Visitor && visit) {visit("system, run", system, run);}
};

/// Make whole runs of fixed steps of all lanes; arguments as of `run_samples`, `state` of shape
/// (LANES * ns,), `torque` (rows, LANES * nv). `lanes`: the lanes
/// in use, all of one method; the others repeat the last of them. Positions and
/// velocities, shapes (LANES, instants, nq or nv), are written in place; `status` and `found`,
/// shapes (lanes,) and (lanes, finding::COLUMNS): the end of each run. Not DONE: results are
/// undefined; SINGULAR: a state needs methods of single runs.
Status run_batch(
  const Batch &, const std::vector<Lane> & lanes, Values state, Table torque,
  Index zero_order_hold, Index decimation, Index steps, Cube<double> position,
  Cube<double> velocity, Indices status, Table found);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BATCH_HPP_
