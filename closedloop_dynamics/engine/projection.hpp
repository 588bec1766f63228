// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__PROJECTION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__PROJECTION_HPP_

#include "data.hpp"

// Corrections of a state: onto the loop closures, in the mass metric, and onto unit quaternions. They
// are part of every step: without allocation, by generated code or by the factors of an evaluation,
// which loop_solver.hpp does without.

namespace closedloop
{

/// Corrections of the positions of a state. Newton's method doubles the digits each time: more do
/// not help.
constexpr Index MOST_POSITION_CORRECTIONS = 8;

/// Correct a state, shape (ns,), in place; return whether the loops are closed if positions were
/// corrected. Quaternions get norm 1 in any case, which keeps the order of the method.
bool stabilise(const System &, Stabilisation, Values state);

/// The same of a state between the ends of a step: independent coordinates stay those of the step,
/// so that a run does not depend on its output times.
bool stabilise_between(const System &, Stabilisation, Values state);

/// The least change of coordinates or rates that closes the loops, into System.qdd, by the factors
/// and closure errors that are in the workspace.
void correct_by_loops(const System &, Level);

/// Whether no value is infinite or NaN.
bool all_finite(Values);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__PROJECTION_HPP_
