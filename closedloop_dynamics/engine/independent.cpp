// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "independent.hpp"

#include <cmath>
#include <utility>

#include "loop_closure.hpp"
#include "lu.hpp"
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
}  // namespace

void choose_dependent(const Partition & partition)
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

void factor_dependent(const System & system, Values q, Values qd)
{
  const Partition & partition = system.partition;
  outward(system.model, q, qd, system.work);
  constraint_jacobian(system.model, system.work, partition.jac);
  if (partition.record[CHOSEN_RATIO] == 0.0) {
    choose_dependent(partition);
  }
  for (Index k = 0; k < partition.jac.rows; ++k) {
    for (Index j = 0; j < partition.jac.rows; ++j) {
      partition.matrix(k, j) = partition.jac(k, partition.order[j]);
    }
  }
  partition.record[RATIO] = factorize(partition.matrix, partition.pivots);
}

void correct_dependent(const System & system, Level level, Values qd)
{
  const Partition & partition = system.partition;
  to_user_order(system.model, system.work.closure, partition.right);
  for (Index k = 0; k < partition.right.size && level == Level::VELOCITY; ++k) {
    partition.right[k] = 0.0;
    for (Index j = 0; j < qd.size; ++j) {
      partition.right[k] += partition.jac(k, j) * qd[j];
    }
  }
  solve(partition.matrix, partition.pivots, partition.right);
  system.qdd.fill(0.0);
  for (Index k = 0; k < partition.right.size; ++k) {
    system.qdd[partition.order[k]] = -partition.right[k];
  }
}

bool are_worn(const Partition & partition)
{
  return !(partition.record[RATIO] >= WORN * partition.record[CHOSEN_RATIO]);
}

}  // namespace closedloop
