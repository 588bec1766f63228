// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "switching.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "manifold.hpp"
#include "projection.hpp"

namespace closedloop
{

namespace
{
// The run's own error against the distance to its reference: the steps of a method of order 8 make
// it 30 times as small at best.
constexpr double CLOSER = 0.1;
// Share of the accuracy at which the tolerance is tightened, and again at ten times as much each
// time in a window; the factor; and the lower limit.
constexpr double TIGHTEN_AT = 0.3, TIGHTER = 0.1, FLOOR = 1e-13;
constexpr double WINDOW = 1.0, LONGEST_PAUSE = 8.0;
// Step size times fastest rate from which on stability may limit the explicit steps (it does at
// 6.1 along the negative real axis), and the share of that at which they would be stable again.
constexpr double STABILITY_LIMIT = 4.0, STABLE = 5.0;
// Such steps in a row before a trial, at first and at most; others in a row that end the count.
constexpr double FIRST_THRESHOLD = 15.0, MOST_THRESHOLD = 1000.0, NONSTIFF_STEPS = 6.0;
// Steps of a trial, and those at its start, small still, that do not count.
constexpr double TRIAL = 20.0, GROWING = 8.0;
constexpr double EXPLICIT_WORK = 12.0;
// Restarts after which DOPRI5 is tried again where its step did not last until the next one.
constexpr double SHORT_PATIENCE = 50.0;

// Local tolerance, of the accuracy asked for.
constexpr double SHARE = 1e-3;

double tolerance_for(double accuracy) {return std::max(SHARE * accuracy, FLOOR);}

/// Change to the other method.
void change(SwitchingControl & control, double stiff)
{
  control.stiff = stiff;
  control.stiff_count = control.nonstiff_count =
    control.trial_steps = 0.0;
}

void count_from_here(SwitchingControl & control)
{
  control.since_work = control.work;
  control.since_time = control.reached;
}

/// Work per time since the count began.
double work_rate(const SwitchingControl & control)
{
  return (control.work - control.since_work) /
         (control.reached - control.since_time);
}

/// Change to the stiff method where stability has limited the explicit steps for a while.
void consider_stiff(SwitchingControl & control)
{
  if (control.stiffness > STABILITY_LIMIT) {
    if (control.stiff_count == 0.0) {
      count_from_here(control);
    }
    control.stiff_count += 1.0;
    control.nonstiff_count = 0.0;
  } else {
    control.nonstiff_count += 1.0;
    if (control.nonstiff_count >= NONSTIFF_STEPS) {
      control.stiff_count = 0.0;
    }
  }
  if (control.stiff_count > control.stiff_threshold) {
    control.explicit_rate = work_rate(control);
    change(control, 1.0);
  }
}

/// Change back where the stiff method takes more work, or explicit steps would be stable.
void consider_explicit(SwitchingControl & control)
{
  control.trial_steps += 1.0;
  if (control.trial_steps == GROWING) {
    count_from_here(control);
  }
  if (control.trial_steps < TRIAL) {
    return;
  }
  const double rate = work_rate(control);
  if (control.explicit_rate > 0.0 && rate > control.explicit_rate) {
    // The trial has failed: wait longer before the next one.
    control.stiff_threshold =
      std::min(2.0 * control.stiff_threshold, MOST_THRESHOLD);
    change(control, 0.0);
  } else if (EXPLICIT_WORK * control.stiffness / STABLE < rate) {
    control.stiff_threshold = FIRST_THRESHOLD;
    change(control, 0.0);
    control.next_step =
      std::min(control.next_step, STABLE / control.stiffness);
  } else {
    control.trial_steps = GROWING;
    control.explicit_rate = 0.0;
    count_from_here(control);
  }
}

/// Choose the explicit method of the step that begins with new torques.
void choose_order(SwitchingControl & control)
{
  const double hold = control.hold;
  control.is_short = 0.0;
  if (!(hold > 0.0 && control.next_step >= hold) || control.stiff != 0.0) {
    return;
  }
  if (control.short_step < hold && control.short_wait > 0.0) {
    control.short_wait -= 1.0;
    return;
  }
  control.is_short = 1.0;
  control.short_wait = SHORT_PATIENCE;
}

/// Time until torques are expected to change again.
double time_held(const SwitchingControl & control)
{
  return control.restarted + control.hold - control.reached;
}

}  // namespace

SwitchingSteps::SwitchingSteps(const System & system, const MethodOptions & options)
: StepperOf(system, options.stabilisation), tableau_(options.tableau),
  short_tableau_(options.short_tableau), accuracy_(options.tolerance), unit_(2, system.ns()),
  stiff_(system.ns())
{
  const Index stages = options.tableau.a.rows;
  if (options.tableau.steps() == 0 || options.short_tableau.steps() == 0 ||
    options.short_tableau.a.rows > stages)
  {
    throw std::invalid_argument("the default method: tableaus that do not fit together");
  }
  for (Track * each : {&run_, &reference_}) {
    Track & track = *each;
    track.scale = OwnedTable(2, system.ns());
    track.scratch = OwnedTable(stages + scratch::FIRST_SLOPE, system.ns());
    track.stiff_scratch = OwnedTable(STIFF_ROWS, system.ns());
  }
  for (Index i = 0; i < system.nq(); ++i) {
    weight_.push_back(error_weight(system.manifold, i));
  }
  fill_scale(system, 1.0, unit_.view());
  rewind(system);
}

ExplicitStep SwitchingSteps::explicit_step(Track & track)
{
  return {track.control.is_short == 0.0 ? tableau_.view() : short_tableau_.view(), stabilisation(),
    track.control, track.scale.view(), track.scratch.view()};
}

/// Start at a state; the reference run continues from its own, if that is of the same time.
void SwitchingSteps::begin(double time, Values state)
{
  SwitchingControl & control = run_.control;
  explicit_step(run_).begin(time, state);
  choose_order(control);
  if (control.stiff_threshold == 0.0) {
    // The past has no bearing on this state.
    control.stiff_threshold = FIRST_THRESHOLD;
    control.is_short = control.short_step = 0.0;
    control.short_wait = 0.0;
    change(control, 0.0);
    monitor_.pause = WINDOW;
    monitor_.smallest = 0.0;
    open_window();
  } else if (monitor_.open == 1.0) {
    SwitchingControl & other = reference_.control;
    // The reference run restarts where it is within a step, which a restored run does not have, and
    // where both runs would make the same step.
    const bool within_step =
      std::abs(other.reached - time) > LEAST * std::max(std::abs(time), 1e-3);
    const double least = std::min(control.next_step, other.next_step);
    if (!within_step && !(control.hold > 0.0 && least >= control.hold)) {
      other.hold = control.hold;
      other.restarted = other.reached = time;
      other.step_size = 0.0;
    } else {
      monitor_.carried = monitor_.bound;
      set_reference_back();
    }
  }
}

void SwitchingSteps::open_window()
{
  monitor_.open = 1.0;
  monitor_.bound = monitor_.carried = 0.0;
  monitor_.next_bound = TIGHTEN_AT * monitor_.accuracy;
  set_reference_back();
}

/// Restart the reference run at the state of the run.
void SwitchingSteps::set_reference_back()
{
  SwitchingControl & control = run_.control, & other = reference_.control;
  copy(run_.after(), reference_.after());
  other.reached = control.reached;
  other.restarted = control.restarted;
  other.hold = control.hold;
  other.stiff = control.stiff;
  other.trial_steps = control.trial_steps;
  other.stiff_threshold = control.stiff_threshold;
  other.step_size = other.stiff_count = other.nonstiff_count =
    other.explicit_rate = 0.0;
  if (other.next_step == 0.0) {
    other.next_step = control.next_step;
  }
}

/// Whether the reference run would make the step that the run has just made: both were in one
/// state, and neither tolerance, but the time for which torques are held, or an event before its
/// end, limits their steps.
bool SwitchingSteps::same_for_reference()
{
  SwitchingControl & control = run_.control, & other = reference_.control;
  const double start = control.step_start;
  const double rest = control.restarted + control.hold - start;
  if (control.stiff != 0.0 || other.stiff != 0.0 || !(rest > 0.0) ||
    control.tried != rest || !(other.next_step >= rest) || other.reached != start ||
    other.restarted != control.restarted ||
    other.hold != control.hold)
  {
    return false;
  }
  const Values before = run_.scratch[scratch::BEFORE];
  return std::equal(before.begin(), before.end(), reference_.after().begin());
}

/// Copy the same step to the reference run, without evaluations. Its distance does not measure the
/// error then: the bound grows by the step's own estimate.
void SwitchingSteps::take_same()
{
  SwitchingControl & control = run_.control, & other = reference_.control;
  copy(run_.after(), reference_.after());
  other.reached = control.reached;
  other.next_step = std::max(other.next_step, control.next_step);
  other.step_size = NOTHING_BETWEEN;
  monitor_.carried += control.error * monitor_.tolerance;
}

/// Distance of the reference run's coordinates from those of the run.
double SwitchingSteps::distance(const System & system)
{
  const Values out = reference_.scratch[scratch::OUT], after = run_.after();
  const Values weight = view(weight_);
  double most = 0.0;
  explicit_step(reference_).interpolate_at(system, run_.control.reached, out);
  for (Index i = 0; i < weight.size; ++i) {
    most = std::max(most, weight[i] * std::abs(out[i] - after[i]));
  }
  return most;
}

/// Tighten the tolerance of both runs.
void SwitchingSteps::tighten()
{
  const double factor = std::max(TIGHTER, FLOOR / monitor_.tolerance);
  monitor_.tolerance *= factor;
  monitor_.next_bound *= 10.0;
  monitor_.tightened += 1.0;
  for (Track * track : {&run_, &reference_}) {
    for (double & each : track->scale.all()) {
      each *= factor;
    }
  }
  run_.control.next_step *= 0.5;
  monitor_.pause = WINDOW;
}

/// Compare the run with its reference, and tighten the tolerance where it must be; `lost`: the
/// reference run could not follow.
void SwitchingSteps::update_monitor(const System & system, bool lost)
{
  SwitchingControl & control = run_.control;
  const double now = control.reached, next = control.next_step;
  if (monitor_.open == 0.0) {
    // Much smaller steps than were seen while it was open: it is another motion now.
    if (now >= monitor_.until || (
        control.step_size > 0.0 && next < 0.25 * monitor_.smallest))
    {
      monitor_.until = now + WINDOW;
      monitor_.smallest = next;
      open_window();
    }
    return;
  }
  if (monitor_.smallest == 0.0) {
    monitor_.until = now + WINDOW;
    monitor_.smallest = next;
  }
  monitor_.smallest = std::min(monitor_.smallest, next);
  double bound = std::numeric_limits<double>::infinity();
  if (!lost) {
    bound = monitor_.carried + CLOSER * distance(system);
  }
  if (!lost || monitor_.tolerance <= FLOOR) {
    monitor_.bound = std::max(monitor_.bound, bound);
    monitor_.largest_bound =
      std::max(monitor_.largest_bound, monitor_.bound);
  }
  if (bound > monitor_.next_bound && monitor_.tolerance > FLOOR) {
    tighten();
  }
  if (lost) {
    set_reference_back();
  }
  if (now >= monitor_.until) {
    monitor_.open = 0.0;
    monitor_.until = now + monitor_.pause;
    monitor_.pause = std::min(2.0 * monitor_.pause, LONGEST_PAUSE);
  }
}

/// Make one step of a run by its present explicit method.
Status SwitchingSteps::make_explicit_step(
  const System & system, Track & track, Interrupt & interrupt)
{
  SwitchingControl & control = track.control;
  if (control.is_short != 0.0 && control.step_size != 0.0) {
    // Torques are held for longer than expected, or something else ended its step.
    control.is_short = 0.0;
    control.step_size = NOTHING_BETWEEN;
  }
  if (control.is_short == 0.0) {
    return explicit_step(track).make(system, interrupt);
  }
  const double next = control.next_step;
  control.next_step = time_held(control);
  const Status status = explicit_step(track).make(system, interrupt);
  control.short_step = control.next_step;
  control.next_step = std::max(next, control.next_step);
  return status;
}

/// Make one step of a run by its present method.
Status SwitchingSteps::make_step(
  const System & system, Track & track, double limit, Interrupt & interrupt)
{
  SwitchingControl & control = track.control;
  if (control.stiff == 0.0) {
    const Status status = make_explicit_step(system, track, interrupt);
    if (status == Status::DONE) {
      consider_stiff(control);
    } else if (status != Status::INTERRUPTED && status != Status::POOR_EQUATIONS) {
      // Where one method fails, the other may not.
      control.explicit_rate = 0.0;
      change(control, 1.0);
      return Status::DONE;
    }
    return status;
  }
  const StiffStep stiff{
    stabilisation(), control, track.scale.view(), stiff_.with(track.stiff_scratch.view())};
  const Status status = stiff.make(system, track.after(), limit, interrupt);
  if (status == Status::DONE) {
    control.step_size = NOTHING_BETWEEN;
    consider_explicit(control);
  }
  return status;
}

// There is one place for the steps of both runs: whichever is behind makes the next one.
Advance SwitchingSteps::advance(const System & system, Values state, const Grid & grid)
{
  SwitchingControl & control = run_.control, & other = reference_.control;
  Interrupt interrupt(system.interrupted, system.nv());
  if (control.step_size == 0.0) {
    begin(grid.start(), state);
  }
  const double target = grid.target();
  const auto work = [&]() {return control.work + other.work;};
  WorkLimit work_limit(grid, system.work.health, work(), 2.0 * MOST_EVALUATIONS);
  Status status = Status::DONE;
  bool follows = false;
  while (status == Status::DONE && (follows || is_before(control.reached, target))) {
    Track & track = follows ? reference_ : run_;
    double limit = control.reached;
    if (!follows) {
      // A stiff step ends on the grid, where the state may be output.
      const double passed = std::floor((control.reached - grid.origin) / grid.step_size + 1e-6);
      limit = grid.origin + (passed + 1.0) * grid.step_size;
    }
    status = make_step(system, track, limit, interrupt);
    if (status == Status::POOR_EQUATIONS) {
      track.control.step_size = NOTHING_BETWEEN;
    }
    if (!follows && status == Status::DONE && monitor_.open == 1.0 && same_for_reference()) {
      take_same();
    }
    const bool lost = follows && status != Status::DONE && status != Status::INTERRUPTED &&
      status != Status::POOR_EQUATIONS;
    follows = monitor_.open == 1.0 && !lost && is_before(other.reached, control.reached);
    if (lost) {
      status = Status::DONE;
    } else if (status == Status::DONE &&
      work_limit.exceeded(follows ? other.reached : control.reached, work()))
    {
      status = Status::TOO_MUCH_WORK;
    }
    if (!follows && status == Status::DONE) {
      update_monitor(system, lost);
    }
  }
  if (status != Status::DONE) {
    copy(run_.after(), state);
    // With other equations both continue.
    if (status != Status::POOR_EQUATIONS) {
      control.step_size = 0.0;
    }
    return {status, control.reached - grid.start()};
  }
  explicit_step(run_).interpolate_at(system, target, state);
  if (is_before(target, control.reached) && !stabilise_between(system, stabilisation(), state)) {
    return {Status::OPEN_LOOP, control.reached - grid.start()};
  }
  return {Status::DONE, static_cast<double>(grid.steps) * grid.step_size};
}

void SwitchingSteps::go_on()
{
  if (run_.control.step_size == 0.0) {
    run_.control.step_size = NOTHING_BETWEEN;
  }
}

void SwitchingSteps::restart(const System & system, bool moved)
{
  run_.control.step_size = 0.0;
  if (moved) {
    run_.control.stiff_threshold = 0.0;
  }
  follow_effects(system, 1.0, unit_.view());
  set_scale();
}

void SwitchingSteps::set_scale()
{
  for (Track * track : {&run_, &reference_}) {
    const double tolerance = (track == &run_ ? 1.0 : LOOSER) * monitor_.tolerance;
    const Values unit = unit_.all(), scale = track->scale.all();
    for (Index i = 0; i < scale.size; ++i) {
      scale[i] = unit[i] * tolerance;
    }
  }
}

void SwitchingSteps::rewind(const System & system)
{
  for (Track * track : {&run_, &reference_}) {
    track->control = {};
    track->stiff_scratch.all().fill(0.0);
  }
  monitor_ = {};
  monitor_.accuracy = accuracy_;
  monitor_.tolerance = tolerance_for(accuracy_);
  restart(system, false);
}

void SwitchingSteps::aim(double accuracy)
{
  if (!(accuracy > 0.0 && std::isfinite(accuracy))) {
    throw std::invalid_argument("accuracy: expected a positive number");
  }
  const double tolerance = tolerance_for(accuracy);
  // Steps of order eight that are as good as the present ones.
  const double factor = std::pow(tolerance / monitor_.tolerance, 1.0 / 8.0);
  run_.control.next_step *= factor;
  reference_.control.next_step *= factor;
  monitor_.accuracy = accuracy;
  monitor_.tolerance = tolerance;
  monitor_.open = 0.0;
  monitor_.pause = WINDOW;
  monitor_.until = run_.control.reached;
  set_scale();
}

Index SwitchingSteps::memory_length() const
{
  return (2 * sizeof(SwitchingControl) + sizeof(ErrorMonitor)) / sizeof(double) +
         unit_.columns();
}

void SwitchingSteps::store_memory(Values to) const
{
  double * next = store(monitor_, store(reference_.control, store(run_.control, to.data)));
  const Values after = reference_.after();
  std::copy(after.begin(), after.end(), next);
}

void SwitchingSteps::recall_memory(Values from)
{
  const double * next =
    recall(recall(recall(from.data, run_.control), reference_.control), monitor_);
  const Values after = reference_.after();
  std::copy_n(next, after.size, after.begin());
}

StepReport SwitchingSteps::report() const
{
  StepReport found = report_of(run_.control, monitor_.tolerance);
  found.reference_work = reference_.control.work;
  found.accuracy = monitor_.accuracy;
  found.tolerance = monitor_.tolerance;
  found.largest_bound = monitor_.largest_bound;
  found.bound = monitor_.bound;
  found.stiff = run_.control.stiff != 0.0;
  found.is_short = run_.control.is_short != 0.0;
  return found;
}

}  // namespace closedloop
