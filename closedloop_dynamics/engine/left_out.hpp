// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LEFT_OUT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LEFT_OUT_HPP_

#include "data.hpp"

// Whether the kept closure equations imply all, where redundant ones are omitted. Which equations
// are redundant changes with the position: kept ones may come to depend on one another, and
// left-out ones may become independent.

namespace closedloop
{

/// Columns of AllEquations.numbers: the pivot below which other equations are looked for; the most
/// kinetic energy so far [J]; whether all but open loops is accepted, as there are none better, and
/// stays so after a step that is well; whether those left out have opened at the latest step that was
/// refused; whether others have been asked for.
namespace left_out
{
enum : Index {PIVOT, KINETIC, LENIENT, STAYS_LENIENT, OPENED, ASKED, COLUMNS};
}

/// Whether the kept equations suffice in a state, shape (ns,), after a stabilised step. They do not
/// where omitted ones are violated, where kept ones are closer to dependence than before, or where
/// the projection has discarded energy. True where none are omitted, and for stabilisations that
/// allow drift.
bool equations_suffice(const System &, Stabilisation, Values state);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LEFT_OUT_HPP_
