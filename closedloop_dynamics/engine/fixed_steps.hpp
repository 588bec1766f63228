// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__FIXED_STEPS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__FIXED_STEPS_HPP_

#include <utility>

#include "interrupt.hpp"
#include "runge_kutta.hpp"

// Whole steps of one size, with a stabilisation after each.

namespace closedloop
{

/// Advance a state in place by `steps` steps of `step_size` [s]; on failure it is the one before
/// the failing step. A tableau without weights stands for semi-implicit Euler. `scratch` is of
/// shape (stages + 3, ns). Returns the status and the steps completed.
std::pair<Status, Index> advance_fixed(
  const System &, const Tableau &, Stabilisation, Table scratch, Values state, double step_size,
  Index steps);

/// The same within a longer run that can be interrupted.
std::pair<Status, Index> make_fixed_steps(
  const System &, const Tableau &, Stabilisation, Values state, double step_size, Index steps,
  Table scratch, Interrupt &);

/// State at a share of a step, by the parabola through both its ends with a slope at its start;
/// quadratic, which is enough to see where a path leads.
void interpolate_parabola(
  const System &, Values state, Values slope, Values out, double size, double share,
  Values between);

/// A step that is taken in parts, as joints come to rest or forces have corners within it.
struct Parts
{
  double whole;  ///< Size of the step [s]
  double left;  ///< What is left of it [s]
  double size;  ///< The next part [s]
  int cuts = 0;

  explicit Parts(double step_size)
  : whole(step_size), left(step_size), size(step_size) {}

  /// Find whether the part from `state` to `out` must be shorter as a joint turns round within it.
  bool shorten(const System &, Values state, Values out);
  /// Accept the part: `state` becomes `out`.
  void accept(const System &, Values state, Values out);
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__FIXED_STEPS_HPP_
