// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "rollout.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <vector>

#include "evaluation.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "recursion.hpp"
#include "requests.hpp"

namespace closedloop
{

namespace
{
// Errors of the energy balance that end a run, as of simulation/guards.py.
constexpr double ENERGY_ERROR = 0.1, ROUNDING = 1e-9, LITTLE = 1e-6;
// A limit counts as clearly kept up to this share: sums in another order may decide otherwise.
constexpr double CLEARLY = 0.999;

// Roles of the effects' states (effects/table.py).
enum : Index {OWN, DISSIPATED, WORK};

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
  place_points(work.body, buffer.body, buffer.point, buffer.place[instant]);
}

/// Whether arrays fit together.
bool fit(
  const System & system, const Stepper & stepper, const Watch & watch, Table start,
  Cube<double> torque, Index zero_order_hold, Index decimation, Index steps, Cube<double> states)
{
  const Runs & runs = stepper.runs;
  const Index ns = system.ns(), count = stepper.kind == stepper::SWITCHING ? 2 : 1;
  const bool is_fixed = stepper.kind == stepper::FIXED || stepper.kind == stepper::STIFF_FIXED;
  const bool is_stiff = stepper.kind >= stepper::SWITCHING;
  return (start.rows == 1 || start.rows == states.pages) &&
         (torque.pages == 1 || torque.pages == states.pages) &&
         torque.columns == system.tau.size && watch.direct.size == system.tau.size &&
         watch.roles.size == system.effects.states.size && zero_order_hold > 0 &&
         decimation > 0 && steps >= 0 &&
         torque.rows * zero_order_hold >= std::max<Index>(steps, 1) &&
         states.rows == steps / decimation + 1 && states.columns == ns &&
         watch.first > 0 && watch.cycle > 0 && watch.most > 0 &&
         (is_fixed || (runs.control.rows == count && runs.scale.pages == count &&
         runs.scale.rows == 2 && runs.scale.columns == ns)) &&
         (!is_stiff || (runs.stiff_scratch.pages == count &&
         runs.stiff_scratch.rows == STIFF_ROWS && runs.stiff_scratch.columns == ns &&
         runs.matrix.rows == ns && runs.matrix.columns == ns && runs.pivots.size == ns)) &&
         (stepper.kind >= stepper::STIFF_FIXED || (runs.scratch.pages == count &&
         runs.scratch.rows >= stepper.tableau.a.rows + 3 && runs.scratch.columns == ns));
}

/// Arrays that every run finds as they are at first.
class Beginning
{
public:
  Beginning(const System & system, const Runs & runs)
  {
    keep(system.tau);
    keep(system.work.health);
    keep(system.partition.order);
    keep(system.partition.record);
    keep(system.whole.numbers);
    keep(runs.control.all());
    keep(runs.scale.all());
    keep(runs.stiff_scratch.all());
    keep(runs.monitor);
  }
  void restore() const
  {
    for (const auto & each : kept_) {
      each();
    }
  }

private:
  template<class Number>
  void keep(Vector<Number> place)
  {
    kept_.push_back(
      [place, values = std::vector<Number>(place.begin(), place.end())] {
        std::copy(values.begin(), values.end(), place.begin());
      });
  }

  std::vector<std::function<void()>> kept_;
};

/// Energy of a run [J]: where it is, where it went and where it came from.
struct Energies
{
  double kinetic = 0.0;
  double stored = 0.0;
  double dissipated = 0.0;
  double work = 0.0;

  double balance() const {return kinetic + stored + dissipated - work;}
  double apart(const Energies & other) const
  {
    return std::abs(stored - other.stored) + std::abs(dissipated - other.dissipated) +
           std::abs(work - other.work);
  }
};

/// One run after the other, each watched as a simulation is.
class WatchedRun
{
public:
  WatchedRun(
    const System & system, const Watch & watch, Index states, const Stepper & stepper = {},
    double step_size = 0.0)
  : system_(system), stepper_(stepper), watch_(watch), step_size_(step_size), values_(2 * states),
    state_{values_.data(), states}, since_{values_.data() + states, states},
    direct_(static_cast<std::size_t>(system.tau.size)), interrupt_(system.interrupted)
  {
  }

  Status make(
    Values start, Table torque, Index zero_order_hold, Index decimation, Index steps,
    Table states, Values found);
  Status judge(Table seen, Values work, Indices looks, Indices balanced, Values found);

private:
  void command(Values torque);
  void add_work_since();
  Energies present_energies();
  bool is_well(Values found);
  bool is_closed();
  Status advance(Index steps, Values found);

  const System & system_;
  const Stepper stepper_;
  const Watch & watch_;
  double step_size_;
  std::vector<double> values_;
  Values state_, since_;
  std::vector<double> direct_;
  Interrupt interrupt_;
  Energies start_, before_;
  double work_ = 0.0, moved_ = 0.0;
  Index done_ = 0, unseen_ = 0, between_ = 0, in_cycle_ = 0;
};

void WatchedRun::command(Values torque)
{
  if (std::equal(torque.begin(), torque.end(), system_.tau.begin())) {
    return;
  }
  add_work_since();
  restart(stepper_);
  copy(torque, system_.tau);
}

/// Add the work of the torques held since the last call.
void WatchedRun::add_work_since()
{
  const Values direct{direct_.data(), system_.tau.size};
  for (Index i = 0; i < direct.size; ++i) {
    direct[i] = watch_.direct[i] * system_.tau[i];
  }
  add_work(system_.manifold, direct, since_, state_, 1, {&work_, 1});
  copy(state_, since_);
}

Energies WatchedRun::present_energies()
{
  double found[2];
  evaluate_with_poses(system_, state_);
  energies(system_.model, system_.work, system_.qd(state_), {found, 2});
  Energies present{found[0], found[1], 0.0, 0.0};
  for (Index row = 0; row < system_.effects.count(); ++row) {
    present.stored += system_.effects.output(row, effect::STORED);
  }
  for (Index place = 0; place < watch_.roles.size; ++place) {
    const double value = state_[system_.own() + place];
    present.dissipated += watch_.roles[place] == DISSIPATED ? value : 0.0;
    present.work += watch_.roles[place] == WORK ? value : 0.0;
  }
  add_work_since();
  present.work += work_;
  return present;
}

/// Look at the energy balance; return whether the guard surely does not end the run.
bool WatchedRun::is_well(Values found)
{
  unseen_ = 0;
  const Energies present = present_energies();
  moved_ = std::max(moved_, present.kinetic + present.apart(start_));
  const double rounding =
    CLEARLY * (ROUNDING * (present.kinetic + std::abs(present.stored)) + watch_.nothing);
  const double lost = std::abs(present.balance() - start_.balance()) - rounding;
  const double share = lost > 0.0 ? lost / moved_ : 0.0;
  if (!(share <= found[finding::SHARE])) {
    found[finding::SHARE] = share;
    found[finding::LOST] = lost;
    found[finding::MOVED] = moved_;
    found[finding::STEPS] = static_cast<double>(done_);
  }
  const double moving = before_.kinetic + present.apart(before_);
  const double lately = std::abs(present.balance() - before_.balance());
  before_ = present;
  return found[finding::SHARE] <= CLEARLY * ENERGY_ERROR &&
         lately <= CLEARLY * (ENERGY_ERROR * moving + LITTLE * moved_) + rounding;
}

/// Look at the loops where the method does not close them.
bool WatchedRun::is_closed()
{
  if (std::isinf(watch_.closure)) {
    return true;
  }
  if (watch_.regular && system_.work.health[health::SINGULAR_COUNT] > 0.0) {
    return false;
  }
  evaluate_with_poses(system_, state_);
  return largest(system_.work.closure) <= CLEARLY * watch_.closure;
}

/// Make steps at once, as one call of a simulation does.
Status WatchedRun::advance(Index steps, Values found)
{
  for (Index left = steps; left > 0;) {
    Index portion = std::min({left, watch_.most, watch_.cycle - in_cycle_});
    if (!watch_.whole) {
      portion = std::min(portion, between_ - unseen_);
    }
    const Status status =
      make_steps(system_, stepper_, state_, done_, step_size_, portion);
    if (status != Status::DONE) {
      return status;
    }
    left -= portion;
    done_ += portion;
    unseen_ += portion;
    in_cycle_ = (in_cycle_ + portion) % watch_.cycle;
    if (unseen_ >= between_) {
      between_ = std::max(std::min(2 * between_, watch_.rarely), watch_.first);
      if (!is_well(found)) {
        return Status::DOUBTFUL;
      }
    }
    if (!is_closed()) {
      return Status::DOUBTFUL;
    }
    if (interrupt_.after(portion)) {
      return Status::INTERRUPTED;
    }
  }
  return unseen_ > 0 && steps >= watch_.call && !is_well(found) ? Status::DOUBTFUL : Status::DONE;
}

Status WatchedRun::make(
  Values start, Table torque, Index zero_order_hold, Index decimation, Index steps, Table states,
  Values found)
{
  copy(start, state_);
  copy(start, since_);
  copy(start, states[0]);
  found.fill(0.0);
  work_ = moved_ = 0.0;
  done_ = unseen_ = in_cycle_ = 0;
  between_ = watch_.first;
  start_ = before_ = {watch_.kinetic, watch_.stored, 0.0, 0.0};
  while (done_ < steps) {
    command(torque[done_ / zero_order_hold]);
    const Status status = advance(
      std::min(
        {zero_order_hold - done_ % zero_order_hold, decimation - done_ % decimation,
          steps - done_}), found);
    if (status != Status::DONE) {
      return status;
    }
    if (done_ % decimation == 0) {
      copy(state_, states[done_ / decimation]);
    }
  }
  return is_well(found) ? Status::DONE : Status::DOUBTFUL;
}

Status WatchedRun::judge(
  Table seen, Values work, Indices looks, Indices balanced, Values found)
{
  found.fill(0.0);
  for (Index k = 0; k < looks.size; ++k) {
    copy(seen[k], state_);
    copy(seen[k], since_);
    work_ = work[k];
    done_ = looks[k];
    if (k == 0) {
      start_ = before_ = present_energies();
    } else if ((balanced[k] != 0 && !is_well(found)) || !is_closed()) {
      return Status::DOUBTFUL;
    }
  }
  return Status::DONE;
}
}  // namespace

void run_samples(
  const System & system, const Stepper & stepper, const Watch & watch, double step_size,
  Table start, Cube<double> torque, Index zero_order_hold, Index decimation, Index steps,
  Cube<double> states, Indices status, Table found)
{
  if (!fit(
      system, stepper, watch, start, torque, zero_order_hold, decimation, steps, states) ||
    status.size != states.pages || found.rows != states.pages ||
    found.columns != finding::COLUMNS)
  {
    throw std::invalid_argument("run_samples: arrays that do not fit together");
  }
  const Beginning beginning(system, stepper.runs);
  WatchedRun run(system, watch, start.columns, stepper, step_size);
  status.fill(static_cast<Index>(Status::INTERRUPTED));
  for (Index sample = 0; sample < states.pages; ++sample) {
    const Status ended = run.make(
      start[start.rows > 1 ? sample : 0], torque[torque.pages > 1 ? sample : 0], zero_order_hold,
      decimation, steps, states[sample], found[sample]);
    beginning.restore();
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

Status judge(
  const System & system, const Watch & watch, Table seen, Values work, Indices looks,
  Indices balanced, Values found)
{
  if (seen.rows < 1 || work.size != seen.rows || looks.size != seen.rows ||
    balanced.size != seen.rows || found.size != finding::COLUMNS || watch.roles.size > 0 ||
    watch.direct.size != system.tau.size)
  {
    throw std::invalid_argument("judge: arrays that do not fit together");
  }
  return WatchedRun(system, watch, seen.columns).judge(seen, work, looks, balanced, found);
}

}  // namespace closedloop
