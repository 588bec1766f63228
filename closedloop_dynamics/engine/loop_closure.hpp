// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LOOP_CLOSURE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LOOP_CLOSURE_HPP_

#include "workspace.hpp"

// Cut joints: closure error, its rates, and the response of the trees to unit cut forces.

namespace closedloop
{

/// Value, rate and bias of the equations of cut `a`, with wrenches of unit multipliers.
void measure(const Model &, const Workspace &, Index a);

/// Response of the joints on the path of cut `a` to a unit multiplier of its equation `row`;
/// `which` is a column of Workspace.kernel: REDUCE, LEVER or CARRY.
void respond(const Model &, const Workspace &, Index which, Index a, Index row);

/// Closure errors, rates and biases of all cuts, and the requested responses.
void update(const Model &, const Workspace &, Responses);

/// Largest absolute value; NaN if any is NaN.
double largest(Values);

/// Rate that rates of closure errors are compared with: the fastest of the joints, or 1/s.
double rate_scale(Values qd);

/// Accelerations of the closure errors without cut forces, in elimination order.
void free_acceleration(const Model &, const Workspace &, Values out);

/// Add the joint forces of the multipliers, in elimination order, to the right-hand sides.
void apply(const Model &, const Workspace &, Values lam);

/// Copy numbers in elimination order to the user's order.
void to_user_order(const Model &, Values ordered, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LOOP_CLOSURE_HPP_
