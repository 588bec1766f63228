// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "state_steps.hpp"

#include <algorithm>

#include "manifold_derivatives.hpp"

namespace closedloop
{

namespace
{
/// Add a row times a table, of which `first` is the first column.
void add_product(Values row, Table table, Index first, Values out)
{
  for (Index i = 0; i < row.size; ++i) {
    for (Index j = 0; j < out.size; ++j) {
      out[j] += row[i] * table(i, first + j);
    }
  }
}

/// The weights of coordinates whose sum is a displacement of a joint at a position.
void fill_weights(const Manifold & manifold, Values q, Index joint, Values displacement, Values out)
{
  displacement.fill(0.0);
  // Of a quaternion a small turn is twice the vector part of what it is multiplied by.
  displacement[joint] = manifold.empty() || manifold.place[joint] >= 0 ? 1.0 : 4.0;
  change_of_rates(manifold, q, displacement, out, displacement, out);
}

/// One row of the Jacobians of state `n`, of which the gradients have a lane.
void fill_row(
  const System & system, const Values start, const Chart & chart, const StateSteps & steps, Index n,
  Index row, Index lane)
{
  const Index nq = system.nq(), nv = system.nv(), k = chart.independent.size;
  const RunInputs & gradient = steps.gradient;
  const auto in_lane = [&](Values from, Index first, Values to) {
      for (Index i = 0; i < to.size; ++i) {
        to[i] = from[(first + i) * LANES + lane];
      }
      return to;
    };
  const Values by_state = steps.by_state[n][row], by_parameter = steps.by_parameter[n][row];
  const Table basis = steps.basis[n];
  // From numbers of coordinates to displacements; the weights at the end have served.
  const Values of_q = in_lane(gradient.start, 0, chart.place), displacement = chart.displacement;
  displacement.fill(0.0);
  weights_of_rates(
    system.manifold, system.q(start), displacement, of_q, steps.weight.part(0, nq), displacement);
  by_state.fill(0.0);
  by_parameter.fill(0.0);
  add_product(displacement, basis, 0, by_state);
  add_product(displacement, basis, 2 * k, by_parameter);
  const Values of_qd = in_lane(gradient.start, nq, displacement);
  add_product(of_qd, basis.from(nv), 0, by_state);
  add_product(of_qd, basis.from(nv), 2 * k, by_parameter);
  for (Index entry = 0; entry < chart.parameters.rows; ++entry) {
    for (Index j = 0; j < by_parameter.size; ++j) {
      by_parameter[j] +=
        gradient.parameter[entry * LANES + lane] * chart.parameters(entry, j);
    }
  }
  for (Index input = 0; input < steps.actuated.size; ++input) {
    steps.by_torque[n](row, input) = gradient.torque(0, steps.actuated[input] * LANES + lane);
  }
}

/// The Jacobians of one state, of whose motion there is a tape: rows by the adjoint of the steps, one
/// for each displacement and rate after them.
Status fill_jacobians(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
  const StepRoutines & routines, const LaneRoutines & beside, const Chart & chart,
  const StateSteps & steps, Index n)
{
  const Index nq = system.nq(), k = chart.independent.size;
  const Values start = tape.state[0], end = tape.state[tape.steps()];
  const Status found = fill_basis(
    system, beside, chart, system.q(start), system.qd(start), steps.basis[n]);
  if (found != Status::DONE) {
    return found;
  }
  for (Index first = 0; first < 2 * k; first += LANES) {
    const Index lanes = std::min(LANES, 2 * k - first);
    steps.weight.fill(0.0);
    for (Index lane = 0; lane < lanes; ++lane) {
      const Index row = first + lane, joint = chart.independent[row % k];
      if (row < k) {
        chart.place.fill(0.0);
        fill_weights(system.manifold, system.q(end), joint, chart.displacement, chart.place);
        for (Index i = 0; i < nq; ++i) {
          steps.weight[i * LANES + lane] = chart.place[i];
        }
      } else {
        steps.weight[(nq + joint) * LANES + lane] = 1.0;
      }
    }
    if (!gradients_in_lanes(
        system, run, scratch, steps.wide, tape, routines, beside, steps.weight, steps.gradient))
    {
      return Status::SINGULAR;
    }
    for (Index lane = 0; lane < lanes; ++lane) {
      fill_row(system, start, chart, steps, n, first + lane, lane);
    }
  }
  return Status::DONE;
}
}  // namespace

std::pair<Status, Index> step_states(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
  const StepRoutines & routines, const LaneRoutines & beside, const Chart & chart,
  const StateSteps & steps)
{
  const Values start = tape.state[0], end = tape.state[tape.steps()], tau = run.torque[0];
  for (Index n = 0; n < steps.states(); ++n) {
    copy(steps.q[n], system.q(start));
    copy(steps.qd[n], system.qd(start));
    // What is known of the equations that are worked on is of another motion.
    system.whole.numbers.fill(0.0);
    tau.fill(0.0);
    for (Index input = 0; input < steps.actuated.size; ++input) {
      tau[steps.actuated[input]] = steps.torque(n, input);
    }
    Status status = record_steps(system, run, scratch, tape).first;
    if (status == Status::DONE && steps.by_state.pages > 0) {
      status = fill_jacobians(system, run, scratch, tape, routines, beside, chart, steps, n);
    }
    if (status != Status::DONE) {
      return {status, n};
    }
    copy(system.q(end), steps.next_q[n]);
    copy(system.qd(end), steps.next_qd[n]);
  }
  return {Status::DONE, steps.states()};
}

}  // namespace closedloop
