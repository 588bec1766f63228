// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STATE_STEPS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STATE_STEPS_HPP_

#include <utility>

#include "chart.hpp"

// States that are advanced by a period, each under torques of its own, and the Jacobians of these
// maps in independent coordinates: what estimators and predictive controllers call again and again.

namespace closedloop
{

/// Gradients by the inputs of a run of one row of torques, in as many lanes as there are changes.
struct WideInputs : RunInputs
{
  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "start[(2*k+7)/8*8*(Q+V)], torque[1,(2*k+7)/8*8*V], parameter[(2*k+7)/8*8*entries]", start,
      torque, parameter);
  }
};

/// States before and after a period, a row or page for each (simulation/stepped_run.py).
struct StateSteps
{
  Table q;  ///< Shape (n, nq): before
  Table qd;  ///< Shape (n, nv)
  Table torque;  ///< Shape (n, na): of the actuated joints
  Indices actuated;  ///< Shape (na,): their places among the joints
  Table next_q;  ///< Shape (n, nq): after
  Table next_qd;  ///< Shape (n, nv)
  Cube<double> by_state;  ///< Shape (n, 2 k, 2 k); without pages: no Jacobians
  Cube<double> by_torque;  ///< Shape (n, 2 k, na)
  Cube<double> by_parameter;  ///< Shape (n, 2 k, np)
  Cube<double> basis;  ///< Shape (n, 2 nv, 2 k + np): of `fill_basis`, before
  /// Scratch, in as many lanes as there are changes, rounded up to a multiple of LANES: rows for the
  /// adjoint, weights at the end, shape (lanes (nq + nv),), and gradients.
  Table wide;
  Values weight;
  WideInputs gradient;

  Index states() const {return q.rows;}
  Index lanes() const {return (by_state.rows + LANES - 1) / LANES * LANES;}

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "q[n,Q], qd[n,V], torque[n,a], actuated<V[a], next_q[n,Q], next_qd[n,V], "
      "by_state[pages=0|n,2*k,2*k], by_torque[pages,2*k,a], by_parameter[pages,2*k,p], "
      "basis[pages,2*V,2*k+p], wide[>=stages+2,(2*k+7)/8*8*(Q+V)], weight[(2*k+7)/8*8*(Q+V)], "
      "gradient", q, qd, torque, actuated, next_q, next_qd, by_state, by_torque, by_parameter, basis,
      wide, weight, gradient);
  }
};

/// Advance all states by the run; its torques, one row, and the tape are scratch. Returns how it
/// ended, and the states that are done.
std::pair<Status, Index> step_states(
  const System &, const SteppedRun &, Table scratch, const Tape &, const StepRoutines &,
  const LaneRoutines &, const Chart &, const StateSteps &);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STATE_STEPS_HPP_
