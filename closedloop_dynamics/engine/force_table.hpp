// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__FORCE_TABLE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__FORCE_TABLE_HPP_

#include "array.hpp"

namespace closedloop
{

/// Force [N; N m] and energy [J] at a stroke.
struct ForceAndEnergy
{
  double force;
  double energy;
};

/// Force and energy of a table, given as pieces, at a stroke [m; rad].
ForceAndEnergy look_up_force(Values pieces, double stroke);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__FORCE_TABLE_HPP_
