// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "rollout.hpp"

#include <algorithm>

#include "evaluation.hpp"
#include "fixed_steps.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
/// Which row of the torques acts at an instant.
Index row_at(Index instant, Index decimation, Index zero_order_hold)
{
  return std::max<Index>(instant * decimation - 1, 0) / zero_order_hold;
}

/// Record one instant.
void record(const System & system, Values state, const RunBuffer & buffer, Index instant)
{
  const Workspace & work = system.work;
  copy(state, buffer.state[instant]);
  // Of mechanisms in space the states alone are kept.
  if (buffer.qdd.rows == 0) {
    return;
  }
  const Values q = system.q(state), qd = system.qd(state);
  take_states(system, state);
  evaluate(system, q, qd);
  copy(system.qdd, buffer.qdd[instant]);
  copy(system.lam, buffer.lam[instant]);
  buffer.scalars(instant, 0) = largest(work.closure);
  energies(system.model, work, qd, buffer.scalars[instant].part(1, 2));
  const Table output = buffer.output[instant];
  for (Index row = 0; row < output.rows; ++row) {
    output(row, 0) = system.effects.output(row, effect::STORED);
    output(row, 1) = system.effects.output(row, 1);
  }
  cut_wrenches(
    system.model.cut, system.model.cut_point, work.cut_piece, work.body, system.lam, work.share,
    buffer.wrench[instant]);
  for (Index k = 0; k < buffer.body.size; ++k) {
    point_position(
      work, buffer.body[k], buffer.point(k, 0), buffer.point(k, 1), buffer.place[instant][k]);
  }
}

/// Add the work of the torques held since the last call.
void add_work_since(const System & system, Values state, const RunBuffer & buffer)
{
  add_work(system.manifold, system.tau, buffer.since, state, 1, buffer.work);
  copy(state, buffer.since);
}
}  // namespace

std::pair<Status, Index> run_fixed(
  const System & system, const Tableau & tableau, Stabilisation stabilisation, Values state,
  double step_size, Table torque, Index zero_order_hold, Index decimation, Index steps,
  Table scratch, const RunBuffer & buffer)
{
  copy(torque[0], system.tau);
  copy(state, buffer.since);
  buffer.work[0] = 0.0;
  record(system, state, buffer, 0);
  Interrupt interrupt(system.interrupted);
  Index done = 0;
  while (done < steps) {
    if (done % zero_order_hold == 0) {
      add_work_since(system, state, buffer);
      copy(torque[done / zero_order_hold], system.tau);
    }
    const Index portion =
      std::min(zero_order_hold - done % zero_order_hold, decimation - done % decimation);
    const auto [status, made] = make_fixed_steps(
      system, tableau, stabilisation, state, step_size, std::min(portion, steps - done), scratch,
      interrupt);
    done += made;
    if (status != Status::DONE) {
      return {status, done};
    }
    if (done % decimation == 0) {
      record(system, state, buffer, done / decimation);
    }
  }
  add_work_since(system, state, buffer);
  return {Status::DONE, done};
}

void annotate(
  const System & system, Table torque, Index zero_order_hold, Index decimation,
  const RunBuffer & buffer)
{
  Interrupt interrupt(system.interrupted);
  for (Index instant = 0; instant < buffer.state.rows && !interrupt.after(1); ++instant) {
    copy(torque[row_at(instant, decimation, zero_order_hold)], system.tau);
    record(system, buffer.state[instant], buffer, instant);
  }
}

void fill_joint_forces(
  const System & system, Table torque, Index zero_order_hold, Index decimation, Table state,
  Table qdd, Table lam, Table scratch, Cube<double> out)
{
  const Indexes & tree = system.model.tree;
  Interrupt interrupt(system.interrupted);
  for (Index instant = 0; instant < state.rows && !interrupt.after(1); ++instant) {
    const Values q = system.q(state[instant]), qd = system.qd(state[instant]);
    take_states(system, state[instant]);
    outward(system.model, q, qd, system.work);
    copy(torque[row_at(instant, decimation, zero_order_hold)], system.tau);
    apply_listed(system, q, qd);
    bias_forces(system.work, scratch);
    joint_wrenches(system.model, system.work, qdd[instant], lam[instant], scratch);
    for (Index i = 1; i < tree.rows; ++i) {
      copy(scratch[i], out[instant][tree(i, tree::DOF)]);
    }
  }
}

void energies_of_states(const System & system, Table state, Table out)
{
  Interrupt interrupt(system.interrupted);
  for (Index k = 0; k < state.rows && !interrupt.after(1); ++k) {
    const Values q = system.q(state[k]), qd = system.qd(state[k]);
    evaluate(system, q, qd);
    energies(system.model, system.work, qd, out[k]);
  }
}

}  // namespace closedloop
