// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "run.hpp"

#include <time.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "evaluation.hpp"
#include "left_out.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "recursion.hpp"
#include "requests.hpp"

namespace closedloop
{

namespace
{
// Errors of the energy balance, relative to the energy exchanged, that give a warning and that end
// the run; rounding, relative to the energy; a negligible error between two checks, relative to the
// energy exchanged, and after few steps to the work of the scene's forces along its length;
// rounding of that.
constexpr double ENERGY_WARN = 1e-3, ENERGY_ERROR = 0.1;
constexpr double ROUNDING = 1e-9, LITTLE = 1e-6, NOTHING = 1e-13;
// A winding that changes by more between two checks has leapt by a whole turn [rad].
constexpr double LEAP = 1.5 * M_PI;
// A step is made again in two halves: first one of so many, then, twice as rarely each time, one of
// so many.
constexpr Index FIRST_SAMPLE = 30, SAMPLE_EVERY = 1000;
// Steps before the first check whether equations can be left out again, and the most between two.
constexpr Index EQUATIONS_FIRST_CHECK = 64, EQUATIONS_CHECK_EVERY = 4096;
// How often equations are chosen while the motion goes on by less than a share of a step.
constexpr Index MOST_EXCHANGES = 20;
constexpr double LEAST_PROGRESS = 1e-2;

// Checks, in this order; bits of what is due.
constexpr unsigned CABLES = 1, ENERGY = 2, EQUATIONS = 4, LOOPS = 8;

/// CPU time of this thread [s].
double thread_time()
{
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}
}  // namespace

void EnergyFinding::record(double lost, double energy, double rounding, double time)
{
  if (energy > moved) {
    moved = energy;
  }
  lost -= rounding;
  double share = lost > 0.0 && moved > 0.0 ? lost / moved : 0.0;
  if (!std::isfinite(lost)) {
    share = std::numeric_limits<double>::infinity();
  }
  if (!(share <= worst)) {
    worst = share;
    worst_time = time;
    worst_lost = lost;
    worst_moved = moved;
  }
}

Run::Run(
  const System & system, std::unique_ptr<Stepper> stepper, const GuardLimits & limits, Indices roles,
  Indices windings)
: stepper_(std::move(stepper)), start_(static_cast<std::size_t>(system.ns())), before_(start_)
{
  account_.roles.assign(roles.begin(), roles.end());
  account_.since.resize(static_cast<std::size_t>(system.tau.size));
  set_guard_limits(system, limits, windings);
  restart_guards();
  if (!fits(system)) {
    throw std::invalid_argument("a run: roles that do not fit the system");
  }
}

void Run::set_guard_limits(const System & system, const GuardLimits & limits, Indices windings)
{
  const auto is_place = [&](Index place) {return place > 0 && place < system.effects.data.size;};
  if (!(limits.first > 0 && limits.most > 0 && limits.step_size > 0.0 &&
    std::all_of(windings.begin(), windings.end(), is_place)))
  {
    throw std::invalid_argument("a run: limits or windings that do not fit the system");
  }
  limits_ = limits;
  if (!std::equal(windings.begin(), windings.end(), windings_.begin(), windings_.end())) {
    windings_.assign(windings.begin(), windings.end());
    angles_.assign(windings_.size(), 0.0);
    cables_checked_ = false;
  }
}

void Run::take_method(const System & system, const Run & other)
{
  if (!other.fits(system)) {
    throw std::invalid_argument("a run: the method of another system");
  }
  stepper_ = other.stepper_;
  limits_ = other.limits_;
}

void Run::rewind(const System & system)
{
  stepper_->rewind(system);
}

Status Run::try_step(const System & system, Values state, double size)
{
  const Snapshot snapshot(system);
  const std::unique_ptr<Stepper> twin = stepper_->clone();
  twin->restart(system, true);
  const Status status = twin->advance(system, state, {time(), 0, size, 1}).status;
  snapshot.restore();
  return status;
}

Index Run::whole_length(const System & system)
{
  return system.ns() + stepper_->memory_length() + system.partition.order.size +
         system.partition.record.size;
}

void Run::write_whole(const System & system, Values state, Values out)
{
  const Index memory = stepper_->memory_length();
  const Partition & partition = system.partition;
  copy(state, out.part(0, state.size));
  stepper_->store_memory(out.part(state.size, memory));
  double * const behind = out.begin() + state.size + memory;
  std::copy(
    partition.record.begin(), partition.record.end(),
    std::copy(partition.order.begin(), partition.order.end(), behind));
}

void Run::recall(const System & system, Values state, Values whole)
{
  const Index memory = stepper_->memory_length();
  const Partition & partition = system.partition;
  copy(whole, state);
  stepper_->recall_memory(whole.part(state.size, memory));
  const Values choice = whole.from(state.size + memory);
  for (Index i = 0; i < partition.order.size; ++i) {
    partition.order[i] = static_cast<Index>(choice[i]);
  }
  copy(choice.from(partition.order.size), partition.record);
}

double Run::accuracy_in(const System & system, Values whole)
{
  const std::unique_ptr<Stepper> twin = stepper_->clone();
  twin->recall_memory(whole.part(system.ns(), twin->memory_length()));
  return twin->report().accuracy;
}

bool Run::fits(const System & system) const
{
  return stepper_->fits(system) &&
         static_cast<Index>(account_.roles.size()) == system.effects.states.size &&
         static_cast<Index>(account_.since.size()) == system.tau.size &&
         static_cast<Index>(start_.size()) == system.ns() &&
         std::all_of(
    windings_.begin(), windings_.end(),
    [&](Index place) {return place < system.effects.data.size;});
}

void Run::begin(const System & system, Values state)
{
  copy(state, view(start_));
  mark_coordinates(system, account_, state);
  account_.held_work = 0.0;
  account_.reference = std::numeric_limits<double>::quiet_NaN();
  set_time(0.0, 0);
  restart_guards();
}

void Run::begin_copy(const System & system, Values state)
{
  const std::vector<double> health(system.work.health.begin(), system.work.health.end());
  account_.reference = 0.0;
  const Energies balance = draw_balance(system, account_, state);
  account_.held_work = 0.0;
  account_.reference = balance.kinetic + balance.stored;
  // The run has no evaluation yet.
  std::copy(health.begin(), health.end(), system.work.health.begin());
  set_time(0.0, 0);
  restart_guards();
  to_sample_ = -1;
  begin_ = check_ = {balance.kinetic, balance.stored, 0.0, 0.0, 0.0};
  begun_ = true;
  checked_ = Checked::AT_BALANCE;
}

void Run::set_time(double base, Index steps)
{
  time_base_ = base;
  steps_ = steps;
  advanced_ = 0.0;
}

RunReport Run::report()
{
  RunReport found = report_;
  found.time = time();
  found.check_residual = check_.residual;
  found.first_residual = begun_ ? begin_.residual : 0.0;
  found.at_start = !account_.knows_start();
  return found;
}

void Run::clear_cost()
{
  report_.simulated = report_.steps = report_.elapsed = report_.worked = 0.0;
  report_.local_error = StepReport::UNKNOWN;
  between_samples_ = FIRST_SAMPLE;
  stepper_->clear_report();
}

void Run::sample(bool wanted) {to_sample_ = wanted ? 0 : -1;}

void Run::restart_guards()
{
  report_.energy = {};
  report_.unchecked = equations_since_ = 0;
  between_ = limits_.first;
  equations_between_ = EQUATIONS_FIRST_CHECK;
  begun_ = warned_ = report_.failed = false;
  jump();
}

void Run::jump()
{
  checked_ = Checked::NOT;
  cables_checked_ = false;
  lenient_since_ = -std::numeric_limits<double>::infinity();
}

void Run::jump_balance(const System & system, Values state, double energy)
{
  mark_coordinates(system, account_, state);
  account_.reference += energy;
}

void Run::find_start(const System & system)
{
  if (account_.knows_start()) {
    return;
  }
  // Without the work up to there.
  EnergyAccount none = account_;
  none.held_work = none.reference = 0.0;
  const Energies start = draw_evaluated_balance(system, none, view(start_));
  account_.reference = start.kinetic + start.stored;
  start_balance_ = {start.kinetic, start.stored, 0.0, 0.0, 0.0};
}

Energies Run::balance(const System & system, Values state)
{
  find_start(system);
  return draw_evaluated_balance(system, account_, state);
}

void Run::keep(const System & system, Values state, std::vector<double> & kept)
{
  kept.resize(static_cast<std::size_t>(whole_length(system)));
  write_whole(system, state, view(kept));
}

/// Scale of energies of a run in which joints feel so much force, by size.
double Run::energy_scale(const System & system, double felt) const
{
  const double extent = limits_.extent;
  const Values & gravity = system.model.gravity;
  const double weight = gravity.size == 2 ?
    std::hypot(gravity[0], gravity[1]) : std::hypot(gravity[0], gravity[1], gravity[2]);
  // With the energy of a rate: at rest without weight there is no other scale.
  return limits_.mass * (extent * weight + extent * extent) + std::max(extent, 1.0) * felt;
}

/// How far a cable is wound round a pulley [rad].
double Run::winding(const System & system, Index number) const
{
  const Values & data = system.effects.data;
  const Index place = windings_[static_cast<std::size_t>(number)];
  return data[place] / std::abs(data[place - 1]);
}

/// Store good windings, of the evaluated state.
void Run::accept_windings(const System & system, Values state, const Energies & balance)
{
  const Values angles = view(angles_);
  for (Index k = 0; k < angles.size; ++k) {
    angles[k] = winding(system, k);
  }
  keep(system, state, kept_by_cables_);
  report_.cable_time = time();
  report_.cable_residual = balance.residual;
  cables_checked_ = true;
}

/// Store a good balance.
void Run::accept_balance(const Energies & balance)
{
  check_ = balance;
  report_.check_time = time();
  checked_ = Checked::AT_BALANCE;
  if (!begun_) {
    begin_ = balance;
    begun_ = true;
  }
}

/// Check the start of a run, or the state after a jump.
void Run::check_start(const System & system, Values state)
{
  const bool cables = !windings_.empty() && !cables_checked_;
  if (checked_ != Checked::NOT && !cables) {
    return;
  }
  // A short run needs no check at the start.
  const bool at_start = !account_.knows_start() && time() == 0.0;
  if (at_start && !cables) {
    keep(system, state, kept_);
    report_.check_time = 0.0;
    checked_ = Checked::AT_STATE;
    return;
  }
  find_start(system);
  const Energies balance = draw_balance(system, account_, state);
  if (checked_ == Checked::NOT) {
    keep(system, state, kept_);
    accept_balance(balance);
  }
  if (cables) {
    accept_windings(system, state, balance);
  }
}

Outcome Run::check_cables(const System & system, Values state)
{
  const Energies balance = draw_balance(system, account_, state);
  double most = LEAP;
  bool leaps = false;
  const Values angles = view(angles_);
  for (Index k = 0; k < angles.size; ++k) {
    const double moved = std::abs(winding(system, k) - angles[k]);
    if (moved > most) {
      most = moved;
      report_.leapt = k;
      report_.winding = angles[k];
      leaps = true;
    }
  }
  if (leaps) {
    return Outcome::CABLE_LEAPT;
  }
  accept_windings(system, state, balance);
  return Outcome::DONE;
}

/// Record the energy exchanged and the error of a balance, whose scale is given; return the
/// negligible part of it [J].
double Run::record_balance(const Energies & present, double scale)
{
  if (checked_ == Checked::AT_STATE) {
    check_ = begin_ = start_balance_;
    checked_ = Checked::AT_BALANCE;
    begun_ = true;
  }
  // A step in which a motion begins may lose all of a tiny energy.
  const double little = ROUNDING * (present.kinetic + std::abs(present.stored)) +
    (report_.unchecked < limits_.first ? LITTLE : NOTHING) * scale;
  const Energies & start = begun_ ? begin_ : present;
  report_.energy.record(
    std::abs(present.residual - start.residual), present.kinetic + present.apart(start), little,
    time());
  return little;
}

/// Compare a balance with the latest good one, and accept it unless too much is lost.
Outcome Run::compare_balance(const Energies & present, double scale)
{
  const bool compares = checked_ != Checked::NOT;
  const double little = record_balance(present, scale);
  report_.unchecked = 0;
  if (compares) {
    report_.moving = check_.kinetic + present.apart(check_);
    report_.lost = std::abs(present.residual - check_.residual);
    const double allowed = ENERGY_ERROR * report_.moving + LITTLE * report_.energy.moved + little;
    if (!(report_.lost <= allowed) || report_.energy.worst > ENERGY_ERROR) {
      report_.failed = true;
      return Outcome::ENERGY_LOST;
    }
  }
  accept_balance(present);
  if (!(report_.energy.worst > ENERGY_WARN) || warned_) {
    return Outcome::DONE;
  }
  warned_ = true;
  return Outcome::INACCURATE;
}

Outcome Run::check_loops(const System & system, Values state)
{
  if (limits_.regular && system.work.health[health::SINGULAR_COUNT] > 0.0) {
    return Outcome::NOT_REGULAR;
  }
  double closure = 0.0;
  if (system.whole.empty()) {
    evaluate_with_poses(system, state);
    closure = largest(system.work.closure);
  } else {
    const AllEquations & all = system.whole;
    outward(all.model, system.q(state), system.qd(state), all.own);
    update(all.model, all.own, Responses::NONE);
    closure = largest(all.own.closure);
  }
  return closure <= limits_.closure ? Outcome::DONE : Outcome::LOOPS_OPEN;
}

Outcome Run::check_energy(const System & system, Values state)
{
  find_start(system);
  const Energies present = draw_balance(system, account_, state);
  const Outcome found = compare_balance(
    present, energy_scale(system, sum_of_sizes(system.applied)));
  if (found != Outcome::ENERGY_LOST) {
    keep(system, state, kept_);
  }
  return found;
}

Energies Run::record_energy(const System & system, Values state)
{
  find_start(system);
  const Energies present = draw_balance(system, account_, state);
  record_balance(present, energy_scale(system, sum_of_sizes(system.applied)));
  return present;
}

Outcome Run::check_state(
  const System & system, Values state, Index steps, double work, const Stored * stored,
  bool at_energy)
{
  steps_ = steps;
  account_.held_work = work;
  Outcome found = Outcome::DONE;
  if (at_energy && stored != nullptr) {
    found = compare_balance(
      balance_of(system, account_, state, stored->kinetic, stored->potential),
      energy_scale(system, stored->felt));
  } else if (at_energy) {
    found = check_energy(system, state);
  }
  return (found == Outcome::DONE || found == Outcome::INACCURATE) &&
         !std::isinf(limits_.closure) ? check_loops(system, state) : found;
}

/// Make the first check that is due.
Outcome Run::check(const System & system, Values state)
{
  if ((due_ & CABLES) != 0) {
    due_ -= CABLES;
    return check_cables(system, state);
  }
  if ((due_ & ENERGY) != 0) {
    due_ -= ENERGY;
    return check_energy(system, state);
  }
  if ((due_ & EQUATIONS) != 0) {
    due_ -= EQUATIONS;
    leaves_out_ = true;
    return Outcome::CHOICE;
  }
  due_ -= LOOPS;
  return check_loops(system, state);
}

/// Book steps that were made.
void Run::book(const System & system, Index steps)
{
  const double elapsed = static_cast<double>(steps) * report_.size;
  report_.simulated += elapsed;
  report_.steps += static_cast<double>(steps);
  left_ -= steps;
  if (report_.size == limits_.step_size) {
    steps_ += steps;
  } else {
    time_base_ += elapsed;
  }
  if (to_sample_ > 0) {
    to_sample_ -= steps;
  }
  report_.unchecked += steps;
  due_ = windings_.empty() ? 0 : CABLES;
  if (report_.unchecked >= between_) {
    between_ = std::max(std::min(2 * between_, limits_.rarely), limits_.first);
    due_ |= ENERGY;
  }
  if (limits_.chooses) {
    equations_since_ += steps;
    if (equations_since_ >= equations_between_) {
      equations_since_ = 0;
      if (system.whole.empty() &&
        stepper_->stabilisation() >= Stabilisation::PROJECTION)
      {
        due_ |= EQUATIONS;
      }
    }
  }
  due_ |= std::isinf(limits_.closure) ? 0 : LOOPS;
}

/// Make steps, or go on with those that failed, or find out why not.
Outcome Run::make_portion(const System & system, Values state, Index steps)
{
  advanced_ = 0.0;
  const bool whole = report_.size == limits_.step_size;
  const Grid grid{whole ? time_base_ : time(), whole ? steps_ : 0, report_.size, steps};
  const double worked = limits_.timed ? thread_time() : 0.0;
  const auto begin = std::chrono::steady_clock::now();
  const auto [status, advanced] = stepper_->advance(system, state, grid);
  const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - begin;
  report_.elapsed += spent.count();
  if (limits_.timed) {
    report_.worked += thread_time() - worked;
  }
  report_.status = status;
  if (status == Status::DONE) {
    handed_ = 0;
    book(system, steps);
    return Outcome::DONE;
  }
  if (status == Status::INTERRUPTED) {
    // Steps that count as not made.
    copy(view(before_), state);
    stepper_->restart(system, true);
    handed_ = 0;
    return Outcome::FAILED;
  }
  advanced_ = advanced;
  handed_ = steps;
  return choose_or_end(system);
}

/// After a step that failed: ask for other closure equations, where these may be why.
Outcome Run::choose_or_end(const System & system)
{
  if (time() > reached_ + LEAST_PROGRESS * report_.size) {
    reached_ = time();
    exchanges_ = 0;
  }
  if (system.whole.empty() || stepper_->stabilisation() < Stabilisation::PROJECTION ||
    report_.status == Status::CONTACT_PASSED)
  {
    return give_up();
  }
  if (++exchanges_ > MOST_EXCHANGES) {
    report_.status = Status::NO_PROGRESS;
    return give_up();
  }
  const Values & numbers = system.whole.numbers;
  const bool poor = report_.status == Status::POOR_EQUATIONS;
  report_.nearby = !poor || numbers[left_out::OPENED] == 1.0;
  report_.or_these = poor && numbers[left_out::LENIENT] == 0.0;
  numbers[left_out::ASKED] = 1.0;
  return Outcome::CHOICE;
}

/// End at the state that a failed step has left.
Outcome Run::give_up()
{
  report_.simulated += advanced_;
  // There is no size before the first call.
  report_.steps += advanced_ > 0.0 ? std::nearbyint(advanced_ / report_.size) : 0.0;
  time_base_ += advanced_;
  advanced_ = 0.0;
  handed_ = 0;
  return Outcome::FAILED;
}

Outcome Run::estimate_error(const System & system, Values state)
{
  to_sample_ = between_samples_;
  between_samples_ = std::min(2 * between_samples_, SAMPLE_EVERY);
  const Snapshot snapshot(system);
  const std::unique_ptr<Stepper> twin = stepper_->clone();
  std::vector<double> ends[2];
  Status statuses[2];
  for (Index halves : {1, 2}) {
    std::vector<double> & end = ends[halves - 1];
    end.assign(state.begin(), state.end());
    statuses[halves - 1] = twin->advance(
      system, view(end), {0.0, 0, limits_.step_size / static_cast<double>(halves), halves}).status;
  }
  snapshot.restore();
  if (statuses[0] == Status::INTERRUPTED || statuses[1] == Status::INTERRUPTED) {
    report_.status = Status::INTERRUPTED;
    return Outcome::FAILED;
  }
  if (statuses[0] == Status::DONE && statuses[1] == Status::DONE) {
    double apart = 0.0;
    for (Index i = 0; i < system.nq(); ++i) {
      const std::size_t place = static_cast<std::size_t>(i);
      apart = std::max(
        apart, std::abs(error_weight(system.manifold, i) * (ends[0][place] - ends[1][place])));
    }
    // Half a step has this share of the error.
    const double error = apart / (1.0 - std::pow(0.5, static_cast<double>(limits_.order)));
    report_.local_error = std::isnan(report_.local_error) ? error : std::max(error, report_.local_error);
  }
  return Outcome::DONE;
}

/// Make steps until all are made, or something is to be done or reported.
Outcome Run::make_until_outcome(const System & system, Values state)
{
  while (true) {
    while (due_ != 0) {
      const Outcome found = check(system, state);
      if (found != Outcome::DONE) {
        return found;
      }
    }
    if (left_ <= 0) {
      // A check after a call, unless that would cost more than its few steps.
      if (report_.unchecked == 0 || call_ < limits_.call) {
        return Outcome::DONE;
      }
      due_ = ENERGY;
      continue;
    }
    check_start(system, state);
    if (to_sample_ == 0) {
      const Outcome found = estimate_error(system, state);
      if (found != Outcome::DONE) {
        return found;
      }
    }
    Index portion = std::min(left_, limits_.most);
    if (!limits_.whole) {
      portion = std::min(portion, between_ - report_.unchecked);
    }
    if (limits_.chooses) {
      portion = std::min(portion, equations_between_ - equations_since_);
    }
    if (to_sample_ > 0) {
      portion = std::min(portion, to_sample_);
    }
    copy(state, view(before_));
    const Outcome found = make_portion(system, state, std::max<Index>(portion, 1));
    if (found != Outcome::DONE) {
      return found;
    }
  }
}

void Run::add_work(const System & system, Values state)
{
  add_held_work(system, account_, state);
}

void Run::command(const System & system, Values state, Vector<const double> torque)
{
  add_work(system, state);
  stepper_->restart(system, false);
  std::copy_n(torque.data, system.tau.size, system.tau.begin());
}

void Run::begin_call(double size, Index steps, Index call)
{
  give_up();
  due_ = 0;
  reached_ = -std::numeric_limits<double>::infinity();
  left_ = std::max<Index>(steps, 0);
  call_ = call;
  report_.size = size;
}

Outcome Run::advance(const System & system, Values state, const OptionalVector & tau, Index steps)
{
  begin_call(limits_.step_size, steps, std::max<Index>(steps, 0));
  const Comparison found = compare(system.tau, limits_.usual, tau);
  if (found == Comparison::OTHER) {
    return Outcome::COMMAND;
  }
  if (found == Comparison::USUAL) {
    command(system, state, tau.numbers);
  }
  return make_until_outcome(system, state);
}

Outcome Run::make(const System & system, Values state, double size, Index steps, Index call)
{
  begin_call(size, steps, call);
  return make_until_outcome(system, state);
}

Outcome Run::resume(const System & system, Values state, bool goes_on)
{
  if (!goes_on) {
    return give_up();
  }
  if (std::exchange(leaves_out_, false) && !system.whole.empty()) {
    equations_between_ = std::min(2 * equations_between_, EQUATIONS_CHECK_EVERY);
  }
  if (handed_ > 0) {
    // From where it failed.
    const Values & numbers = system.whole.numbers;
    if (!system.whole.empty() && numbers[left_out::ASKED] == 1.0) {
      // Again from the same state, a part of the step was well, and the rest is not: if that ended it,
      // the step would be repeated for ever.
      numbers[left_out::LENIENT] = 1.0;
      numbers[left_out::STAYS_LENIENT] = time() == lenient_since_ ? 1.0 : 0.0;
      numbers[left_out::ASKED] = 0.0;
      lenient_since_ = time();
    }
    stepper_->go_on();
    const Outcome found = make_portion(system, state, handed_);
    if (found != Outcome::DONE) {
      return found;
    }
  }
  return make_until_outcome(system, state);
}

void Run::write_kept(bool of_cables, Values out)
{
  const Values kept = view(of_cables ? kept_by_cables_ : kept_);
  if (out.size != kept.size) {
    throw std::invalid_argument("a run: expected room for the state that is kept");
  }
  copy(kept, out);
}

void Run::write_finding(Values found) const
{
  const EnergyFinding & energy = report_.energy;
  found[finding::SHARE] = energy.worst;
  found[finding::LOST] = energy.worst_lost;
  found[finding::MOVED] = energy.worst_moved;
  found[finding::TIME] = energy.worst_time;
}

}  // namespace closedloop
