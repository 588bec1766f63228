// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_HPP_

#include <array>
#include <memory>
#include <mutex>

#include "sensitivity.hpp"

// What a model makes of states and torques, and its derivatives in both directions, as functions that
// programs without Python call by their addresses: JAX and PyTorch, from threads of theirs.

namespace closedloop
{

/// RowInputs and outputs: arrays of n rows each. The inputs are first q, qd and the torques of the
/// actuated joints.
using RowInputs = const double * const *;
using RowOutputs = double * const *;

/// Three functions of rows and what they work with; one thread at a time. Its arrays are the host's.
class Callable
{
public:
  /// The system is of these functions alone: nothing interrupts it from now on.
  Callable(std::shared_ptr<System> system, Indices actuated);
  virtual ~Callable() = default;
  Callable(const Callable &) = delete;
  Callable & operator=(const Callable &) = delete;

  /// Address of this, then of the functions: of the results, of their changes, of weights. They take
  /// this, the number of rows, inputs and outputs, and return 0, or 16 times the number of the row
  /// that failed plus a `Status`.
  std::array<Index, 4> addresses();

  /// Compute the results of a row, to be written by one of the following.
  virtual Status compute(Index n, RowInputs in) = 0;
  virtual Status write_results(Index n, RowInputs in, RowOutputs out) = 0;
  /// Changes of displacements, qd and torques, behind the inputs, to the changes of the results.
  virtual Status write_changes(Index n, RowInputs in, RowOutputs out) = 0;
  /// Weights of the results, behind the inputs, to the weights of displacements, qd and torques.
  virtual Status write_weights(Index n, RowInputs in, RowOutputs out) = 0;

protected:
  /// Set coordinates, rates and torques of a row.
  void take_row(Index n, RowInputs in, Values state, Values tau) const;

  const std::shared_ptr<System> system_;
  const Indices actuated_;  ///< Shape (na,): places of the actuated joints

private:
  template<Status (Callable::* Write)(Index, RowInputs, RowOutputs)>
  static Index of_rows(Callable * of, Index count, RowInputs in, RowOutputs out);

  std::mutex busy_;
};

/// Steps over a period: q and qd to those after it. The torques of `run` are one row; `ends`, shape
/// (2, nq + nv): weights or changes at both ends of the period; `inputs`: those of the inputs.
std::shared_ptr<Callable> callable_steps(
  const std::shared_ptr<System> &, const SteppedRun & run, Table scratch, const Tape &,
  const StepRoutines &, Indices actuated, Table ends, const RunInputs & inputs);

/// Accelerations and multipliers. `state`, shape (ns,); `table`, as for `call_for_columns`, whose
/// routines read `qdd` and `lam`, shapes (nv,) and (nc,); `columns` and `found`, shape
/// (blocks, LANES (nv + nc)): changes of the residuals, and of the results by these, LANES of them
/// side by side.
std::shared_ptr<Callable> callable_dynamics(
  const std::shared_ptr<System> &, Values state, Indices actuated, Indices table, Values qdd,
  Values lam, Table columns, Table found);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_HPP_
