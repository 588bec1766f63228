// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_DYNAMICS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_DYNAMICS_HPP_

#include <memory>
#include <mutex>

#include "data.hpp"

// Accelerations and multipliers of states, and their derivatives in both directions, as functions
// that programs without Python call by their addresses, as callable_steps.hpp has those of steps.

namespace closedloop
{

/// What they work with; one thread at a time. The arrays are the host's.
struct CallableDynamics
{
  /// Of these functions alone.
  std::shared_ptr<System> system;
  Values state;  ///< Shape (ns,)
  Indices actuated;  ///< Shape (na,): places of the actuated joints
  Indices table;  ///< As for `call_for_columns`
  Values qdd;  ///< Shape (nv,): read by its routines
  Values lam;  ///< Shape (nc,)
  Table columns;  ///< Changes of the residuals, and of accelerations and multipliers by these,
  Table found;  ///< shape (blocks, LANES (nv + nc)), LANES of them side by side
  std::unique_ptr<std::mutex> busy;

  template<class Visitor>
  void arrays(Visitor &&) {}
};

/// As `RowsFunction`.
using DynamicsFunction = Index (
  CallableDynamics *, Index n, const double * const * in, double * const * out);

/// q, qd and torques to accelerations and multipliers.
DynamicsFunction dynamics_rows;
/// The same and changes of displacements, qd and torques to the changes of both.
DynamicsFunction dynamics_change_rows;
/// q, qd, torques and weights of accelerations and multipliers to the weights of displacements, qd
/// and torques.
DynamicsFunction dynamics_weight_rows;

/// Made of what the host has, which outlives it. Nothing interrupts its system from now on.
CallableDynamics callable_dynamics(
  const std::shared_ptr<System> &, Values state, Indices actuated, Indices table, Values qdd,
  Values lam, Table columns, Table found);

/// Addresses of the dynamics, then of the three functions.
void fill_dynamics_addresses(CallableDynamics &, Indices out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__CALLABLE_DYNAMICS_HPP_
