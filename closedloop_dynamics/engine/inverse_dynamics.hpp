// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_

#include "data.hpp"

namespace closedloop
{

/// Inverse dynamics: torques of the actuated joints, then the multipliers of all equations, of
/// which the first `loops` are loop closures. Joints are given by their places among the rates;
/// `own`: the effects' own states. False, with results undefined, where arguments are not arrays of
/// finite numbers of the right lengths, the motion opens the loops or cannot be produced, or
/// effects act in cut joints.
bool find_torques(
  const System &, Indices actuated, Indices passive, Index loops, Values own, Values out,
  const OptionalVector & q, const OptionalVector & qd, const OptionalVector & qdd);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INVERSE_DYNAMICS_HPP_
