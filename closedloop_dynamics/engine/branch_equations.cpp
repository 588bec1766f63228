// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch_equations.hpp"

#include <algorithm>
#include <cmath>

#include "loop_closure.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "recursion.hpp"
#include "routines.hpp"
#include "small_factors.hpp"

namespace closedloop
{

namespace
{
// Corrections per place; the first place, extrapolated along a line, needs the most.
constexpr Index MOST_CORRECTIONS = 6;
// Closure error, against the size of the mechanism, that counts as on the branch.
constexpr double SETTLED = 1e-11;
// Entries of the scaled J up to the first are zero, but for the closure error of a stage; up to the
// second on the branch.
constexpr double FOREIGN = 1e-6, ABSENT = 1e-13;

/// The first member of a group.
Index find(Indices root, Index j)
{
  while (root[j] != j) {
    j = root[j] = root[root[j]];
  }
  return j;
}
}  // namespace

BranchEquations::BranchEquations(const System & from)
: scratch_(2 * from.lam.size * from.qdd.size + 6 * from.lam.size + 2 * from.qdd.size),
  counts_(2 * from.lam.size + 2 * from.qdd.size), parts_(from.lam.size), system(from),
  nv(from.qdd.size), nc(from.lam.size), jac(scratch_.take(nc, nv)), closure(scratch_.take(nc)),
  bias(scratch_.take(nc)), right(scratch_.take(nc)), row_scale(scratch_.take(nc)),
  column_scale(scratch_.take(nv)), components(parts_.take(nc)), factor_(scratch_.take(nc, nv)),
  local_(scratch_.take(nc)), pivot_scale_(scratch_.take(nc)), change_(scratch_.take(nv)),
  row_(counts_.take(nc)), order_(counts_.take(nv)), pivot_row_(counts_.take(nc)), column_(counts_.take(nv))
{
  std::copy(system.table.begin(), system.table.end(), table_.begin());
  table_[routine::CLOSURE] = reinterpret_cast<Index>(closure.data);
  table_[routine::BIAS] = reinterpret_cast<Index>(bias.data);
  table_[routine::JACOBIAN] = reinterpret_cast<Index>(jac.data);
}

void BranchEquations::evaluate(Values q, Values rates)
{
  if (table_[routine::LOOP_EQUATIONS] != 0) {
    call({table_.data(), routine::TABLE_COLUMNS}, routine::LOOP_EQUATIONS, q, rates);
    return;
  }
  const Model & model = system.model;
  outward(model, q, rates, system.work);
  constraint_jacobian(model, system.work, jac);
  to_user_order(model, system.work.closure, closure);
  to_user_order(model, system.work.bias, bias);
}

bool BranchEquations::find_components()
{
  const Indexes & cut = system.model.cut;
  const Indices & root = column_;
  scales(system.model, jac, row_scale, column_scale);
  for (Index j = 0; j < nv; ++j) {
    root[j] = j;
  }
  // The equations of a cut joint, and all coordinates in them, form one group.
  for (Index a = 0; a < cut.rows; ++a) {
    const Index begin = cut(a, cut::CUT_ROW), end = begin + cut(a, cut::ROWS);
    Index group = -1;
    for (Index i = begin; i < end; ++i) {
      for (Index j = 0; j < nv; ++j) {
        if (std::abs(entry(i, j)) > FOREIGN) {
          group = group < 0 ? find(root, j) : group;
          root[find(root, j)] = group;
        }
      }
    }
    if (group < 0) {
      return false;
    }
    std::fill(pivot_row_.data + begin, pivot_row_.data + end, group);
  }
  Index rows = 0, columns = 0, count = 0;
  for (Index first = 0; first < nv && rows < nc; ++first) {
    if (find(root, first) != first) {
      continue;
    }
    Component part;
    part.row = rows;
    part.column = columns;
    for (Index i = 0; i < nc; ++i) {
      if (find(root, pivot_row_[i]) == first) {
        row_[rows++] = i;
      }
    }
    part.rows = rows - part.row;
    if (part.rows == 0) {
      continue;
    }
    for (Index j = 0; j < nv; ++j) {
      if (find(root, j) == first) {
        order_[columns++] = j;
      }
    }
    part.columns = columns - part.column;
    components.data[count++] = part;
    if (part.columns < part.rows) {
      return false;
    }
  }
  components.size = count;
  return true;
}

double BranchEquations::choose(Component & part, double share)
{
  const Indices columns = column_.part(0, part.columns), rows = pivot_row_.part(0, part.rows);
  const Indices order{order_.data + part.column, part.columns};
  Table matrix;
  const bool enough = factor_fully(part, share, rows, columns, matrix) == part.rows;
  for (Index & each : columns) {
    each = order[each];
  }
  std::copy(columns.begin(), columns.end(), order.begin());
  for (Index & each : rows) {
    each = row(part, each);
  }
  std::copy(rows.begin(), rows.end(), row_.data + part.row);
  for (Index k = 0; k < part.rows; ++k) {
    pivot_scale_[part.row + k] = 1.0 / (row_scale[row(part, k)] * column_scale[column(part, k)]);
  }
  return !enough ? 0.0 : std::abs(matrix(part.rows - 1, part.rows - 1) / matrix(0, 0));
}

void BranchEquations::count_moving(Component & part)
{
  Index * order = order_.data + part.column;
  part.moving = 0;
  for (Index k = 0; k < part.columns - part.rows; ++k) {
    double most = 0.0;
    for (Index i = 0; i < part.rows; ++i) {
      most = std::max(most, std::abs(entry(row(part, i), independent(part, k))));
    }
    if (most > ABSENT) {
      std::swap(order[part.rows + k], order[part.rows + part.moving]);
      ++part.moving;
    }
  }
}

bool BranchEquations::keeps_quaternions_whole(const Component & part)
{
  if (system.manifold.empty()) {
    return true;
  }
  const Indexes & tree = system.model.tree;
  column_.fill(0);
  for (Index k = 0; k < part.rows; ++k) {
    column_[column(part, k)] = 1;
  }
  for (Index i = 1; i < tree.rows; ++i) {
    if (tree(i, tree::TYPE) == tree::BALL) {
      const Index last = tree(i, tree::DOF), first = last - tree(i, tree::AXIS);
      if (column_[first] != column_[last]) {
        return false;
      }
    }
  }
  return true;
}

bool BranchEquations::is_isolated(const Component & part)
{
  if (part.columns == nv) {
    return true;
  }
  column_.fill(0);
  for (Index k = 0; k < part.columns; ++k) {
    column_[column(part, k)] = 1;
  }
  for (Index i = 0; i < part.rows; ++i) {
    for (Index j = 0; j < nv; ++j) {
      if (column_[j] == 0 && std::abs(entry(row(part, i), j)) > FOREIGN) {
        return false;
      }
    }
  }
  return true;
}

void BranchEquations::factor(const Component & part)
{
  const Table matrix = square(part);
  for (Index i = 0; i < part.rows; ++i) {
    const double * from = jac.row(row(part, i));
    for (Index k = 0; k < part.rows; ++k) {
      matrix(i, k) = from[column(part, k)];
    }
  }
  factorize_in_place(matrix);
}

double BranchEquations::smallest_pivot(const Component & part) const
{
  const Table matrix = square(part);
  double least = 0.0, most = 0.0;
  for (Index k = 0; k < part.rows; ++k) {
    // Inverses of pivots, scaled.
    const double size = std::abs(matrix(k, k)) * pivot_scale_[part.row + k];
    least = k == 0 || size < least ? size : least;
    // Not a number: all comparisons fail.
    most = size <= most ? most : size;
  }
  return least / most;
}

Index BranchEquations::factor_fully(
  const Component & part, double share, Indices rows, Indices columns, Table & out)
{
  out = {factor_.data, part.rows, part.columns};
  for (Index i = 0; i < part.rows; ++i) {
    for (Index k = 0; k < part.columns; ++k) {
      out(i, k) = entry(row(part, i), column(part, k));
    }
  }
  return factorize_fully(out, rows, columns, share);
}

void BranchEquations::solve(const Component & part, Values out)
{
  const Values local = local_.part(0, part.rows);
  for (Index i = 0; i < part.rows; ++i) {
    local[i] = right[row(part, i)];
  }
  solve_in_place(square(part), local);
  for (Index k = 0; k < part.rows; ++k) {
    out[column(part, k)] = local[k];
  }
}

void BranchEquations::solve_transposed(const Component & part, Values force, Values out)
{
  const Values local = local_.part(0, part.rows);
  for (Index k = 0; k < part.rows; ++k) {
    local[k] = force[column(part, k)];
  }
  closedloop::solve_transposed(square(part), local);
  for (Index i = 0; i < part.rows; ++i) {
    out[row(part, i)] = local[i];
  }
}

bool BranchEquations::settle(const Component & part, Values q, Values rates)
{
  const double size = system.settings->size;
  double before = 0.0;
  for (Index count = 0; ; ++count) {
    double error = 0.0;
    for (Index i = 0; i < part.rows; ++i) {
      const double each = closure[row(part, i)];
      error = std::abs(each) <= error ? error : std::abs(each);
      right[row(part, i)] = -each;
    }
    const bool shrinks = count == 0 || error < 0.5 * before;
    factor(part);
    if (error <= ROUNDING * size || !shrinks || count == MOST_CORRECTIONS) {
      return error <= SETTLED * size;
    }
    before = error;
    change_.fill(0.0);
    solve(part, change_);
    move(system.manifold, q, change_, 1.0);
    evaluate(q, rates);
  }
}

void BranchEquations::follow(
  const Component & part, Values q, Values rates, Values path_acceleration)
{
  bool known = true;
  for (Index i = 0; i < part.rows; ++i) {
    const Index equation = row(part, i);
    double total = 0.0, size = 0.0, dependent = 0.0;
    for (Index k = 0; k < part.rows + part.moving; ++k) {
      dependent = k == part.rows ? total : dependent;
      const double each = jac(equation, column(part, k)) * rates[column(part, k)];
      total += each;
      size += std::abs(each);
    }
    right[equation] = dependent - total;
    known = known && std::abs(total) <= ROUNDING * size;
  }
  // On straight paths the rates that have been evaluated are those along the branch.
  if (!known) {
    solve(part, rates);
    evaluate(q, rates);
  }
  find_path_acceleration(part, path_acceleration);
}

void BranchEquations::find_path_acceleration(const Component & part, Values out)
{
  for (Index i = 0; i < part.rows; ++i) {
    right[row(part, i)] = -bias[row(part, i)];
  }
  solve(part, out);
}

void BranchEquations::add_tangents(const Component & part, Table out, double share)
{
  for (Index k = 0; k < part.moving && share != 0.0; ++k) {
    const Index j = independent(part, k);
    for (Index i = 0; i < part.rows; ++i) {
      right[row(part, i)] = -jac(row(part, i), j);
    }
    solve(part, change_);
    for (Index m = 0; m < part.rows; ++m) {
      out(j, column(part, m)) += share * change_[column(part, m)];
    }
  }
}

}  // namespace closedloop
