// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>

#include "batch.hpp"
#include "callable.hpp"
#include "evaluation.hpp"
#include "projection.hpp"
#include "requests.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
class CallableDynamics : public Callable
{
public:
  CallableDynamics(
    const std::shared_ptr<System> & system, Values state, Indices actuated, Indices table,
    Values qdd, Values lam, Table columns, Table found)
  : Callable(system, actuated), state_(state), table_(table), qdd_(qdd), lam_(lam),
    columns_(columns), found_(found) {}

  Status compute(Index n, RowInputs in) override
  {
    const System & system = *system_;
    const Values q = system.q(state_), qd = system.qd(state_);
    take_row(n, in, state_, system.tau);
    if (!(all_finite(qd) && all_finite(system.tau) && is_position(system.manifold, q))) {
      return Status::NOT_FINITE;
    }
    evaluate_with_poses(system, state_);
    if (!closes_loops(system, qd)) {
      return Status::OPEN_LOOP;
    }
    if (!(system.whole.empty() || fulfil_left_out(system, q, qd))) {
      return Status::POOR_EQUATIONS;
    }
    return all_finite(system.qdd) ? Status::DONE : Status::SINGULAR;
  }

  Status write_results(Index n, RowInputs, RowOutputs out) override
  {
    std::copy_n(system_->qdd.data, qdd_.size, out[0] + n * qdd_.size);
    std::copy_n(system_->lam.data, lam_.size, out[1] + n * lam_.size);
    return Status::DONE;
  }

  Status write_changes(Index n, RowInputs in, RowOutputs out) override
  {
    const Index nv = qdd_.size, nc = lam_.size;
    std::fill_n(out[0] + n * nv, nv, 0.0);
    std::fill_n(out[1] + n * nc, nc, 0.0);
    return of_derivatives(
      [&](Index i, Index array, Index k, double value) {
        (i < nv ? out[0][n * nv + i] : out[1][n * nc + i - nv]) +=
        value * in[3 + array][n * length(array) + k];
      });
  }

  Status write_weights(Index n, RowInputs in, RowOutputs out) override
  {
    const Index nv = qdd_.size, nc = lam_.size;
    for (Index array = 0; array < 3; ++array) {
      std::fill_n(out[array] + n * length(array), length(array), 0.0);
    }
    return of_derivatives(
      [&](Index i, Index array, Index k, double value) {
        out[array][n * length(array) + k] +=
        value * (i < nv ? in[3][n * nv + i] : in[4][n * nc + i - nv]);
      });
  }

private:
  /// Lengths of the changes of displacements, rates and torques.
  Index length(Index array) const {return array < 2 ? qdd_.size : actuated_.size;}

  /// Call a function with each derivative: number of the result, array and place of the input, value.
  template<class Function>
  Status of_derivatives(Function && take) const
  {
    const System & system = *system_;
    const Index nv = qdd_.size, results = nv + lam_.size;
    copy(system.qdd, qdd_);
    copy(system.lam, lam_);
    if (!call_for_columns(table_, system.q(state_), system.qd(state_), columns_, found_)) {
      return Status::SINGULAR;
    }
    const auto take_column = [&](Index column, Index array, Index place) {
        for (Index i = 0; i < results; ++i) {
          take(i, array, place, found_(column / LANES, i * LANES + column % LANES));
        }
      };
    for (Index k = 0; k < 2 * nv; ++k) {
      take_column(k, k / nv, k % nv);
    }
    for (Index k = 0; k < actuated_.size; ++k) {
      take_column(2 * nv + actuated_[k], 2, k);
    }
    return Status::DONE;
  }

  const Values state_;
  const Indices table_;
  const Values qdd_;
  const Values lam_;
  const Table columns_;
  const Table found_;
};
}  // namespace

std::shared_ptr<Callable> callable_dynamics(
  const std::shared_ptr<System> & system, Values state, Indices actuated, Indices table,
  Values qdd, Values lam, Table columns, Table found)
{
  require_routines(table, 0, 2);
  return std::make_shared<CallableDynamics>(
    system, state, actuated, table, qdd, lam, columns, found);
}

}  // namespace closedloop
