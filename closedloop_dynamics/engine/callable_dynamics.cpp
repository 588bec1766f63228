// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "callable_dynamics.hpp"

#include <algorithm>

#include "batch.hpp"
#include "evaluation.hpp"
#include "projection.hpp"
#include "requests.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
constexpr Index STATUSES = 16;

Status evaluate_row(CallableDynamics & of, Index n, const double * const * in)
{
  const System & system = *of.system;
  const Values q = system.q(of.state), qd = system.qd(of.state);
  const Index na = of.actuated.size;
  std::copy_n(in[0] + n * q.size, q.size, q.data);
  std::copy_n(in[1] + n * qd.size, qd.size, qd.data);
  system.tau.fill(0.0);
  for (Index k = 0; k < na; ++k) {
    system.tau[of.actuated[k]] = in[2][n * na + k];
  }
  if (!(all_finite(qd) && all_finite(system.tau) && is_position(system.manifold, q))) {
    return Status::NOT_FINITE;
  }
  // What is known of the equations that are worked on is of another motion.
  system.whole.numbers.fill(0.0);
  evaluate_with_poses(system, of.state);
  if (!closes_loops(system, qd)) {
    return Status::OPEN_LOOP;
  }
  if (!(system.whole.empty() || fulfil_left_out(system, q, qd))) {
    return Status::POOR_EQUATIONS;
  }
  return all_finite(system.qdd) ? Status::DONE : Status::SINGULAR;
}

/// Call a function after the evaluation of each row, which it returns the status of.
template<class Function>
Index of_rows(CallableDynamics & of, Index count, const double * const * in, Function && then)
{
  const std::lock_guard<std::mutex> alone(*of.busy);
  for (Index n = 0; n < count; ++n) {
    Status status = evaluate_row(of, n, in);
    if (status == Status::DONE) {
      status = then(n);
    }
    if (status != Status::DONE) {
      return STATUSES * n + static_cast<Index>(status);
    }
  }
  return 0;
}

/// Call a function with each derivative: number of the result, array and place of the input, value.
template<class Function>
Status of_derivatives(const CallableDynamics & of, Function && take)
{
  const System & system = *of.system;
  const Index nv = system.nv(), results = nv + of.lam.size;
  copy(system.qdd, of.qdd);
  copy(system.lam, of.lam);
  if (!call_for_columns(
      of.table, system.q(of.state), system.qd(of.state), of.columns, of.found))
  {
    return Status::SINGULAR;
  }
  const auto take_column = [&](Index column, Index array, Index place) {
      for (Index i = 0; i < results; ++i) {
        take(i, array, place, of.found(column / LANES, i * LANES + column % LANES));
      }
    };
  for (Index k = 0; k < 2 * nv; ++k) {
    take_column(k, k / nv, k % nv);
  }
  for (Index k = 0; k < of.actuated.size; ++k) {
    take_column(2 * nv + of.actuated[k], 2, k);
  }
  return Status::DONE;
}
}  // namespace

Index dynamics_rows(
  CallableDynamics * of, Index count, const double * const * in, double * const * out)
{
  const System & system = *of->system;
  return of_rows(
    *of, count, in, [&](Index n) {
      std::copy_n(system.qdd.data, system.qdd.size, out[0] + n * system.qdd.size);
      std::copy_n(system.lam.data, of->lam.size, out[1] + n * of->lam.size);
      return Status::DONE;
    });
}

Index dynamics_change_rows(
  CallableDynamics * of, Index count, const double * const * in, double * const * out)
{
  const Index nv = of->system->nv(), nc = of->lam.size, lengths[] = {nv, nv, of->actuated.size};
  return of_rows(
    *of, count, in, [&](Index n) {
      std::fill_n(out[0] + n * nv, nv, 0.0);
      std::fill_n(out[1] + n * nc, nc, 0.0);
      return of_derivatives(
        *of, [&](Index i, Index array, Index k, double value) {
          (i < nv ? out[0][n * nv + i] : out[1][n * nc + i - nv]) +=
          value * in[3 + array][n * lengths[array] + k];
        });
    });
}

Index dynamics_weight_rows(
  CallableDynamics * of, Index count, const double * const * in, double * const * out)
{
  const Index nv = of->system->nv(), nc = of->lam.size, lengths[] = {nv, nv, of->actuated.size};
  return of_rows(
    *of, count, in, [&](Index n) {
      for (Index array = 0; array < 3; ++array) {
        std::fill_n(out[array] + n * lengths[array], lengths[array], 0.0);
      }
      return of_derivatives(
        *of, [&](Index i, Index array, Index k, double value) {
          out[array][n * lengths[array] + k] +=
          value * (i < nv ? in[3][n * nv + i] : in[4][n * nc + i - nv]);
        });
    });
}

CallableDynamics callable_dynamics(
  const std::shared_ptr<System> & system, Values state, Indices actuated, Indices table,
  Values qdd, Values lam, Table columns, Table found)
{
  // Threads of other programs have no signals to look at.
  system->interrupted = nullptr;
  return {
    system, state, actuated, table, qdd, lam, columns, found, std::make_unique<std::mutex>()};
}

void fill_dynamics_addresses(CallableDynamics & of, Indices out)
{
  out[0] = reinterpret_cast<Index>(&of);
  DynamicsFunction * const functions[] = {
    dynamics_rows, dynamics_change_rows, dynamics_weight_rows};
  for (Index n = 0; n < 3; ++n) {
    out[1 + n] = reinterpret_cast<Index>(functions[n]);
  }
}

}  // namespace closedloop
