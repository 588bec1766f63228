// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STIFFNESS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STIFFNESS_HPP_

#include "data.hpp"

namespace closedloop
{

/// Approximate magnitude of the largest eigenvalue of the Jacobian of the derivative in a state
/// [1/s], by power iteration from a direction, both of shape (ns,); entries that are zero in
/// `start` take no part. Rates of pairs of evaluations, as such an eigenvalue may be imaginary.
double fastest_rate(const System &, Values state, Values start);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STIFFNESS_HPP_
