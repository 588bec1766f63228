// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "formulations.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "elimination.hpp"
#include "forward_dynamics.hpp"
#include "loop_closure.hpp"
#include "lu.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
/// Factor L L^T in place, lower triangle; return the smallest pivot relative to the largest.
double cholesky(Table matrix)
{
  const Index n = matrix.rows;
  double smallest = std::numeric_limits<double>::infinity(), largest = 0.0;
  for (Index i = 0; i < n; ++i) {
    for (Index j = 0; j <= i; ++j) {
      double total = matrix(i, j);
      for (Index k = 0; k < j; ++k) {
        total -= matrix(i, k) * matrix(j, k);
      }
      matrix(i, j) = i == j ? std::sqrt(total) : total / matrix(j, j);
    }
    const double pivot = matrix(i, i) * matrix(i, i);
    // Written so that a NaN counts as no pivot at all.
    smallest = pivot > 0.0 ? std::min(smallest, pivot) : 0.0;
    largest = std::max(largest, pivot);
  }
  return n > 0 ? smallest / largest : 1.0;
}

void lower_solve(Table factor, Values right)
{
  for (Index i = 0; i < factor.rows; ++i) {
    double total = right[i];
    for (Index k = 0; k < i; ++k) {
      total -= factor(i, k) * right[k];
    }
    right[i] = total / factor(i, i);
  }
}

void lower_transposed_solve(Table factor, Values right)
{
  for (Index i = factor.rows - 1; i >= 0; --i) {
    const double value = right[i] / factor(i, i);
    right[i] = value;
    for (Index k = 0; k < i; ++k) {
      right[k] -= factor(i, k) * value;
    }
  }
}

/// Ratio of the smallest to the largest pivot from number `first` on; 0 where any is zero or not a
/// number.
double ratio_of_pivots(Table matrix, Index first)
{
  double smallest = std::numeric_limits<double>::infinity(), largest = 0.0;
  for (Index k = 0; k < matrix.rows; ++k) {
    const double size = std::abs(matrix(k, k));
    // Written so that a NaN counts as no pivot at all.
    if (!(size > 0.0)) {
      smallest = 0.0;
    } else if (k >= first) {
      smallest = std::min(smallest, size);
      largest = std::max(largest, size);
    }
  }
  return first < matrix.rows ? smallest / largest : 1.0;
}

/// Solve for the multipliers, then leave the accelerations in `free`; return the pivots' ratio.
double solve_system_level(const DenseWorkspace & dense, Values lam)
{
  const Index nv = dense.free.size, nc = dense.right.size;
  const double inertia_ratio = cholesky(dense.gim);
  lower_solve(dense.gim, dense.free);
  for (Index k = 0; k < nc; ++k) {
    lower_solve(dense.gim, dense.jac[k]);
  }
  for (Index k = 0; k < nc; ++k) {
    double total = dense.right[k];
    for (Index i = 0; i < nv; ++i) {
      total -= dense.jac(k, i) * dense.free[i];
    }
    lam[k] = total;
    for (Index j = 0; j <= k; ++j) {
      total = 0.0;
      for (Index i = 0; i < nv; ++i) {
        total += dense.jac(k, i) * dense.jac(j, i);
      }
      dense.schur(k, j) = total;
    }
  }
  const double ratio = cholesky(dense.schur);
  lower_solve(dense.schur, lam);
  lower_transposed_solve(dense.schur, lam);
  for (Index k = 0; k < nc; ++k) {
    for (Index i = 0; i < nv; ++i) {
      dense.free[i] += dense.jac(k, i) * lam[k];
    }
  }
  lower_transposed_solve(dense.gim, dense.free);
  return inertia_ratio > 0.0 ? ratio : 0.0;
}

/// Solve the augmented system for accelerations and multipliers; return the pivots' ratio.
double solve_augmented(const DenseWorkspace & dense, Values qdd, Values lam)
{
  const Index nv = dense.free.size, nc = dense.right.size;
  for (Index i = 0; i < nv; ++i) {
    dense.solution[i] = dense.free[i];
    for (Index j = 0; j < nv; ++j) {
      dense.kkt(i, j) = dense.gim(i, j);
    }
  }
  for (Index k = 0; k < nc; ++k) {
    dense.solution[nv + k] = dense.right[k];
    for (Index i = 0; i < nv; ++i) {
      dense.kkt(nv + k, i) = dense.kkt(i, nv + k) = dense.jac(k, i);
    }
    for (Index j = 0; j < nc; ++j) {
      dense.kkt(nv + k, nv + j) = 0.0;
    }
  }
  factorize(dense.kkt, dense.pivots);
  solve(dense.kkt, dense.pivots, dense.solution);
  copy(dense.solution, qdd);
  for (Index k = 0; k < nc; ++k) {
    lam[k] = -dense.solution[nv + k];
  }
  return ratio_of_pivots(dense.kkt, nv);
}
}  // namespace

bool accelerate_dense(
  const Model & model, const Workspace & work, const DenseWorkspace & dense, Index formulation,
  Values tau, double baumgarte, Values qdd, Values lam)
{
  constraint_jacobian(model, work, dense.jac);
  work.right.fill(0.0);
  constraint_right_side(work, baumgarte, work.right);
  to_user_order(model, work.right, dense.right);
  qdd.fill(0.0);
  tree_torque(model, work, qdd, dense.free);
  for (Index i = 0; i < dense.free.size; ++i) {
    dense.free[i] = tau[i] - dense.free[i];
  }
  generalized_inertia_matrix(model, work, dense.gim);
  double ratio;
  if (formulation == setting::SYSTEM) {
    ratio = solve_system_level(dense, lam);
    copy(dense.free, qdd);
  } else {
    ratio = solve_augmented(dense, qdd, lam);
  }
  work.health[health::EVALUATIONS] += 1.0;
  const bool fine = ratio >= POOR_PIVOT;
  record_pivot(model, work, fine ? ratio : 1.0);
  return fine;
}

}  // namespace closedloop
