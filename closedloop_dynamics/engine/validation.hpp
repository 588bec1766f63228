// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_

#include "system.hpp"

// Whether arrays fit together, asked once where a system is handed over: kernels index blindly.

namespace closedloop
{

/// The first thing that does not fit in a system; nullptr where all does.
const char * misfit(const System &);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_
