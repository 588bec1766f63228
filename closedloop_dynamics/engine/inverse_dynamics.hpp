// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_

#include "system.hpp"

namespace closedloop
{

/// Inverse dynamics: torques of the actuated joints, given by their places among the rates, then
/// the multipliers of all equations; the first `loops` equations are loop closures. False, with
/// results undefined, where arguments are no arrays of finite numbers of the right lengths, the
/// motion opens the loops or cannot be produced, or effects act in cut joints.
bool find_torques(
  const System &, Indices actuated, Index loops, Values out, const Given & q, const Given & qd,
  const Given & qdd);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_
