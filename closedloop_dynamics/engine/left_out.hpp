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

/// Whether the kept equations suffice in a state, shape (ns,), after a stabilised step. They do not
/// where omitted ones are violated, where kept ones are closer to dependence than before, or where
/// the projection has discarded energy. True where none are omitted, and for stabilisations that
/// allow drift.
bool equations_suffice(const System &, Stabilisation, Values state);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LEFT_OUT_HPP_
