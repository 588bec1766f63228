// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STICK_SLIP_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STICK_SLIP_HPP_

#include "data.hpp"

// The instants at which joints under dry friction stick or slip. Within a step each of them slides
// in one direction, or is held (static_friction.hpp), so that all methods keep their order. A step on
// which a sliding joint would turn round is cut where it comes to rest; there it sticks, or sets
// out again.

namespace closedloop
{

/// The least part of a step worth trying after a number of cuts [s].
double least_part(double size, int cuts);

/// The part of a step on which no joint turns round [s]; `size` where the step may be taken. A
/// smaller one is an estimate, to be tried; parts of `floor` or less are not worth a step.
double locate_stick_event(
  const System &, Values before, Values after, double size, double floor);

/// Update the stick/slip modes after an accepted step, in place, and set the remaining rates of
/// stuck joints to zero by an impulse.
void update_friction_modes(const System &, Values state);

/// Initialise the modes of joints under dry friction from the rates of all joints, those of cut
/// joints last, in the effects' own states.
void begin_friction(const EffectTable &, Values rates, Values own);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STICK_SLIP_HPP_
