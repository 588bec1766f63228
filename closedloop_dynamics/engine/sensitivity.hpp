// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SENSITIVITY_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SENSITIVITY_HPP_

#include <utility>

#include "batch.hpp"
#include "projection.hpp"
#include "runge_kutta.hpp"

// Runs by steps of one size, and their derivatives by the start, the torques and the parameters:
// forward in one direction, or in reverse by all of them. The discrete steps are differentiated,
// with their stabilisation. Effects are smooth functions of coordinates and rates.

namespace closedloop
{

/// How a run is made (simulation/stepped_run.py).
struct SteppedRun
{
  /// Without weights: semi-implicit Euler.
  Tableau tableau;
  /// NONE, VELOCITY or PROJECTION.
  Stabilisation stabilisation = Stabilisation::NONE;
  double step_size = 0.0;  ///< [s]
  /// Steps that a row of torques acts for, and from one instant to the next.
  Index zero_order_hold = 1;
  Index decimation = 1;
  /// Shape (rows, nv + nk): torques and forces in the joints [N m, N].
  Table torque;

  /// Evaluations in a step.
  Index stages() const {return tableau.steps() > 0 ? tableau.steps() : 1;}

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "tableau, stabilisation, step_size, zero_order_hold>=1, decimation>=1, torque[rows,T]",
      tableau, stabilisation, step_size, zero_order_hold, decimation, torque);
  }
};

/// Data of a run for its derivatives.
struct Tape
{
  Table state;  ///< Shape (steps + 1, ns)
  /// Shape (steps, stages, ns + nv + nc): states, their accelerations and multipliers.
  Cube<double> stage;
  Table raw;  ///< Shape (steps, ns): states before they are stabilised
  Indices corrections;  ///< Shape (steps,): of the positions

  Index steps() const {return corrections.size;}

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "state[instants>=2<=rows*zero_order_hold+1,S], "
      "stage[instants-1,stages<=scratch_rows-20,S+V+C], raw[instants-1,S], "
      "corrections<9[instants-1]", state, stage, raw, corrections);
  }
};

/// The routines of codegen/sensitivities.py, and the arrays that they work on.
struct StepRoutines
{
  Indices table;
  Values qdd;  ///< Shape (nv,)
  Values lam;  ///< Shape (nc,)
  Values seed;  ///< Shape (nq + 2 nv + np,)
  Values result;  ///< Shape (nq + 2 nv + np,), or longer

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "table[>=N], qdd[V], lam[C], seed[seeds>=Q+2*V], result[>=seeds]", table, qdd, lam, seed,
      result);
  }
};

/// The same routines for LANES directions or weights side by side, number k of lane n at k LANES + n.
struct LaneRoutines
{
  /// Addresses: at 2 `which` the part that all directions share, at 2 `which` + 1 the rest. Behind
  /// it there may be a table of others, for positions in which those of the first one fail.
  Indices table;
  Values shared;  ///< What the former hands to the latter
  Values result;  ///< Shape (LANES (nq + 2 nv + np),), or longer

  /// Compute what all directions share; return the table that did, none where all fail.
  Indices prepare(Index which, Values q, Values qd) const;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit("table[t>=N=t/N*N], shared, result[results>=16*C]", table, shared, result);
  }
};

/// Changes or weights of the inputs of a run.
struct RunInputs
{
  Values start;  ///< Shape (nq + nv,)
  Table torque;  ///< Shape (rows, nv)
  Values parameter;  ///< Shape (np,)

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "start[Q+V], torque[>=(instants-2)/zero_order_hold+1,V], parameter[seeds-Q-2*V]", start, torque,
      parameter);
  }
};

/// Places of the routines in their table, and its length; that of routines in lanes is the same.
namespace step_routine
{
enum : Index
{
  ACCELERATION_FORWARD, ACCELERATION_REVERSE, POSITION_FORWARD, POSITION_REVERSE, RATE_FORWARD,
  RATE_REVERSE, CLOSURE_FORWARD
};
enum Array : Index {SEED = routine::TABLE_COLUMNS, RESULT, SHARED, STEP_COLUMNS};
}

/// Rows of a scratch beside one for each stage: two for each correction of positions, and four.
constexpr Index SCRATCH_ROWS = 20;
static_assert(SCRATCH_ROWS == 2 * MOST_POSITION_CORRECTIONS + 4);
// What signatures of records say in numbers, here and in chart.hpp and state_steps.hpp.
static_assert(SCRATCH_ROWS == 20 && MOST_POSITION_CORRECTIONS == 8 && LANES == 8);

/// Throws std::invalid_argument where a system cannot make such a run, or a tape is not one of it.
void check(const System &, const SteppedRun &, const Tape &);

/// Make a run from the first state of its tape. `scratch` is of shape (>= stages + SCRATCH_ROWS, ns).
/// Returns how it ended and the steps completed, -1 where the first state leaves the loops open.
std::pair<Status, Index> record_steps(
  const System &, const SteppedRun &, Table scratch, const Tape &);

/// Directional derivative of the states at all instants, shape (instants, nq + nv). SINGULAR where
/// there is no derivative, with the number of the step.
std::pair<Status, Index> change_of_steps(
  const System &, const SteppedRun &, Table scratch, const Tape &, const StepRoutines &,
  const RunInputs & change, Table out);

/// The gradient of the sum of the states at all instants times `weight`, shape (instants, nq + nv):
/// into `gradient`. SINGULAR as before.
std::pair<Status, Index> gradient_of_steps(
  const System &, const SteppedRun &, Table scratch, const Tape &, const StepRoutines &,
  Table weight, const RunInputs & gradient);

/// The same of several costs of the last state, a multiple of LANES, whose weights are side by side:
/// gradients by the inputs, in rows of torques, too. `wide`, shape (>= stages + 2, weights), is
/// scratch, and `seed`, shape (LANES nv,). False where there is no derivative.
bool gradients_in_lanes(
  const System &, const SteppedRun &, Table scratch, Table wide, Values seed, const Tape &,
  const StepRoutines &, const LaneRoutines &, Values weight, const RunInputs & gradients);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SENSITIVITY_HPP_
