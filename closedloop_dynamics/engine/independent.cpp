// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "independent.hpp"

#include <cmath>
#include <limits>
#include <utility>

#include "loop_closure.hpp"
#include "lu.hpp"
#include "manifold.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
// Partition.record: the pivot ratio when the set was chosen (0: not chosen yet), the latest one,
// the number of changes of the set.
enum : Index {CHOSEN_RATIO, RATIO, SWITCHES};
// A set whose pivots have shrunk to this share of the initial ones is replaced by a better one: the
// error of a step grows fast while the independent coordinates turn singular (3-RRR, 1 s of RK4 at
// 1 ms: 8e-3 rad at 0.2, 5e-6 at 0.5, 1.5e-6 at 0.8), a change costs one factorization.
constexpr double WORN = 0.8;
constexpr int MOST_ITERATIONS = 12;
// Relative rounding error of a coordinate, with the kinematics from it to a cut joint.
constexpr double ROUNDING = 16.0 * std::numeric_limits<double>::epsilon();

/// Choose the dependent coordinates, first in `order`, by complete pivoting of the Jacobian.
void choose(const Partition & partition)
{
  const Index nc = partition.jac.rows, nv = partition.jac.columns;
  const Indices & order = partition.order;
  const Table & work = partition.scaled;
  copy(partition.jac.all(), work.all());
  for (Index j = 0; j < nv; ++j) {
    order[j] = j;
  }
  double first = 0.0;
  for (Index k = 0; k < nc; ++k) {
    Index row = k, column = k;
    for (Index i = k; i < nc; ++i) {
      for (Index j = k; j < nv; ++j) {
        if (std::abs(work(i, order[j])) > std::abs(work(row, order[column]))) {
          row = i;
          column = j;
        }
      }
    }
    std::swap(order[k], order[column]);
    for (Index j = 0; j < nv; ++j) {
      std::swap(work(k, j), work(row, j));
    }
    const double pivot = work(k, order[k]);
    if (k == 0) {
      first = std::abs(pivot);
    }
    partition.record[CHOSEN_RATIO] = std::abs(pivot) / first;
    for (Index i = k + 1; i < nc; ++i) {
      const double scale = work(i, order[k]) / pivot;
      for (Index j = k; j < nv; ++j) {
        work(i, order[j]) -= scale * work(k, order[j]);
      }
    }
  }
  partition.record[SWITCHES] += 1.0;
}

/// Whether closure errors are rounding of the coordinates: after a prismatic joint has moved a
/// thousand sizes of the mechanism, rounding exceeds the tolerance.
bool is_rounding(
  const Partition & partition, const Manifold & manifold, Values q, Values error,
  double tolerance)
{
  for (Index k = 0; k < partition.jac.rows; ++k) {
    double moved = 0.0;
    for (Index j = 0; j < partition.jac.columns; ++j) {
      const Index place = manifold.empty() ? j : manifold.place[j];
      moved += std::abs(partition.jac(k, j) * (place < 0 ? 1.0 : q[place]));
    }
    if (!(std::abs(error[k]) <= tolerance + ROUNDING * moved)) {
      return false;
    }
  }
  return true;
}

bool close(
  const Model & model, const Workspace & work, const Partition & partition,
  const Manifold & manifold, Values q, Values qd, double tolerance)
{
  const Index nc = partition.jac.rows, nv = partition.jac.columns;
  const Values & right = partition.right;
  const Indices & order = partition.order;
  const Table & matrix = partition.matrix;
  bool closed = false;
  double before = std::numeric_limits<double>::infinity();
  for (int iteration = 0; iteration < MOST_ITERATIONS; ++iteration) {
    outward(model, q, qd, work);
    constraint_jacobian(model, work, partition.jac);
    to_user_order(model, work.closure, right);
    if (partition.record[CHOSEN_RATIO] == 0.0) {
      choose(partition);
    }
    for (Index k = 0; k < nc; ++k) {
      for (Index j = 0; j < nc; ++j) {
        matrix(k, j) = partition.jac(k, order[j]);
      }
    }
    partition.record[RATIO] = factorize(matrix, partition.pivots);
    const double error = largest(right);
    closed = error <= tolerance || (
      !(error < 0.5 * before) && is_rounding(partition, manifold, q, right, tolerance));
    if (closed) {
      break;
    }
    before = error;
    solve(matrix, partition.pivots, right);
    partition.change.fill(0.0);
    for (Index k = 0; k < nc; ++k) {
      partition.change[order[k]] = -right[k];
    }
    move(manifold, q, partition.change, 1.0);
  }
  for (Index k = 0; k < nc; ++k) {
    double total = 0.0;
    for (Index j = nc; j < nv; ++j) {
      total -= partition.jac(k, order[j]) * qd[order[j]];
    }
    right[k] = total;
  }
  solve(matrix, partition.pivots, right);
  for (Index k = 0; k < nc; ++k) {
    qd[order[k]] = right[k];
  }
  return closed;
}
}  // namespace

bool close_by_dependent(
  const Model & model, const Workspace & work, const Partition & partition,
  const Manifold & manifold, Values q, Values qd, double tolerance, bool after_step)
{
  bool closed = close(model, work, partition, manifold, q, qd, tolerance);
  const Values & record = partition.record;
  if (after_step && !(record[RATIO] >= WORN * record[CHOSEN_RATIO])) {
    choose(partition);
    closed = close(model, work, partition, manifold, q, qd, tolerance);
  }
  return closed;
}

}  // namespace closedloop
