// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LIBRARY_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LIBRARY_HPP_

#include "array.hpp"

// Search functions that generated code calls, on the entries of an effect. All take the same arguments, and return the first of their results.

namespace closedloop
{

namespace library
{
/// Which of them; places of their addresses in the function table.
enum Function : Index {PIECE = 39, NEAREST, FURTHEST};
}

/// Address of a function.
Index library_function(Index which);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LIBRARY_HPP_
