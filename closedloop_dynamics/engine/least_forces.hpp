// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LEAST_FORCES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LEAST_FORCES_HPP_

#include "data.hpp"

// Forces in the joints where closure equations are redundant. These forces are not unique: the
// least ones of all joints together, of the tree and cut ones alike, are chosen,
//
//   sum over the joints of |F|^2 + (|M_a|^2 + |M_b|^2) / (2 size^2)  =  least
//
// with the force F and its moments M_a, M_b about the joint's points on the two bodies; forces of
// couplings and prescribed motions count as moments. The choice does not depend on which joints
// are cut.

namespace closedloop
{

/// Choose multipliers of all equations, shape (nc,), which have the same joint forces J^T lam as
/// before. `work` has the poses of the bodies, `jac` is J there; `wrench` has the wrenches in the
/// joints of the tree that go with the multipliers, before and afterwards. At most `independent`
/// equations repeat no others: where loops are open by rounding more of them seem to.
void minimise_joint_wrenches(
  const System &, const Model &, const Workspace & work, Table jac, Table wrench, Values lam,
  Index independent);

/// The same with multipliers that give no joint forces, a row each. Without any joints: the least
/// multipliers.
void minimise_joint_wrenches(
  const System &, const JointPlaces &, const Model &, const Workspace & work, Table null_multipliers,
  Table wrench, Values lam);

/// Write multipliers that give no joint forces, a row each, from the factors of J by complete
/// pivoting, of which so many rows are independent; `order` are the places of its rows.
void fill_null_multipliers(Table factor, Indices order, Index rank, Table out);

/// Multipliers of all equations, zero for those that the elimination omits.
void spread_multipliers(const System &, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LEAST_FORCES_HPP_
