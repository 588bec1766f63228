// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch_motion.hpp"

#include "evaluation.hpp"
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

/// Multipliers with these joint forces where equations vanish: in the least squares, and of all
/// such the least; return the rank of the equations.
Index find_least_multipliers(BranchEquations & equations, const Component & part, Values force)
{
  Scratch<Index, COUNTS> counts(part.rows + part.columns);
  const Indices rows = counts.take(part.rows), columns = counts.take(part.columns);
  Scratch<double, NUMBERS> scratch(part.rows * (part.rows + 1));
  Table matrix;
  const Index rank = equations.factor_fully(part, VANISHED, rows, columns, matrix);
  const auto upper = [&](Index k, Index j) {return j >= k ? matrix(k, j) : 0.0;};
  const auto lower = [&](Index k, Index i) {
      return (i == k ? 1.0 : i > k ? matrix(i, k) : 0.0) /
             equations.row_scale[equations.row(part, rows[i])];
    };
  const Table products = scratch.take(rank, rank);
  const Values share = scratch.take(rank);
  for (Index k = 0; k < rank; ++k) {
    share[k] = 0.0;
    for (Index j = k; j < part.columns; ++j) {
      const Index from = equations.column(part, columns[j]);
      share[k] += matrix(k, j) * force[from] * equations.column_scale[from];
    }
  }
  fill_products(products, upper, part.columns);
  factorize_positive(products);
  solve_positive(products, share);
  fill_products(products, lower, part.rows);
  factorize_positive(products);
  solve_positive(products, share);
  for (Index i = 0; i < part.rows; ++i) {
    double total = 0.0;
    for (Index k = 0; k < rank; ++k) {
      total += lower(k, i) * share[k];
    }
    equations.system.lam[equations.row(part, rows[i])] = total;
  }
  return rank;
}

/// Find the multipliers with these joint forces; return the rank of the equations.
Index find_multipliers(BranchEquations & equations, const Component & part, Values force)
{
  if (!(equations.factor(part) > VANISHED)) {
    return find_least_multipliers(equations, part, force);
  }
  equations.solve_transposed(part, force, equations.system.lam);
  return part.rows;
}
}  // namespace

bool accelerate_along(BranchEquations & equations, const BranchPoint & point, Table added)
{
  const System & system = equations.system;
  const Model & model = system.model;
  const Workspace & work = system.work;
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
  place_bodies(system, point.q, point.rate);
  add_forces(work, added);
  generalized_inertia_matrix(model, work, gim);
  tree_torque(model, work, point.bend, force);
  for (Index i = 0; i < nv; ++i) {
    force[i] -= system.applied[i];
  }
  for (Index k = 0; k < freedoms; ++k) {
    const Values tangent = point.tangent[independent[k]];
    push[k] = 0.0;
    carried[k].fill(0.0);
    for (Index i = 0; i < nv; ++i) {
      if (tangent[i] != 0.0) {
        push[k] -= tangent[i] * force[i];
        for (Index j = 0; j < nv; ++j) {
          carried(k, j) += tangent[i] * gim(i, j);
        }
      }
    }
    for (Index m = 0; m <= k; ++m) {
      const Values other = point.tangent[independent[m]];
      inertia(k, m) = 0.0;
      for (Index i = 0; i < nv; ++i) {
        inertia(k, m) += other[i] * carried(k, i);
      }
    }
  }
  if (!factorize_positive(inertia)) {
    return false;
  }
  solve_positive(inertia, push);
  copy(point.bend, system.qdd);
  for (Index k = 0; k < freedoms; ++k) {
    const Values tangent = point.tangent[independent[k]];
    for (Index i = 0; i < nv; ++i) {
      system.qdd[i] += push[k] * tangent[i];
      force[i] += push[k] * carried(k, i);
    }
  }
  Index rank = 0;
  for (const Component & part : equations.components) {
    rank += find_multipliers(equations, part, force);
  }
  work.health[health::RANK] = static_cast<double>(rank);
  return true;
}

}  // namespace closedloop
