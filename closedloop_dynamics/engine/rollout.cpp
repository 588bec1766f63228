// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "rollout.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "evaluation.hpp"
#include "interrupt.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "projection.hpp"
#include "recursion.hpp"
#include "requests.hpp"
#include "stick_slip.hpp"

namespace closedloop
{

namespace
{
// Smallest pivot, about the squared sine between an equation and the others, above which a position
// is certainly not singular.
constexpr double CLEAR_PIVOT = 1e-6;

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
  // In space the states alone are kept.
  if (buffer.qdd.rows == 0) {
    return;
  }
  const Values q = system.q(state), qd = system.qd(state);
  load_effect_states(system, state);
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
  cut_wrenches(system.model, work, work.body, system.lam, buffer.wrench[instant]);
  place_points(work.body, buffer.body, buffer.point, buffer.place[instant]);
}

/// Make a run; DOUBTFUL where a guard may end it, or the host has to act.
Status make(
  const System & system, Run & run, Values start, Table torque, Index zero_order_hold,
  Index decimation, Index steps, Table states)
{
  const auto status_of = [&](Outcome outcome) {
      return outcome == Outcome::DONE ? Status::DONE : outcome == Outcome::FAILED ?
             run.status() : Status::DOUBTFUL;
    };
  std::vector<double> own(start.begin(), start.end());
  const Values state = view(own);
  run.begin_copy(system, state);
  copy(start, states[0]);
  for (Index done = 0; done < steps; ) {
    const Values row = torque[done / zero_order_hold];
    if (!std::equal(row.begin(), row.end(), system.tau.begin())) {
      run.command(system, state, {row.data, row.size});
    }
    const Index at_once = std::min(
      {zero_order_hold - done % zero_order_hold, decimation - done % decimation, steps - done});
    Outcome found = run.make(system, state, run.guard_limits().step_size, at_once, at_once);
    while (found == Outcome::INACCURATE) {
      found = run.resume(system, state, true);
    }
    if (found != Outcome::DONE) {
      return status_of(found);
    }
    done += at_once;
    if (done % decimation == 0) {
      copy(state, states[done / decimation]);
    }
  }
  const Outcome found = run.check_energy(system, state);
  return found == Outcome::INACCURATE ? Status::DONE : status_of(found);
}

/// Whether the loops and their rates are closed, far from singular positions.
bool is_closed(const System & system, double tolerance, Values state)
{
  const Values q = system.q(state), qd = system.qd(state);
  double fastest = 0.0;
  for (double rate : qd) {
    fastest = std::max(fastest, std::abs(rate));
  }
  evaluate_with_poses(system, state);
  const Workspace & work = system.work;
  outward(system.model, q, qd, work);
  update(system.model, work, Responses::NONE);
  return largest(work.closure) <= tolerance && largest(work.closure_rate) <= tolerance * fastest &&
         work.health[health::SMALLEST_PIVOT] >= CLEAR_PIVOT && all_finite(system.qdd) &&
         is_position(system.manifold, q);
}
}  // namespace

void check_starts(
  const System & system, const Run & like, double tolerance, Table states, Indices fine)
{
  if (states.columns != system.ns() || fine.size != states.rows ||
    system.has_cut_coordinates() || !system.whole.empty() || !like.fits(system))
  {
    throw std::invalid_argument("check_starts: arrays that do not fit together");
  }
  const Snapshot snapshot(system);
  Run run(like);
  Interrupt interrupt(system.interrupted, system.nv());
  std::vector<double> values(static_cast<std::size_t>(system.ns()));
  const Values trial{values.data(), system.ns()};
  for (Index sample = 0; sample < states.rows && !interrupt.after(2); ++sample) {
    const Values state = states[sample];
    bool is_fine = all_finite(state) && is_closed(system, tolerance, state);
    if (is_fine) {
      copy(state, trial);
      const Status ended = run.try_step(system, trial, run.guard_limits().step_size);
      if (ended == Status::INTERRUPTED) {
        snapshot.restore();
        return;
      }
      is_fine = ended == Status::DONE;
    }
    if (is_fine && system.has_effects()) {
      begin_friction(
        system.effects, system.qd(state),
        state.part(system.own(), system.effects.states.size));
    }
    fine[sample] = is_fine ? 1 : 0;
    snapshot.restore();
  }
}

void run_samples(
  const System & system, const Run & like, Table start, Cube<double> torque,
  Index zero_order_hold, Index decimation, Index steps, Cube<double> states, Indices status,
  Table found)
{
  const Index count = states.pages;
  if ((start.rows != 1 && start.rows != count) || (torque.pages != 1 && torque.pages != count) ||
    torque.columns != system.tau.size || zero_order_hold < 1 || decimation < 1 || steps < 0 ||
    torque.rows < 1 || (steps > 0 && torque.rows <= (steps - 1) / zero_order_hold) ||
    states.rows != steps / decimation + 1 || states.columns != system.ns() ||
    status.size != count || found.rows != count || found.columns != finding::COLUMNS ||
    !like.fits(system))
  {
    throw std::invalid_argument("run_samples: arrays that do not fit together");
  }
  const Snapshot snapshot(system);
  status.fill(static_cast<Index>(Status::INTERRUPTED));
  for (Index sample = 0; sample < count; ++sample) {
    Run run(like);
    const Status ended = make(
      system, run, start[start.rows > 1 ? sample : 0], torque[torque.pages > 1 ? sample : 0],
      zero_order_hold, decimation, steps, states[sample]);
    run.write_finding(found[sample]);
    snapshot.restore();
    status[sample] = static_cast<Index>(ended);
    if (ended == Status::INTERRUPTED) {
      return;
    }
  }
}

void annotate(
  const System & system, Table torque, Index zero_order_hold, Index decimation,
  const RunBuffer & buffer)
{
  Interrupt interrupt(system.interrupted, system.nv());
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
  Interrupt interrupt(system.interrupted, system.nv());
  for (Index instant = 0; instant < state.rows && !interrupt.after(1); ++instant) {
    const Values q = system.q(state[instant]), qd = system.qd(state[instant]);
    load_effect_states(system, state[instant]);
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

}  // namespace closedloop
