// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_

#include "system.hpp"

// Checks that arrays fit together, where they are handed over: kernels index blindly.

namespace closedloop
{

/// Message of the first error; nullptr where all fits. Addresses of routines are taken as they are.
const char * misfit(const System &);
const char * misfit(const Model &);
/// The pattern of the constraint matrix and of its factor, which only the elimination needs.
const char * misfit_of_pattern(const Model &);
const char * misfit(const Workspace &, const Model &);
const char * misfit(const EffectTable &, Index nv, Index bodies, bool planar);
const char * misfit(const CutCoordinates &, Index nv, Index bodies, bool planar, Index states);
const char * misfit(const Manifold &, Index nq, Index nv);

/// Whether the coordinates belong to existing cut joints.
bool has_cuts(const CutCoordinates &, Index cuts);

/// Length of the coordinates of a valid tree.
Index coordinates_of(const Model &);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__VALIDATION_HPP_
