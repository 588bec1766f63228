// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__DRIVEN_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__DRIVEN_HPP_

#include <utility>

#include "workspace.hpp"

// Kinematics of a mechanism whose degrees of freedom are all driven: positions, rates and
// accelerations that the driving equations and the closure equations determine.

namespace closedloop
{

/// Move through driven values one after the other, from a position on a branch, and stay on it.
///
/// `drives`: rows of the driving equations among the cuts; `kept`: the equations to solve, as many
/// as there are rates less the rows of `anchors`, which are directions of scaled displacements
/// without effect (idle spins) that are left as they are; `unit`: of the displacements, shape
/// (nv,); `open` is the tolerance of the closure error; `begin`: the driven values of `q`;
/// `values`: driven values, rates and accelerations, shape (n, drives, 3). `q` becomes the last
/// position of the branch. Returned are how many of the n were reached and the share of the way to
/// the next one at which the branch ends, or `interrupted` returns true.
std::pair<double, double> follow_drives(
  const Model &, const Workspace &, const Manifold &, Indices drives, Indices kept, Values unit,
  Table anchors, double open, Values begin, Cube<double> values, Values q, Table position,
  Table velocity, Table acceleration, bool (* interrupted)());

/// Reach the nodes of a grid of driven values, each from a neighbour on the same branch.
///
/// As above; `grid`: its shape, and the first and last (excluded) node along each axis that may be
/// written, shape (3, axes); `seeds`: nodes that were reached before, whose neighbours are tried;
/// `values`: driven values of all nodes, shape (n, drives); `actuated`: coordinates. Written of the
/// nodes reached: `reached` 1, the positions, and the derivatives of the actuated coordinates by
/// the driven values, shape (n, actuated * drives). Returned is how many were reached.
Index reach_poses(
  const Model &, const Workspace &, const Manifold &, Indices drives, Indices kept, Values unit,
  Table anchors, double open, Indexes grid, Indices seeds, Table values, Indices actuated,
  Indices reached, Table position, Table rates);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__DRIVEN_HPP_
