// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LIBRARY_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LIBRARY_HPP_

#include "array.hpp"

// Search functions that generated code calls, on the entries of an effect. All take the same arguments, and return the first of their results.

namespace closedloop
{

/// Address of a function, by the place that it has in the function table.
Index library_function(Index which);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LIBRARY_HPP_
