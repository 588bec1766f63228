// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch_motion.hpp"

#include "evaluation.hpp"
#include "least_forces.hpp"
#include "recursion.hpp"
#include "scratch.hpp"
#include "small_factors.hpp"

namespace closedloop
{

namespace
{
// Pivots at the state, against the largest, below which an equation is not worth its multiplier:
// the rounding of positions on the branch is as large.
constexpr double VANISHED = 1e-7;
// Numbers and counts that fit on the stack.
constexpr Index NUMBERS = 1024, COUNTS = 64;

/// Multipliers with these joint forces where equations vanish, zero for those, in the least squares,
/// as other forces would take infinite ones; and into the first rows of a table multipliers without
/// any joint force. Return the rank of the equations.
Index find_some_multipliers(
  BranchEquations & equations, const Component & part, Values force, Table null_multipliers)
{
  const Values & lam = equations.system.lam, & scale = equations.row_scale;
  Scratch<Index, COUNTS> counts(part.rows + part.columns);
  const Indices order = counts.take(part.rows), columns = counts.take(part.columns);
  Table factor;
  const Index rank = equations.factor_fully(part, VANISHED, order, columns, factor);
  for (Index & each : order) {
    each = equations.row(part, each);
  }
  fill_null_multipliers(
    factor, order, rank,
    {null_multipliers.data, part.rows - rank, null_multipliers.columns});
  Scratch<double, NUMBERS> scratch(rank * (rank + 1) + part.columns);
  const Table products = scratch.take(rank, rank);
  const Values share = scratch.take(rank), wanted = scratch.take(part.columns);
  for (Index j = 0; j < part.columns; ++j) {
    const Index from = equations.column(part, columns[j]);
    wanted[j] = force[from] * equations.column_scale[from];
  }
  for (Index k = 0; k < rank; ++k) {
    const Values upper = factor[k].from(k);
    share[k] = dot(upper, wanted.from(k));
    for (Index m = 0; m <= k; ++m) {
      products(k, m) = dot(upper, factor[m].from(k));
    }
  }
  factorize_positive(products);
  solve_positive(products, share);
  for (Index k = rank - 1; k >= 0; --k) {
    for (Index i = k + 1; i < rank; ++i) {
      share[k] -= factor(i, k) * share[i];
    }
  }
  for (Index k = 0; k < part.rows; ++k) {
    const Index i = order[k];
    lam[i] = k < rank ? share[k] * scale[i] : 0.0;
    for (Index n = 0; n < part.rows - rank; ++n) {
      null_multipliers(n, i) *= scale[i];
    }
  }
  return rank;
}

/// Find the multipliers with these joint forces, those of the least forces where equations vanish;
/// return the rank of the equations.
Index find_multipliers(
  BranchEquations & equations, const BranchPoint & point, Table added, Values force)
{
  const System & system = equations.system;
  const Model & model = system.model;
  const Workspace & work = system.work;
  Scratch<double, NUMBERS> scratch(equations.nc * equations.nc);
  const Table null_multipliers = scratch.take(equations.nc, equations.nc);
  Index rank = 0, idle = 0;
  for (const Component & part : equations.components) {
    if (part.pivot > 0.0) {
      equations.factor(part);
    }
    if (part.pivot > 0.0 && equations.smallest_pivot(part)[0] > VANISHED) {
      equations.solve_transposed(part, force, system.lam);
      rank += part.rows;
    } else {
      const Index found = find_some_multipliers(
        equations, part, force, null_multipliers.from(idle));
      rank += found;
      idle += part.rows - found;
    }
  }
  if (idle > 0) {
    // Where the elimination works on some equations, forces are least of all of them, later.
    const JointPlaces joints = system.whole.empty() ? system.joints : JointPlaces();
    place_bodies(system, point.q, point.rate);
    if (joints.body.rows > 0) {
      if (system.has_effects()) {
        add_forces(work, added);
      }
      bias_forces(work, work.force);
      joint_wrenches(model, work, system.qdd, system.lam, work.force);
    }
    minimise_joint_wrenches(
      system, joints, model, work, {null_multipliers.data, idle, equations.nc}, work.force,
      system.lam);
  }
  return rank;
}
}  // namespace

bool accelerate_along(
  BranchEquations & equations, const BranchPoint & point, Table added, bool multipliers)
{
  const System & system = equations.system;
  const Index nv = equations.nv, freedoms = nv - equations.nc;
  Scratch<double, NUMBERS> scratch(nv * (nv + 1) + freedoms * (nv + freedoms + 1));
  Scratch<Index, COUNTS> counts(nv);
  const Table gim = scratch.take(nv, nv), carried = scratch.take(freedoms, nv);
  const Table inertia = scratch.take(freedoms, freedoms);
  const Values force = scratch.take(nv), push = scratch.take(freedoms);
  const Indices independent = counts.take(nv);
  independent.fill(1);
  for (const Component & part : equations.components) {
    for (Index k = 0; k < part.rows; ++k) {
      independent[equations.column(part, k)] = 0;
    }
  }
  for (Index j = 0, k = 0; j < nv; ++j) {
    if (independent[j] == 1) {
      point.tangent(j, j) = 1.0;
      independent[k++] = j;
    }
  }
  equations.evaluate_motion(point.q, point.rate, added, gim, force);
  with_rows(nv, [&](auto count) {
      // Those of the constraints.
      for (Index i = 0; i < nv; ++i) {
        force[i] = dot(count, gim[i], point.path_acceleration) - force[i];
      }
      for (Index k = 0; k < freedoms; ++k) {
        const Values tangent = point.tangent[independent[k]];
        push[k] = -dot(count, tangent, force);
        for (Index i = 0; i < nv; ++i) {
          carried(k, i) = dot(count, gim[i], tangent);
        }
        for (Index m = 0; m <= k; ++m) {
          inertia(k, m) = dot(count, point.tangent[independent[m]], carried[k]);
        }
      }
    });
  if (!factorize_positive(inertia)) {
    return false;
  }
  solve_positive(inertia, push);
  copy(point.path_acceleration, system.qdd);
  for (Index k = 0; k < freedoms; ++k) {
    const Values tangent = point.tangent[independent[k]];
    for (Index i = 0; i < nv; ++i) {
      system.qdd[i] += push[k] * tangent[i];
    }
  }
  if (multipliers) {
    for (Index k = 0; k < freedoms; ++k) {
      for (Index i = 0; i < nv; ++i) {
        force[i] += push[k] * carried(k, i);
      }
    }
    system.work.health[health::RANK] =
      static_cast<double>(find_multipliers(equations, point, added, force));
  }
  return true;
}

}  // namespace closedloop
