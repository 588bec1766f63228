// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "state_steps.hpp"

#include "manifold_derivatives.hpp"
#include "null_space.hpp"

namespace closedloop
{

namespace
{
/// Jacobians of state `n` from the gradients, of which each row has a lane.
void fill_rows(
  const System & system, Values start, const Chart & chart, const StateSteps & steps, Index n)
{
  const Index nq = system.nq(), nv = system.nv(), lanes = steps.lanes();
  const Index size = steps.by_state.rows, count = chart.parameters.columns;
  const RunInputs & gradient = steps.gradient;
  // From numbers of coordinates to displacements; the weights at the end have served.
  const Values displacements = steps.wide[0].part(0, nv * lanes);
  displacements.fill(0.0);
  chart.displacement.fill(0.0);
  weights_of_rates(
    system.manifold, system.q(start), chart.displacement, gradient.start.part(0, nq * lanes),
    steps.weight.part(0, nq * lanes), displacements, lanes);
  const auto in_rows = [&](Values values, Index number) {
      return dense(Table{values.data, number, lanes}).leftCols(size).transpose();
    };
  const auto of_q = in_rows(displacements, nv);
  const auto of_qd = in_rows(gradient.start.from(nq * lanes), nv);
  const auto basis = dense(steps.basis[n]);
  auto by_state = dense(steps.by_state[n]), by_parameter = dense(steps.by_parameter[n]);
  by_state.noalias() = of_q * basis.topLeftCorner(nv, size);
  by_state.noalias() += of_qd * basis.bottomLeftCorner(nv, size);
  by_parameter.noalias() = of_q * basis.topRightCorner(nv, count);
  by_parameter.noalias() += of_qd * basis.bottomRightCorner(nv, count);
  by_parameter.noalias() += in_rows(gradient.parameter, chart.parameters.rows) *
    dense(chart.parameters);
  const auto of_torque = in_rows(gradient.torque[0], nv);
  for (Index input = 0; input < steps.actuated.size; ++input) {
    dense(steps.by_torque[n]).col(input) = of_torque.col(steps.actuated[input]);
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
  const Index lanes = steps.lanes();
  steps.weight.fill(0.0);
  for (Index row = 0; row < 2 * k; ++row) {
    const Index joint = chart.independent[row % k];
    if (row < k) {
      // A small turn is twice the vector part of the quaternion that is multiplied.
      const bool turns = !system.manifold.empty() && system.manifold.place[joint] < 0;
      place_change(system, chart, system.q(end), joint, turns ? 4.0 : 1.0);
      for (Index i = 0; i < nq; ++i) {
        steps.weight[i * lanes + row] = chart.place[i];
      }
    } else {
      steps.weight[(nq + joint) * lanes + row] = 1.0;
    }
  }
  if (!gradients_in_lanes(
      system, run, scratch, steps.wide, chart.seed, tape, routines, beside, steps.weight,
      steps.gradient))
  {
    return Status::SINGULAR;
  }
  fill_rows(system, start, chart, steps, n);
  return Status::DONE;
}
}  // namespace

std::pair<Status, Index> step_states(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
  const StepRoutines & routines, const LaneRoutines & beside, const Chart & chart,
  const StateSteps & steps)
{
  check(system, run, tape);
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
