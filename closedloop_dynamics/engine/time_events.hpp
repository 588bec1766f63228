// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__TIME_EVENTS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__TIME_EVENTS_HPP_

#include "effect_table.hpp"

// The instants at which the profile of a force or motion over time has a corner. Every step ends
// where the next corner is, so that within a step the force is one smooth function and every
// method keeps its order.

namespace closedloop
{

/// Time until the next corner, from a state's own part, shape (nz,) [s]; infinity if there is none.
double time_to_next_corner(const EffectTable &, Values own);

/// Begin the next segments after a step that has ended at a corner; corrected in place.
void handle_time_events(const EffectTable &, Values own);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__TIME_EVENTS_HPP_
