// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_

#include "system.hpp"

namespace closedloop
{

/// Torques of the actuated joints, at places among the rates, and behind them the multipliers of
/// all equations that a motion needs; the first `loops` equations are no prescribed motion. False,
/// and nothing is to be read, where these are no arrays of finite numbers that fit, the motion
/// opens the loops or cannot be produced, or anything acts in cut joints.
bool find_torques(
  const System &, Indices actuated, Index loops, Values out, const Given & q, const Given & qd,
  const Given & qdd);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_
