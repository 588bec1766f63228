// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_

#include "data.hpp"

// Checks that the arrays of effects fit together, where they are handed over: kernels index blindly.

namespace closedloop
{

/// Message of the first error; nullptr where all fits. Addresses of routines are taken as they are.
const char * misfit(const EffectTable &, const Data &);
const char * misfit(const EffectTable &, Index nv, Index bodies, bool planar);
const char * misfit(const CutCoordinates &, Index nv, Index bodies, bool planar, Index states);

/// Whether the coordinates belong to existing cut joints.
bool has_cuts(const CutCoordinates &, Index cuts);

/// Whether an expression (course.hpp) has a result, and every operation its operands.
bool is_expression(Values data, Index at);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_
