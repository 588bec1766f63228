// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_STEPS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_STEPS_HPP_

#include <memory>
#include <mutex>

#include "sensitivity.hpp"

// The step of states over a period, and its derivatives in both directions, as functions that
// programs without Python call by their addresses: JAX and PyTorch, from threads of theirs.

namespace closedloop
{

/// What they work with; one thread at a time. The arrays are the host's.
struct CallableSteps
{
  /// Of these steps alone.
  std::shared_ptr<System> system;
  /// Whose torques are one row, and whose instants are the ends of the period.
  SteppedRun run;
  Table scratch;
  Tape tape;
  StepRoutines routines;
  Indices actuated;  ///< Shape (na,): places of the actuated joints
  Table instants;  ///< Shape (2, nq + nv): weights or changes at both ends
  RunInputs inputs;  ///< Weights or changes of the inputs
  std::unique_ptr<std::mutex> busy;

  template<class Visitor>
  void arrays(Visitor &&) {}
};

/// A function of n inputs, each of n rows, to outputs likewise. Returns 0, or 16 times the number of
/// the state that failed plus a `Status`.
using RowsFunction = Index (
  CallableSteps *, Index n, const double * const * in, double * const * out);

/// q, qd and torques to those after the period.
RowsFunction step_rows;
/// The same and changes of all three to the changes after the period.
RowsFunction change_rows;
/// q, qd, torques and weights of q and qd after the period to the weights of all three.
RowsFunction weight_rows;

/// Made of what the host has, which outlives it. Nothing interrupts its system from now on.
CallableSteps callable_steps(
  const std::shared_ptr<System> &, const SteppedRun &, Table scratch, const Tape &,
  const StepRoutines &, Indices actuated, Table instants, const RunInputs &);

/// Addresses of the steps, then of the three functions.
void fill_addresses(CallableSteps &, Indices out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_STEPS_HPP_
