// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LEFT_OUT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LEFT_OUT_HPP_

#include "system.hpp"

// Whether the closure equations that are kept stand for all, where some that repeat others are not.
// Which equations are redundant changes with the position: kept ones may come to depend on one
// another, and left-out ones may become independent.

namespace closedloop
{

/// Whether the kept equations serve in a state, shape (ns,), after a step that was stabilised. They
/// do not where those that are left out have opened, where they have come closer to depending on
/// one another, or where the projection has discarded energy. True where none are left out, and for
/// stabilisations that let loops drift apart.
bool equations_serve(const System &, Stabilisation, Values state);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LEFT_OUT_HPP_
