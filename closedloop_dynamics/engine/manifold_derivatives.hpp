// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__MANIFOLD_DERIVATIVES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__MANIFOLD_DERIVATIVES_HPP_

#include "workspace.hpp"

// Derivatives of the functions of manifold.hpp, each number of a quaternion changed alone: forward,
// changes of results; in reverse, weights of arguments from weights of results. Shapes
// are those of coordinates, (nq,), and of rates and displacements, (nv,). With `lanes` greater than 1
// so many weights are side by side: number k of lane n is at k * lanes + n.

namespace closedloop
{

/// Of `rates_of_coordinates`, forward: into `out`.
void change_of_rates(
  const Manifold &, Values q, Values qd, Values change, Values change_of_rate, Values out);

/// In reverse: added to those of coordinates and of rates.
void weights_of_rates(
  const Manifold &, Values q, Values qd, Values weight, Values of_q, Values of_qd,
  Index lanes = 1);

/// Of `move`, forward: in place.
void change_of_move(
  const Manifold &, Values q, Values displacement, double share, Values change,
  Values change_of_displacement);

/// In reverse: in place, and added to those of the displacement.
void weights_of_move(
  const Manifold &, Values q, Values displacement, double share, Values weight,
  Values of_displacement, Index lanes = 1);

/// Of `normalise`, in place; this derivative is symmetric.
void change_of_norm(const Manifold &, Values q, Values change, Index lanes = 1);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__MANIFOLD_DERIVATIVES_HPP_
