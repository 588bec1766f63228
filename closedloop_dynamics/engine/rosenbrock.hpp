// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ROSENBROCK_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ROSENBROCK_HPP_

#include <utility>

#include "error_control.hpp"

// RODAS4, a linearly implicit method for stiff scenes: L-stable, stiffly accurate, order 4(3). Each
// step solves six linear systems with one factorization of I - h gamma J; the Jacobian J comes from
// generated code where the scene has derivatives and the system has that code, else from finite
// differences of the derivative. Its cost grows with the cube of the number of states.
//
// Source: Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed. (1996), section
// VI.4, in the form that needs no product with J.

namespace closedloop
{

/// Memory of the stiff method.
struct StiffRun
{
  Stabilisation stabilisation;
  Values control;  ///< As of error_control.hpp
  Table scale;  ///< Shape (2, ns): absolute and relative tolerances
  Table matrix;  ///< Shape (ns, ns)
  Indices pivots;  ///< Shape (ns,)
  Table scratch;  ///< Shape (STIFF_ROWS, ns)

  /// Make one accepted step of a state, in place, up to `limit` at most [s].
  Status accepted_step(const System &, Values state, double limit, Interrupt &) const;
};

/// Rows of the scratch of the stiff method.
constexpr Index STIFF_ROWS = 12;

/// Advance a state in place by `steps` steps of `step_size` [s]; on failure it is the one before
/// the failing step. Returns the status and the steps completed.
std::pair<Status, Index> advance_stiff_fixed(
  const System &, Stabilisation, Table matrix, Indices pivots, Table scratch, Values state,
  double step_size, Index steps);

/// Advance a state in place from REACHED to the end of the grid by error-controlled steps, the last
/// ending there; on failure the state and REACHED are the latest good ones.
Status advance_stiff(
  const System &, Stabilisation, Values control, Table scale, Table matrix, Indices pivots,
  Table scratch, Values state, double origin, Index done, double step_size, Index steps);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ROSENBROCK_HPP_
