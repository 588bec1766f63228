// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__INDEPENDENT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__INDEPENDENT_HPP_

#include "data.hpp"

// Independent coordinates, which corrections leave as they are: the dependent ones follow from the
// loop closures.

namespace closedloop
{

/// Choose the dependent coordinates, first in `order`, by complete pivoting of the Jacobian.
void choose_dependent(const Partition &);

/// Factor the Jacobian of the dependent coordinates, which are chosen at first.
void factor_dependent(const System &, Values q, Values qd);

/// Changes of the dependent coordinates, or rates, that close the loops, into System.qdd.
void correct_dependent(const System &, Level, Values qd);

/// Whether pivots have become so small since the choice that others are to be chosen.
bool are_worn(const Partition &);

/// Close the loops of a state by the dependent coordinates and rates, as far as they can be, by the
/// iteration of projection.cpp.
void close_by_dependent(const System &, Values state);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INDEPENDENT_HPP_
