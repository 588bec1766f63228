// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ASSEMBLY_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ASSEMBLY_HPP_

#include "workspace.hpp"

// Positions that close the loops, where that is plain; simulation/assembly.py has the other cases.

namespace closedloop
{

/// Close the loops by Newton's method from coordinates `q`, with the least change of the `free`
/// ones in the mass metric.
///
/// Corrections end at closure errors of a hundredth of `closed`, or where these no longer decrease;
/// no correction moves a coordinate by more than `limit`. `jac` and `gim` are scratch, of the
/// shapes (nc, nv) and (nv, nv). False where the loops do not close to `closed`, or equations may
/// be dependent on the way: `q` is undefined then.
bool close_loops(
  const Model &, const Workspace &, const Manifold &, Table jac, Table gim, Values q, Indices free,
  double closed, double limit);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ASSEMBLY_HPP_
