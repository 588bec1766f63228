// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "guarded_run.hpp"

#include <time.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "evaluation.hpp"
#include "loop_closure.hpp"
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

using namespace guard;  // NOLINT

// Checks, in this order; bits of DUE.
constexpr Index CABLES = 1, ENERGY = 2, EQUATIONS = 4, LOOPS = 8;

/// Store the state, the method's memory and the choice of coordinates.
void keep(const System & system, const GuardedRun & run, Values kept)
{
  double * next = std::copy(run.state.begin(), run.state.end(), kept.begin());
  if (run.stepper != nullptr) {
    run.stepper->store_memory(next);
    next += run.stepper->memory_length();
  }
  const Partition & partition = system.partition;
  next = std::copy(partition.order.begin(), partition.order.end(), next);
  std::copy(partition.record.begin(), partition.record.end(), next);
}

Index length_to_keep(const System & system, const GuardedRun & run)
{
  return run.state.size + (run.stepper != nullptr ? run.stepper->memory_length() : 0) +
         system.partition.order.size + system.partition.record.size;
}

bool fits(const System & system, const GuardedRun & run)
{
  const Index ns = system.ns(), nc = run.watch.windings.size;
  const auto is_place = [&](Index place) {return place > 0 && place < system.effects.data.size;};
  return (run.stepper == nullptr || run.stepper->fits(system)) && run.state.size == ns && run.before.size == ns &&
         run.account.roles.size == system.effects.states.size &&
         run.account.since.size == system.tau.size &&
         run.account.numbers.size == account::COLUMNS &&
         run.numbers.size == NUMBERS && run.counts.size == COUNTS &&
         run.kept.size == length_to_keep(system, run) &&
         (nc == 0 || run.kept_by_cables.size == run.kept.size) && run.windings.size == nc &&
         std::all_of(run.watch.windings.begin(), run.watch.windings.end(), is_place) &&
         run.counts[DUE] >= 0 && (nc > 0 || (run.counts[DUE] & CABLES) == 0) &&
         run.watch.first > 0 && run.watch.most > 0;
}

void require_fitting(const System & system, const GuardedRun & run)
{
  if (!fits(system, run)) {
    throw std::invalid_argument("a guarded run: arrays that do not fit the system");
  }
}

Values at(const GuardedRun & run, Index place) {return run.numbers.part(place, 5);}

Energies read(Values from) {return {from[0], from[1], from[2], from[3], from[4]};}

bool knows_start(const GuardedRun & run)
{
  return !std::isnan(run.account.numbers[account::REFERENCE]);
}

/// Of a run in which joints feel so much force, by size.
double energy_scale(const System & system, const GuardedRun & run, double felt)
{
  const double extent = run.watch.extent;
  const Values & gravity = system.model.gravity;
  const double weight = gravity.size == 2 ?
    std::hypot(gravity[0], gravity[1]) : std::hypot(gravity[0], gravity[1], gravity[2]);
  // With the energy of a rate: at rest without weight there is no other scale.
  return run.numbers[MASS] * (extent * weight + extent * extent) +
         std::max(extent, 1.0) * felt;
}

/// How far a cable is wound round a pulley [rad].
double winding(const System & system, const GuardedRun & run, Index k)
{
  const Values & data = system.effects.data;
  const Index place = run.watch.windings[k];
  return data[place] / std::abs(data[place - 1]);
}

/// Store good windings, of the evaluated state.
void accept_windings(const System & system, const GuardedRun & run, const Energies & balance)
{
  for (Index k = 0; k < run.windings.size; ++k) {
    run.windings[k] = winding(system, run, k);
  }
  keep(system, run, run.kept_by_cables);
  run.numbers[CABLE_TIME] = run.time();
  run.numbers[CABLE_RESIDUAL] = balance.residual;
  run.counts[CABLES_CHECKED] = 1;
}

/// Store a good balance.
void accept_balance(const GuardedRun & run, const Energies & balance)
{
  write(balance, at(run, CHECK));
  run.numbers[CHECK_TIME] = run.time();
  run.counts[CHECKED] = AT_BALANCE;
  if (run.counts[BEGUN] == 0) {
    write(balance, at(run, BEGIN));
    run.counts[BEGUN] = 1;
  }
}

/// Check the start of a run, or the state after a jump.
Pause begin(const System & system, const GuardedRun & run)
{
  const bool cables = run.watch.windings.size > 0 && run.counts[CABLES_CHECKED] == 0;
  if (run.counts[CHECKED] != NOT && !cables) {
    return Pause::NONE;
  }
  // A short run needs no check at the start.
  const bool at_start = !knows_start(run) && run.time() == 0.0;
  if (!knows_start(run) && (cables || !at_start)) {
    return Pause::START_ENERGY;
  }
  if (at_start) {
    keep(system, run, run.kept);
    run.numbers[CHECK_TIME] = 0.0;
    run.counts[CHECKED] = AT_STATE;
    return Pause::NONE;
  }
  const Energies balance = draw_balance(system, run.account, run.state);
  if (run.counts[CHECKED] == NOT) {
    keep(system, run, run.kept);
    accept_balance(run, balance);
  }
  if (cables) {
    accept_windings(system, run, balance);
  }
  return Pause::NONE;
}

Pause check_cables(const System & system, const GuardedRun & run)
{
  const Energies balance = draw_balance(system, run.account, run.state);
  for (Index k = 0; k < run.windings.size; ++k) {
    if (std::abs(winding(system, run, k) - run.windings[k]) > LEAP) {
      return Pause::CABLE_LEAPT;
    }
  }
  accept_windings(system, run, balance);
  return Pause::NONE;
}

/// Record the energy exchanged and the error of a balance, whose scale is given; return the
/// negligible part of it [J].
double record_balance(const GuardedRun & run, const Energies & present, double scale)
{
  if (run.counts[CHECKED] == AT_STATE) {
    const Values & numbers = run.account.numbers;
    write(
      {numbers[account::START_KINETIC], numbers[account::START_STORED], 0.0, 0.0, 0.0},
      at(run, CHECK));
    copy(at(run, CHECK), at(run, BEGIN));
    run.counts[CHECKED] = AT_BALANCE;
    run.counts[BEGUN] = 1;
  }
  // A step in which a motion begins may lose all of a tiny energy.
  const double little = ROUNDING * (present.kinetic + std::abs(present.stored)) +
    (run.counts[SINCE] < run.watch.first ? LITTLE : NOTHING) * scale;
  const Energies start = run.counts[BEGUN] != 0 ? read(at(run, BEGIN)) : present;
  record_loss(
    run.numbers, std::abs(present.residual - start.residual),
    present.kinetic + present.apart(start), little, run.time());
  return little;
}

/// Compare a balance with the latest good one, and accept it unless too much is lost.
Pause compare_balance(const GuardedRun & run, const Energies & present, double scale)
{
  const Values & numbers = run.numbers;
  write(present, at(run, PRESENT));
  const bool compares = run.counts[CHECKED] != NOT;
  const double little = record_balance(run, present, scale);
  run.counts[SINCE] = 0;
  if (compares) {
    const Energies before = read(at(run, CHECK));
    const double moving = before.kinetic + present.apart(before);
    const double lost = std::abs(present.residual - before.residual);
    numbers[LOST] = lost;
    numbers[MOVING] = moving;
    const double allowed = ENERGY_ERROR * moving + LITTLE * numbers[MOVED] + little;
    if (!(lost <= allowed) || numbers[WORST] > ENERGY_ERROR) {
      run.counts[FAILED] = 1;
      return Pause::ENERGY_LOST;
    }
  }
  accept_balance(run, present);
  return numbers[WORST] > ENERGY_WARN && run.counts[WARNED] == 0 ?
         Pause::INACCURATE : Pause::NONE;
}

Pause check_loops(const System & system, const GuardedRun & run)
{
  if (run.watch.regular && system.work.health[health::SINGULAR_COUNT] > 0.0) {
    return Pause::NOT_REGULAR;
  }
  double closure = 0.0;
  if (system.whole.empty()) {
    evaluate_with_poses(system, run.state);
    closure = largest(system.work.closure);
  } else {
    const AllEquations & all = system.whole;
    outward(all.model, system.q(run.state), system.qd(run.state), all.own);
    update(all.model, all.own, Responses::NONE);
    closure = largest(all.own.closure);
  }
  return closure <= run.watch.closure ? Pause::NONE : Pause::LOOPS_OPEN;
}

/// Make the first check that is due.
Pause check(const System & system, const GuardedRun & run)
{
  Index & due = run.counts[DUE];
  if ((due & CABLES) != 0) {
    due -= CABLES;
    return check_cables(system, run);
  }
  if ((due & ENERGY) != 0) {
    if (!knows_start(run)) {
      return Pause::START_ENERGY;
    }
    due -= ENERGY;
    return check_energy(system, run);
  }
  if ((due & EQUATIONS) != 0) {
    due -= EQUATIONS;
    return Pause::CHOICE;
  }
  due -= LOOPS;
  return check_loops(system, run);
}

/// Book steps that were made.
void book(const System & system, const GuardedRun & run, Index steps)
{
  const Indices & counts = run.counts;
  const Values & numbers = run.numbers;
  const double elapsed = static_cast<double>(steps) * numbers[SIZE];
  numbers[COST_TIME] += elapsed;
  numbers[COST_STEPS] += static_cast<double>(steps);
  counts[LEFT] -= steps;
  if (numbers[SIZE] == numbers[STEP_SIZE]) {
    counts[STEPS] += steps;
  } else {
    numbers[TIME_BASE] += elapsed;
  }
  if (counts[TO_SAMPLE] > 0) {
    counts[TO_SAMPLE] -= steps;
  }
  counts[SINCE] += steps;
  Index due = run.watch.windings.size > 0 ? CABLES : 0;
  if (counts[SINCE] >= counts[BETWEEN]) {
    counts[BETWEEN] =
      std::max(std::min(2 * counts[BETWEEN], run.watch.rarely), run.watch.first);
    due |= ENERGY;
  }
  if (run.watch.chooses) {
    counts[EQUATIONS_SINCE] += steps;
    if (counts[EQUATIONS_SINCE] >= counts[EQUATIONS_BETWEEN]) {
      counts[EQUATIONS_SINCE] = 0;
      if (system.whole.empty() && run.stepper != nullptr &&
        run.stepper->stabilisation() >= Stabilisation::PROJECTION) {
        due |= EQUATIONS;
      }
    }
  }
  counts[DUE] = due | (std::isinf(run.watch.closure) ? 0 : LOOPS);
}

/// CPU time of this thread [ns].
double thread_time()
{
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e9 * static_cast<double>(now.tv_sec) + static_cast<double>(now.tv_nsec);
}

/// Make steps, or find out why not.
Pause make_portion(const System & system, const GuardedRun & run, Index steps)
{
  const Indices & counts = run.counts;
  const Values & numbers = run.numbers;
  copy(run.state, run.before);
  if (run.stepper == nullptr) {
    counts[HANDED] = steps;
    return Pause::HAND_OVER;
  }
  const double size = numbers[SIZE];
  const bool whole = size == numbers[STEP_SIZE];
  const double origin = whole ? numbers[TIME_BASE] : run.time();
  const Index done = whole ? counts[STEPS] : 0;
  const double worked = run.watch.timed ? thread_time() : 0.0;
  const auto begin = std::chrono::steady_clock::now();
  const auto [status, elapsed] =
    run.stepper->advance(system, run.state, {origin, done, size, steps});
  numbers[COST_NANOSECONDS] += static_cast<double>(
    std::chrono::duration_cast<std::chrono::nanoseconds>(
      std::chrono::steady_clock::now() - begin).count());
  if (run.watch.timed) {
    numbers[COST_CPU_NANOSECONDS] += thread_time() - worked;
  }
  if (status == Status::DONE) {
    book(system, run, steps);
    return Pause::NONE;
  }
  if (status == Status::INTERRUPTED) {
    // Steps that count as not made.
    copy(run.before, run.state);
    run.stepper->restart(system, true);
  }
  counts[HANDED] = steps;
  counts[STATUS] = static_cast<Index>(status);
  numbers[ELAPSED] = elapsed;
  return Pause::FAILURE;
}

/// Make steps until all are made or the run pauses.
Pause make_steps_until_pause(const System & system, const GuardedRun & run)
{
  const Indices & counts = run.counts;
  while (true) {
    while (counts[DUE] != 0) {
      const Pause pause = check(system, run);
      if (pause != Pause::NONE) {
        return pause;
      }
    }
    if (counts[LEFT] <= 0) {
      // A check after a call, unless that would cost more than its few steps.
      if (counts[SINCE] == 0 || counts[CALL] < run.watch.call) {
        return Pause::NONE;
      }
      counts[DUE] = ENERGY;
      continue;
    }
    Pause pause = begin(system, run);
    if (pause != Pause::NONE) {
      return pause;
    }
    if (counts[TO_SAMPLE] == 0) {
      return Pause::SAMPLE;
    }
    Index portion = std::min(counts[LEFT], run.watch.most);
    if (!run.watch.whole) {
      portion = std::min(portion, counts[BETWEEN] - counts[SINCE]);
    }
    if (run.watch.chooses) {
      portion = std::min(portion, counts[EQUATIONS_BETWEEN] - counts[EQUATIONS_SINCE]);
    }
    if (counts[TO_SAMPLE] > 0) {
      portion = std::min(portion, counts[TO_SAMPLE]);
    }
    pause = make_portion(system, run, std::max<Index>(portion, 1));
    if (pause != Pause::NONE) {
      return pause;
    }
  }
}

void begin_call(const GuardedRun & run, Index steps)
{
  const Indices & counts = run.counts;
  counts[DUE] = counts[HANDED] = 0;
  counts[LEFT] = counts[CALL] = std::max<Index>(steps, 0);
  run.numbers[SIZE] = run.numbers[STEP_SIZE];
}

void let_act(const System & system, const GuardedRun & run, const double * torque)
{
  add_held_work(system, run.account, run.state);
  if (run.stepper != nullptr) {
    run.stepper->restart(system, false);
  }
  std::copy(torque, torque + system.tau.size, system.tau.begin());
}
}  // namespace

Pause advance_run(const System & system, const GuardedRun & run, const Given & tau, Index steps)
{
  require_fitting(system, run);
  begin_call(run, steps);
  const Comparison found = compare(system.tau, run.watch.usual, tau);
  if (found == Comparison::OTHER) {
    return Pause::COMMAND;
  }
  if (found == Comparison::USUAL) {
    let_act(system, run, tau.numbers.data);
  }
  return make_steps_until_pause(system, run);
}

Pause resume_run(const System & system, const GuardedRun & run)
{
  require_fitting(system, run);
  if (const Index handed = run.counts[HANDED]; handed > 0) {
    run.counts[HANDED] = 0;
    book(system, run, handed);
  }
  return make_steps_until_pause(system, run);
}

void record_loss(Values numbers, double lost, double moved, double rounding, double time)
{
  if (numbers.size != NUMBERS) {
    throw std::invalid_argument("record_loss: numbers of another length");
  }
  if (moved > numbers[MOVED]) {
    numbers[MOVED] = moved;
  }
  lost -= rounding;
  double share = lost > 0.0 && numbers[MOVED] > 0.0 ? lost / numbers[MOVED] : 0.0;
  if (!std::isfinite(lost)) {
    share = std::numeric_limits<double>::infinity();
  }
  if (!(share <= numbers[WORST])) {
    numbers[WORST] = share;
    numbers[WORST_TIME] = time;
    numbers[WORST_LOST] = lost;
    numbers[WORST_MOVED] = numbers[MOVED];
  }
}

void record_energy(const System & system, const GuardedRun & run, Values out)
{
  require_fitting(system, run);
  if (out.size != 5 || !knows_start(run)) {
    throw std::invalid_argument("record_energy: 5 numbers, of a run whose start is known");
  }
  const Energies present = draw_balance(system, run.account, run.state);
  record_balance(run, present, energy_scale(system, run, sum_of_sizes(system.applied)));
  write(present, out);
}

Pause check_energy(const System & system, const GuardedRun & run)
{
  require_fitting(system, run);
  if (!knows_start(run)) {
    return Pause::START_ENERGY;
  }
  const Energies present = draw_balance(system, run.account, run.state);
  const Pause found = compare_balance(
    run, present, energy_scale(system, run, sum_of_sizes(system.applied)));
  if (found != Pause::ENERGY_LOST) {
    keep(system, run, run.kept);
  }
  return found;
}

CopiedRun::CopiedRun(const GuardedRun & like)
: run_(like), stepper_(like.stepper->clone()), counts_(like.counts.begin(), like.counts.end())
{
  run_.stepper = stepper_.get();
  Values * const parts[] = {
    &run_.state, &run_.before, &run_.kept, &run_.kept_by_cables, &run_.windings, &run_.numbers,
    &run_.account.since, &run_.account.numbers};
  for (const Values * part : parts) {
    values_.insert(values_.end(), part->begin(), part->end());
  }
  double * next = values_.data();
  for (Values * part : parts) {
    part->data = next;
    next += part->size;
  }
  run_.counts.data = counts_.data();
}

void CopiedRun::begin(const System & system)
{
  require_fitting(system, run_);
  const std::vector<double> health(system.work.health.begin(), system.work.health.end());
  const Values & balances = run_.account.numbers, & numbers = run_.numbers;
  const Indices & counts = run_.counts;
  balances[account::REFERENCE] = 0.0;
  const Energies balance = draw_balance(system, run_.account, run_.state);
  balances[account::HELD_WORK] = 0.0;
  balances[account::REFERENCE] = balance.kinetic + balance.stored;
  balances[account::START_KINETIC] = balance.kinetic;
  balances[account::START_STORED] = balance.stored;
  // The run has no evaluation yet.
  std::copy(health.begin(), health.end(), system.work.health.begin());
  numbers[TIME_BASE] = 0.0;
  numbers.part(MOVED, LOST - MOVED).fill(0.0);
  for (const Index zero : {STEPS, DUE, HANDED, SINCE, EQUATIONS_SINCE, BEGUN, CABLES_CHECKED,
      WARNED, FAILED})
  {
    counts[zero] = 0;
  }
  counts[BETWEEN] = run_.watch.first;
  counts[TO_SAMPLE] = -1;
  counts[CHECKED] = AT_STATE;
}

void CopiedRun::command(const System & system, Values torque)
{
  if (!std::equal(torque.begin(), torque.end(), system.tau.begin())) {
    let_act(system, run_, torque.data);
  }
}

Status CopiedRun::advance(const System & system, Index steps)
{
  begin_call(run_, steps);
  Pause pause = make_steps_until_pause(system, run_);
  while (pause == Pause::INACCURATE) {
    run_.counts[WARNED] = 1;
    pause = make_steps_until_pause(system, run_);
  }
  return pause == Pause::NONE ? Status::DONE :
         pause == Pause::FAILURE ? static_cast<Status>(run_.counts[STATUS]) : Status::DOUBTFUL;
}

bool CopiedRun::keeps_energy(const System & system)
{
  const Pause pause = check_energy(system, run_);
  return pause == Pause::NONE || pause == Pause::INACCURATE;
}

bool CopiedRun::check_state(
  const System & system, Index steps, double work, const Stored * stored, bool at_energy)
{
  run_.counts[STEPS] = steps;
  run_.account.numbers[account::HELD_WORK] = work;
  if (at_energy && stored != nullptr) {
    const Energies present = balance_of(
      system, run_.account, run_.state, stored->kinetic, stored->potential);
    const Pause found = compare_balance(run_, present, energy_scale(system, run_, stored->felt));
    if (!(found == Pause::NONE || found == Pause::INACCURATE)) {
      return false;
    }
  } else if (at_energy && !keeps_energy(system)) {
    return false;
  }
  return std::isinf(run_.watch.closure) || check_loops(system, run_) == Pause::NONE;
}

void CopiedRun::report(Values found) const
{
  const Values & numbers = run_.numbers;
  found[finding::SHARE] = numbers[WORST];
  found[finding::LOST] = numbers[WORST_LOST];
  found[finding::MOVED] = numbers[WORST_MOVED];
  found[finding::TIME] = numbers[WORST_TIME];
}

}  // namespace closedloop
