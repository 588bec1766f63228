// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "batch.hpp"

#include <algorithm>
#include <cmath>

#include "interrupt.hpp"
#include "manifold.hpp"
#include "projection.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
// As of projection.cpp.
constexpr int MOST_CORRECTIONS = 8;

/// Time derivatives of all lanes; return whether the results are good.
bool batch_derivative(const Batch & batch, Values state, Values out)
{
  const Index n = batch.qdd.size, first = LANES * batch.nq();
  const bool good =
    call(batch.table, routine::EVALUATION, state.part(0, first), state.part(first, n));
  rates_of_coordinates(batch.manifold, state, batch.nv(), out, LANES);
  copy(batch.qdd, out.part(first, n));
  power_of_turns(batch.manifold, batch.tau, state, batch.nv(), out, LANES);
  return good;
}

/// Make one step; return whether all evaluations were good.
bool batch_step(
  const Batch & batch, const Tableau & tableau, Values state, double step_size, Table slopes,
  Values stage, Values out)
{
  if (!batch_derivative(batch, state, slopes[0])) {
    return false;
  }
  const Index stages = tableau.steps();
  if (stages == 0) {
    semi_implicit_step(batch.manifold, state, batch.nv(), step_size, slopes[0], out, LANES);
    return true;
  }
  for (Index k = 1; k < stages; ++k) {
    combine(tableau.a.row(k), k, state, step_size, slopes, stage);
    if (!batch_derivative(batch, stage, slopes[k])) {
      return false;
    }
  }
  combine(tableau.b.data, stages, state, step_size, slopes, out);
  return true;
}

/// Largest closure error of every lane; guards have excluded NaN.
void measure_errors(Values closure, Values error)
{
  error.fill(0.0);
  for (Index k = 0; k < closure.size / LANES; ++k) {
    for (Index lane = 0; lane < LANES; ++lane) {
      error[lane] = std::max(error[lane], std::abs(closure[LANES * k + lane]));
    }
  }
}

/// Correct the coordinates of the lanes that want it.
void correct_coordinates(
  const Manifold & manifold, Values q, Values change, const bool (&moving)[LANES])
{
  if (!manifold.empty()) {
    for (Index lane = 0; lane < LANES; ++lane) {
      if (moving[lane]) {
        move_lane(manifold, q, change, 1.0, LANES, lane);
      }
    }
    return;
  }
  for (Index k = 0; k < q.size / LANES; ++k) {
    for (Index lane = 0; lane < LANES; ++lane) {
      const Index i = LANES * k + lane;
      q[i] = moving[lane] ? q[i] + change[i] : q[i];
    }
  }
}

/// Correct rates, and positions if asked, in every lane, as projection.cpp does in one.
Status project(const Batch & batch, Values q, Values qd, bool positions)
{
  const Values & error = batch.error, & tolerance = batch.tolerance;
  bool moving[LANES];
  bool busy = false;
  if (!call(batch.table, routine::CORRECTION, q, qd)) {
    return Status::SINGULAR;
  }
  measure_errors(batch.closure, error);
  for (Index lane = 0; lane < LANES; ++lane) {
    moving[lane] = positions && error[lane] > tolerance[lane];
    busy = busy || moving[lane];
  }
  for (int n = 0; n < MOST_CORRECTIONS && busy; ++n) {
    correct_coordinates(batch.manifold, q, batch.corrections[0], moving);
    if (!call(batch.table, routine::CORRECTION, q, qd)) {
      return Status::SINGULAR;
    }
    double before[LANES];
    std::copy(error.begin(), error.end(), before);
    measure_errors(batch.closure, error);
    busy = false;
    for (Index lane = 0; lane < LANES; ++lane) {
      moving[lane] =
        moving[lane] && error[lane] < 0.5 * before[lane] && error[lane] > tolerance[lane];
      busy = busy || moving[lane];
    }
  }
  for (Index i = 0; i < qd.size; ++i) {
    qd[i] += batch.corrections(1, i);
  }
  for (Index lane = 0; lane < LANES; ++lane) {
    if (positions && !(error[lane] <= batch.limit[lane])) {
      return Status::OPEN_LOOP;
    }
  }
  return Status::DONE;
}

/// Record one instant.
void record(Values state, Cube<double> position, Cube<double> velocity, Index instant)
{
  const Index nq = position.columns;
  for (Index lane = 0; lane < LANES; ++lane) {
    for (Index k = 0; k < nq; ++k) {
      position[lane](instant, k) = state[LANES * k + lane];
    }
    for (Index k = 0; k < velocity.columns; ++k) {
      velocity[lane](instant, k) = state[LANES * (nq + k) + lane];
    }
  }
}
}  // namespace

Status run_batch(
  const Batch & batch, const Tableau & tableau, Stabilisation stabilisation, Values state,
  double step_size, Table torque, Index zero_order_hold, Index decimation, Index steps,
  Table scratch, Cube<double> position, Cube<double> velocity, Indices looks, Cube<double> seen,
  Table work, bool (* interrupted)())
{
  Interrupt interrupt(interrupted);
  const Values stage = scratch[0], out = scratch[1], since = scratch[2];
  const Table slopes = scratch.from(3);
  const Index n = batch.qdd.size, first = LANES * batch.nq();
  double worked[LANES] = {};
  const auto add_work_since = [&] {
      add_work(batch.manifold, batch.tau, since, state, LANES, {worked, LANES});
      copy(state, since);
    };
  Index next = 0;
  const auto look = [&](Index done) {
      if (next == looks.size || looks[next] != done) {
        return;
      }
      add_work_since();
      for (Index lane = 0; lane < LANES; ++lane) {
        for (Index k = 0; k < seen.columns; ++k) {
          seen[lane](next, k) = state[LANES * k + lane];
        }
        work(lane, next) = worked[lane];
      }
      ++next;
    };
  record(state, position, velocity, 0);
  copy(state, since);
  look(0);
  for (Index done = 0; done < steps; ++done) {
    if (done % zero_order_hold == 0) {
      add_work_since();
      copy(torque[done / zero_order_hold], batch.tau);
    }
    if (!batch_step(batch, tableau, state, step_size, slopes, stage, out)) {
      return Status::SINGULAR;
    }
    normalise(batch.manifold, out, LANES);
    if (stabilisation >= Stabilisation::VELOCITY) {
      const Status status = project(
        batch, out.part(0, first), out.part(first, n), stabilisation == Stabilisation::PROJECTION);
      if (status != Status::DONE) {
        return status;
      }
    }
    if (interrupt.after(1 + tableau.steps())) {
      return Status::INTERRUPTED;
    }
    if (!all_finite(out)) {
      return Status::NOT_FINITE;
    }
    copy(out, state);
    if ((done + 1) % decimation == 0) {
      record(state, position, velocity, (done + 1) / decimation);
    }
    look(done + 1);
  }
  return Status::DONE;
}

}  // namespace closedloop
