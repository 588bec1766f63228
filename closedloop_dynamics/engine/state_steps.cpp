// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "state_steps.hpp"

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

/// The Jacobians of one state, of whose motion there is a tape: rows by the adjoint of the steps, one
/// for each displacement and rate after them.
Status fill_jacobians(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
  const StepRoutines & routines, const Chart & chart, const StateSteps & steps, Index n)
{
  const Index nq = system.nq(), nv = system.nv(), k = chart.independent.size;
  const Table basis = steps.basis[n], rates = basis.from(nv);
  const Values start = tape.state[0], end = tape.state[tape.steps()];
  const Status found = fill_basis(
    system, routines, chart, system.q(start), system.qd(start), basis);
  if (found != Status::DONE) {
    return found;
  }
  const Values weight = steps.weight[1], displacement = chart.displacement;
  const Values of_q = steps.gradient.start.part(0, nq), of_qd = steps.gradient.start.from(nq);
  steps.weight.fill(0.0);
  for (Index row = 0; row < 2 * k; ++row) {
    const Index joint = chart.independent[row % k];
    weight.fill(0.0);
    if (row < k) {
      fill_weights(system.manifold, system.q(end), joint, displacement, weight.part(0, nq));
    } else {
      weight[nq + joint] = 1.0;
    }
    const Status passed = gradient_of_steps(
      system, run, scratch, tape, routines, steps.weight, steps.gradient).first;
    if (passed != Status::DONE) {
      return passed;
    }
    // From numbers of coordinates to displacements; the weights at the end have served.
    displacement.fill(0.0);
    weights_of_rates(
      system.manifold, system.q(start), displacement, of_q, weight.part(0, nq), displacement);
    const Values by_state = steps.by_state[n][row], by_parameter = steps.by_parameter[n][row];
    by_state.fill(0.0);
    add_product(displacement, basis, 0, by_state);
    add_product(of_qd, rates, 0, by_state);
    by_parameter.fill(0.0);
    add_product(displacement, basis, 2 * k, by_parameter);
    add_product(of_qd, rates, 2 * k, by_parameter);
    add_product(steps.gradient.parameter, chart.parameters, 0, by_parameter);
    for (Index input = 0; input < steps.actuated.size; ++input) {
      steps.by_torque[n](row, input) = steps.gradient.torque(0, steps.actuated[input]);
    }
  }
  return Status::DONE;
}
}  // namespace

std::pair<Status, Index> step_states(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
  const StepRoutines & routines, const Chart & chart, const StateSteps & steps)
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
      status = fill_jacobians(system, run, scratch, tape, routines, chart, steps, n);
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
