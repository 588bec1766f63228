// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch_equations.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

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
: scratch_(
    PLACES * (from.lam.size * (from.qdd.size + from.lam.size + 3) + 2 * from.qdd.size + from.nq()) +
    from.lam.size * (from.qdd.size + 2) + 2 * from.qdd.size),
  counts_(2 * from.lam.size + 2 * from.qdd.size), parts_(from.lam.size), system(from),
  nv(from.qdd.size), nc(from.lam.size), row_scale(scratch_.take(nc)),
  column_scale(scratch_.take(nv)), lever(scratch_.take(nv)), place(take(from.nq())), rate(take(nv)),
  components(parts_.take(nc)), jac_(take(nc, nv)), factor_(take(nc, nc)), closure_(take(nc)),
  bias_(take(nc)), right_(take(nc)), change_(take(nv)),
  first_(scratch_.take(nc, nv)), pivot_scale_(scratch_.take(nc)), row_(counts_.take(nc)),
  order_(counts_.take(nv)), pivot_row_(counts_.take(nc)), column_(counts_.take(nv))
{
  std::copy(system.table.begin(), system.table.end(), table_.begin());
  table_[routine::CLOSURE] = reinterpret_cast<Index>(closure_.data);
  table_[routine::BIAS] = reinterpret_cast<Index>(bias_.data);
  table_[routine::JACOBIAN] = reinterpret_cast<Index>(jac_.data);
}

void BranchEquations::evaluate(Values q, Values rates)
{
  for (Index i = 0; i < q.size; ++i) {
    place[i] = Lanes::of(q[i]);
  }
  for (Index i = 0; i < nv; ++i) {
    rate[i] = Lanes::of(rates[i]);
  }
  evaluate(place, rate, 1);
}

void BranchEquations::evaluate(LaneValues q, LaneValues rates, Index count)
{
  // Not where angles are of many turns.
  if (table_[routine::LOOP_EQUATIONS] != 0 && call(
      {table_.data(), routine::TABLE_COLUMNS}, routine::LOOP_EQUATIONS, numbers(q),
      numbers(rates)))
  {
    return;
  }
  const Model & model = system.model;
  Scratch<double, NUMBERS> scratch(q.size + nv + 2 * nc);
  const Values here = scratch.take(q.size), going = scratch.take(nv);
  const Values gaps = scratch.take(nc), terms = scratch.take(nc);
  for (Index n = 0; n < count; ++n) {
    const auto take_lane = [n](LaneValues from, Values to) {
        for (Index i = 0; i < to.size; ++i) {
          to[i] = from[i][n];
        }
      };
    const auto put_lane = [n, count](Values from, LaneValues to) {
        for (Index i = 0; i < from.size; ++i) {
          for (Index lane = n; lane < (n + 1 == count ? PLACES : n + 1); ++lane) {
            numbers(to)[PLACES * i + lane] = from[i];
          }
        }
      };
    take_lane(q, here);
    take_lane(rates, going);
    outward(model, here, going, system.work);
    constraint_jacobian(model, system.work, first_);
    to_user_order(model, system.work.closure, gaps);
    to_user_order(model, system.work.bias, terms);
    put_lane(first_.all(), jac_.all());
    put_lane(gaps, closure_);
    put_lane(terms, bias_);
  }
}

void BranchEquations::shift(LaneValues q, LaneValues change) const
{
  if (!system.manifold.empty()) {
    move(system.manifold, numbers(q), numbers(change), 1.0, PLACES);
    return;
  }
  for (Index i = 0; i < q.size; ++i) {
    q[i] += change[i];
  }
}

void BranchEquations::evaluate_motion(
  Values q, Values rates, Table added, Table gim, Values force)
{
  if (table_[routine::EQUATIONS_OF_MOTION] != 0) {
    table_[routine::INERTIA_MATRIX] = reinterpret_cast<Index>(gim.data);
    table_[routine::JOINT_FORCE] = reinterpret_cast<Index>(force.data);
    table_[routine::ADDED_FORCE] = reinterpret_cast<Index>(added.data);
    call({table_.data(), routine::TABLE_COLUMNS}, routine::EQUATIONS_OF_MOTION, q, rates);
    return;
  }
  outward(system.model, q, rates, system.work);
  add_forces(system.work, added);
  generalized_inertia_matrix(system.model, system.work, gim);
  const Values at_rest = numbers(change_).part(0, nv);
  at_rest.fill(0.0);
  tree_torque(system.model, system.work, at_rest, force);
  for (Index i = 0; i < nv; ++i) {
    force[i] = system.applied[i] - force[i];
  }
}

bool BranchEquations::find_components()
{
  const Model & model = system.model;
  const Indexes & tree = model.tree, & cut = model.cut;
  const Indices & root = column_;
  for (Index n = 0; n < nc * nv; ++n) {
    first_.data[n] = jac_.data[n][0];
  }
  scales(model, first_, row_scale, column_scale);
  for (Index j = 0; j < nv; ++j) {
    lever[j] = 1.0 / column_scale[j];
  }
  for (Index j = 0; j < nv; ++j) {
    root[j] = j;
  }
  // The equations of a cut joint, and all coordinates in them, form one group.
  for (Index a = 0; a < cut.rows; ++a) {
    const Index begin = cut(a, cut::CUT_ROW), end = begin + cut(a, cut::ROWS);
    Index group = -1;
    for (Index n = cut(a, cut::PATH_A); n < cut(a, cut::PATH_END); ++n) {
      const Index j = tree(model.path_body[n], tree::DOF);
      Index i = begin;
      while (i < end && !(std::abs(entry(i, j)) > FOREIGN)) {
        ++i;
      }
      if (i < end) {
        group = group < 0 ? find(root, j) : group;
        root[find(root, j)] = group;
      }
    }
    if (group < 0) {
      return false;
    }
    std::fill(pivot_row_.data + begin, pivot_row_.data + end, group);
  }
  for (Index & each : root) {
    each = find(root, each);
  }
  for (Index & each : pivot_row_) {
    each = root[each];
  }
  Index rows = 0, columns = 0, count = 0;
  for (Index first = 0; first < nv && rows < nc; ++first) {
    if (root[first] != first) {
      continue;
    }
    Component part;
    part.row = rows;
    part.column = columns;
    for (Index i = 0; i < nc; ++i) {
      if (pivot_row_[i] == first) {
        row_[rows++] = i;
      }
    }
    part.rows = rows - part.row;
    if (part.rows == 0) {
      continue;
    }
    for (Index j = 0; j < nv; ++j) {
      if (root[j] == first) {
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
  with_rows(part.rows, [&](auto n) {
      Lanes * const matrix = factor_.data;
      for_each_row(n, [&](auto i) {
        const Lanes * from = jac_.row(row(part, i));
        for_each_row(n, [&](auto k) {matrix[i * n + k] = from[column(part, k)];});
      });
      factorize_in_place(n, matrix);
    });
}

Lanes BranchEquations::smallest_pivot(const Component & part) const
{
  const LaneTable matrix = square(part);
  Lanes least, most;
  for (Index k = 0; k < part.rows; ++k) {
    // Inverses of pivots, scaled.
    const Lanes size = pivot_scale_[part.row + k] * size_of(matrix(k, k));
    least = k == 0 ? size : smaller(size, least);
    // Not a number: all comparisons fail.
    most = k == 0 ? size : larger(size, most);
  }
  return least * (1.0 / most);
}

Index BranchEquations::factor_fully(
  const Component & part, double share, Indices rows, Indices columns, Table & out)
{
  out = {first_.data, part.rows, part.columns};
  for (Index i = 0; i < part.rows; ++i) {
    const Lanes * from = jac_.row(row(part, i));
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = column(part, k);
      out(i, k) = from[j][0] * row_scale[row(part, i)] * column_scale[j];
    }
  }
  return factorize_fully(out, rows, columns, share);
}

void BranchEquations::solve(const Component & part, LaneValues out)
{
  solve_in_place(square(part), right_);
  for (Index k = 0; k < part.rows; ++k) {
    out[column(part, k)] = right_[k];
  }
}

void BranchEquations::solve_transposed(const Component & part, Values force, Values out)
{
  for (Index k = 0; k < part.rows; ++k) {
    right_[k] = Lanes::of(force[column(part, k)]);
  }
  closedloop::solve_transposed(square(part), right_);
  for (Index i = 0; i < part.rows; ++i) {
    out[row(part, i)] = right_[i][0];
  }
}

bool BranchEquations::settle(const Component & part, LaneValues q, LaneValues rates)
{
  const double size = system.settings->size;
  Lanes before = Lanes::of(std::numeric_limits<double>::infinity());
  for (Index count = 0; ; ++count) {
    Lanes error = Lanes::of(0.0);
    for (Index i = 0; i < part.rows; ++i) {
      const Lanes each = closure_[row(part, i)];
      error = larger(size_of(each), error);
      right_[i] = -each;
    }
    // Places that are on the branch do not keep others from going there.
    const Lanes left = smaller(error - Lanes::of(ROUNDING * size), 0.5 * before - error);
    factor(part);
    if (!(largest(left) > 0.0) || count == MOST_CORRECTIONS) {
      return largest(error) <= SETTLED * size;
    }
    before = error;
    if (system.manifold.empty()) {
      solve(part, change_);
      for (Index k = 0; k < part.rows; ++k) {
        q[column(part, k)] += change_[column(part, k)];
      }
    } else {
      change_.fill(Lanes::of(0.0));
      solve(part, change_);
      shift(q, change_);
    }
    evaluate(q, rates);
  }
}

void BranchEquations::follow(
  const Component & part, LaneValues q, LaneValues rates, LaneValues path_acceleration)
{
  double most = 0.0;
  for (Index i = 0; i < part.rows; ++i) {
    const Index equation = row(part, i);
    Lanes total = Lanes::of(0.0), squares = total;
    for (Index k = 0; k < part.rows + part.moving; ++k) {
      const Lanes each = jac_(equation, column(part, k)) * rates[column(part, k)];
      total += each;
      squares += each * each;
    }
    right_[i] = -total;
    most = std::max(most, largest(total * total - ROUNDING * ROUNDING * squares));
  }
  // On straight paths the rates that have been evaluated are those along the branch.
  if (most > 0.0) {
    solve(part, change_);
    for (Index k = 0; k < part.rows; ++k) {
      rates[column(part, k)] += change_[column(part, k)];
    }
    evaluate(q, rates);
  }
  find_path_acceleration(part, path_acceleration);
}

void BranchEquations::find_path_acceleration(const Component & part, LaneValues out)
{
  for (Index i = 0; i < part.rows; ++i) {
    right_[i] = -bias_[row(part, i)];
  }
  solve(part, out);
}

void BranchEquations::add_tangents(const Component & part, Table out, Lanes share)
{
  for (Index k = 0; k < part.moving; ++k) {
    const Index j = independent(part, k);
    for (Index i = 0; i < part.rows; ++i) {
      right_[i] = -jac_(row(part, i), j);
    }
    solve(part, change_);
    for (Index m = 0; m < part.rows; ++m) {
      out(j, column(part, m)) += (share * change_[column(part, m)]).sum();
    }
  }
}

}  // namespace closedloop
