// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__MANIFOLD_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__MANIFOLD_HPP_

#include "workspace.hpp"

// Coordinates of which some are quaternions. With `lanes` greater than 1 so many states are stored
// side by side: number k of lane n is at k * lanes + n. Where a mechanism has no quaternions its
// manifold is empty, and coordinates are numbers.

namespace closedloop
{

/// Rates of the coordinates: of quaternions from angular velocities.
void rates_of_coordinates(
  const Manifold &, Values state, Index nv, Values out, Index lanes = 1);

/// Power of the torques into the last number of a state's derivative, where there are quaternions.
void power_of_turns(
  const Manifold &, Values tau, Values state, Index nv, Values out, Index lanes = 1);

/// Add the work of constant torques from one state to another, shape (lanes,).
void add_work(
  const Manifold &, Values tau, Values since, Values state, Index lanes, Values work);

/// Change coordinates by a share of joint displacements, shape (nv,), in place.
void move(const Manifold &, Values q, Values change, double share, Index lanes = 1);

/// The same in one lane.
void move_lane(
  const Manifold &, Values q, Values change, double share, Index lanes, Index lane);

/// Give all quaternions of a state norm 1.
void normalise(const Manifold &, Values q, Index lanes = 1);

/// Weight of the error of a coordinate: 2 for components of quaternions, else 1.
double error_weight(const Manifold &, Index coordinate);

/// The coordinate of each rate, shape (nv,), as laws of effects see it: 0 for quaternions.
void fill_numbers(const Manifold &, Values q);

/// Quaternions x, y, z, w of rotation matrices, shapes (n, 3, 3) and (n, 4).
void fill_quaternions(Cube<double> matrices, Table out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__MANIFOLD_HPP_
