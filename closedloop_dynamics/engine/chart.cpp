// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "chart.hpp"

#include <algorithm>

#include "loop_closure.hpp"
#include "lu.hpp"
#include "manifold.hpp"
#include "manifold_derivatives.hpp"
#include "null_space.hpp"
#include "recursion.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
// Pivots of the dependent coordinates below this share of the largest are rounding.
constexpr double LEAST_PIVOT = 1e-8;
// Steps of Newton's method to close the loops. It doubles the digits each time, but of orientations,
// whose turns do not add up: an error shrinks by a share like that of the turn.
constexpr Index MOST_CLOSING_STEPS = 40;

/// One lane of the seeds: a displacement of a joint, or behind those a parameter.
void fill_seed(const System & system, const Chart & chart, Values q, Index number, Index lane)
{
  const Index nq = system.nq(), nv = system.nv();
  if (number < nv) {
    place_change(system, chart, q, number, 1.0);
    for (Index n = 0; n < nq; ++n) {
      chart.seed[n * LANES + lane] = chart.place[n];
    }
  } else {
    for (Index entry = 0; entry < chart.parameters.rows; ++entry) {
      chart.seed[(nq + 2 * nv + entry) * LANES + lane] = chart.parameters(entry, number - nv);
    }
  }
}

/// Changes of closure errors, and of their rates, with each displacement and each parameter, and the
/// factors of those with the dependent coordinates.
bool factor_closures(
  const System & system, const LaneRoutines & routines, const Chart & chart, Values q, Values qd,
  Index rows)
{
  const Index nc = chart.right.size, which = step_routine::CLOSURE_FORWARD;
  const Indices table = routines.prepare(which, q, qd);
  for (Index first = 0; first < rows; first += LANES) {
    const Index lanes = std::min(LANES, rows - first);
    chart.seed.fill(0.0);
    for (Index lane = 0; lane < lanes; ++lane) {
      fill_seed(system, chart, q, first + lane, lane);
    }
    if (table.size == 0 || !call(table, 2 * which + 1, chart.seed, routines.result)) {
      return false;
    }
    for (Index lane = 0; lane < lanes; ++lane) {
      for (Index k = 0; k < 2 * nc; ++k) {
        chart.closure(first + lane, k) = routines.result[k * LANES + lane];
      }
    }
  }
  for (Index row = 0; row < nc; ++row) {
    for (Index column = 0; column < nc; ++column) {
      chart.factors(row, column) = chart.closure(chart.dependent[column], row);
    }
  }
  return factorize(chart.factors, chart.pivots) > LEAST_PIVOT;
}

/// Complete the columns of a basis of displacements and parameters: displacements (level 0) and
/// changes of rates (level 1) that follow from the former, and from independent ones.
void complete(const Chart & chart, Table basis, Index level)
{
  const Index nv = basis.rows / 2, k = chart.independent.size, nc = chart.right.size;
  const Index parameters = basis.columns - 2 * k;
  const auto errors = dense(chart.closure).middleCols(level * nc, nc);
  auto right = dense(chart.several);
  right.setZero();
  right.rightCols(parameters) -= errors.bottomRows(parameters).transpose();
  if (level == 0) {
    for (Index column = 0; column < k; ++column) {
      right.col(column) -= errors.row(chart.independent[column]).transpose();
    }
  } else {
    // Errors of rates follow the displacements, too.
    const auto shift = dense(basis).topRows(nv);
    right.leftCols(k).noalias() -= errors.topRows(nv).transpose() * shift.leftCols(k);
    right.rightCols(parameters).noalias() -= errors.topRows(nv).transpose() *
      shift.rightCols(parameters);
  }
  solve(chart.factors, chart.pivots, chart.several);
  for (Index row = 0; row < nc; ++row) {
    auto to = dense(basis).row(level * nv + chart.dependent[row]);
    to.head(k) = right.row(row).head(k);
    to.tail(parameters) = right.row(row).tail(parameters);
  }
}

/// Move from a position by displacements, of which the dependent ones are changed so that the loops
/// are closed; then set the dependent rates.
Status close(
  const System & system, const LaneRoutines & routines, const Chart & chart, Values from,
  Values displacement, Values q, Values qd)
{
  const double tolerance = system.settings->closure_tolerance;
  double error = 0.0;
  for (Index n = 0; n < MOST_CLOSING_STEPS; ++n) {
    copy(from, q);
    move(system.manifold, q, displacement, 1.0);
    outward(system.model, q, qd, system.work);
    update(system.model, system.work, Responses::NONE);
    const double before = error;
    error = largest(system.work.closure);
    if (!factor_closures(system, routines, chart, q, qd, system.nv())) {
      return Status::SINGULAR;
    }
    if (error <= tolerance) {
      auto right = dense(chart.right);
      right.setZero();
      for (Index place : chart.independent) {
        right -= qd[place] * dense(chart.closure).row(place).head(right.size()).transpose();
      }
      solve(chart.factors, chart.pivots, chart.right);
      for (Index k = 0; k < chart.right.size; ++k) {
        qd[chart.dependent[k]] = chart.right[k];
      }
      return Status::DONE;
    }
    if (n > 1 && !(error < before)) {
      break;
    }
    to_user_order(system.model, system.work.closure, chart.right);
    solve(chart.factors, chart.pivots, chart.right);
    for (Index k = 0; k < chart.right.size; ++k) {
      displacement[chart.dependent[k]] -= chart.right[k];
    }
  }
  return Status::OPEN_LOOP;
}
}  // namespace

void place_change(
  const System & system, const Chart & chart, Values q, Index joint, double size)
{
  const Manifold & manifold = system.manifold;
  const Index place = manifold.empty() ? joint : manifold.place[joint];
  chart.place.fill(0.0);
  if (place >= 0) {
    chart.place[place] = size;
  } else {
    chart.displacement.fill(0.0);
    chart.displacement[joint] = size;
    change_of_rates(
      manifold, q, chart.displacement, chart.place, chart.displacement, chart.place);
  }
}

Status fill_basis(
  const System & system, const LaneRoutines & routines, const Chart & chart, Values q, Values qd,
  Table basis)
{
  const Index nv = system.nv(), k = chart.independent.size;
  if (!factor_closures(system, routines, chart, q, qd, chart.closure.rows)) {
    return Status::SINGULAR;
  }
  basis.fill(0.0);
  for (Index column = 0; column < k; ++column) {
    basis(chart.independent[column], column) = 1.0;
  }
  complete(chart, basis, 0);
  complete(chart, basis, 1);
  // Rates move the loops as displacements do.
  dense(basis).block(nv, k, nv, k) = dense(basis).topLeftCorner(nv, k);
  return Status::DONE;
}

std::pair<Status, Index> move_along(
  const System & system, const LaneRoutines & routines, const Chart & chart, Values from_q,
  Values from_qd, Table basis, Table changes, Values displacement, Table q, Table qd)
{
  const Index nv = system.nv();
  for (Index n = 0; n < changes.rows; ++n) {
    copy(from_qd, qd[n]);
    for (Index joint = 0; joint < nv; ++joint) {
      double place = 0.0, rate = 0.0;
      for (Index column = 0; column < changes.columns; ++column) {
        place += basis(joint, column) * changes(n, column);
        rate += basis(nv + joint, column) * changes(n, column);
      }
      displacement[joint] = place;
      qd(n, joint) += rate;
    }
    const Status closed = close(system, routines, chart, from_q, displacement, q[n], qd[n]);
    if (closed != Status::DONE) {
      return {closed, n};
    }
  }
  return {Status::DONE, changes.rows};
}

}  // namespace closedloop
