// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "switching.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "projection.hpp"

namespace closedloop
{

namespace
{
// Rows of all arrays of Runs.
enum : Index {RUN, REFERENCE};
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

/// Change to the other method.
void change(Values control, double stiff)
{
  control[switching::STIFF] = stiff;
  control[switching::STIFF_COUNT] = control[switching::NONSTIFF_COUNT] =
    control[switching::TRIAL_STEPS] = 0.0;
}

void count_from_here(Values control)
{
  control[switching::SINCE_WORK] = control[control::WORK];
  control[switching::SINCE_TIME] = control[control::REACHED];
}

/// Work per time since the count began.
double work_rate(Values control)
{
  return (control[control::WORK] - control[switching::SINCE_WORK]) /
         (control[control::REACHED] - control[switching::SINCE_TIME]);
}

/// Change to the stiff method where stability has limited the explicit steps for a while.
void consider_stiff(Values control)
{
  if (control[control::STIFFNESS] > STABILITY_LIMIT) {
    if (control[switching::STIFF_COUNT] == 0.0) {
      count_from_here(control);
    }
    control[switching::STIFF_COUNT] += 1.0;
    control[switching::NONSTIFF_COUNT] = 0.0;
  } else {
    control[switching::NONSTIFF_COUNT] += 1.0;
    if (control[switching::NONSTIFF_COUNT] >= NONSTIFF_STEPS) {
      control[switching::STIFF_COUNT] = 0.0;
    }
  }
  if (control[switching::STIFF_COUNT] > control[switching::STIFF_THRESHOLD]) {
    control[switching::EXPLICIT_RATE] = work_rate(control);
    change(control, 1.0);
  }
}

/// Change back where the stiff method takes more work, or explicit steps would be stable.
void consider_explicit(Values control)
{
  control[switching::TRIAL_STEPS] += 1.0;
  if (control[switching::TRIAL_STEPS] == GROWING) {
    count_from_here(control);
  }
  if (control[switching::TRIAL_STEPS] < TRIAL) {
    return;
  }
  const double rate = work_rate(control);
  if (control[switching::EXPLICIT_RATE] > 0.0 && rate > control[switching::EXPLICIT_RATE]) {
    // The trial has failed: wait longer before the next one.
    control[switching::STIFF_THRESHOLD] =
      std::min(2.0 * control[switching::STIFF_THRESHOLD], MOST_THRESHOLD);
    change(control, 0.0);
  } else if (EXPLICIT_WORK * control[control::STIFFNESS] / STABLE < rate) {
    control[switching::STIFF_THRESHOLD] = FIRST_THRESHOLD;
    change(control, 0.0);
    control[control::NEXT_STEP] =
      std::min(control[control::NEXT_STEP], STABLE / control[control::STIFFNESS]);
  } else {
    control[switching::TRIAL_STEPS] = GROWING;
    control[switching::EXPLICIT_RATE] = 0.0;
    count_from_here(control);
  }
}

/// Choose the explicit method of the step that begins with new torques.
void choose_order(Values control)
{
  const double hold = control[control::HOLD];
  control[switching::SHORT] = 0.0;
  if (!(hold > 0.0 && control[control::NEXT_STEP] >= hold) || control[switching::STIFF] != 0.0) {
    return;
  }
  if (control[switching::SHORT_STEP] < hold && control[switching::SHORT_WAIT] > 0.0) {
    control[switching::SHORT_WAIT] -= 1.0;
    return;
  }
  control[switching::SHORT] = 1.0;
  control[switching::SHORT_WAIT] = SHORT_PATIENCE;
}

/// Time until torques are expected to change again.
double time_held(Values control)
{
  return control[control::RESTARTED] + control[control::HOLD] - control[control::REACHED];
}

/// A run, its reference run, and the monitor of the error.
class Pair
{
public:
  Pair(
    const System & system, const Tableau & tableau, Stabilisation stabilisation, const Runs & runs)
  : system_(system), tableau_(tableau), stabilisation_(stabilisation), runs_(runs),
    interrupt_(system.interrupted, system.nv())
  {
  }

  Status advance(Values state, const Grid & grid);

private:
  ExplicitRun explicit_run(Index which) const
  {
    const Values control = runs_.control[which];
    return {control[switching::SHORT] == 0.0 ? tableau_ : runs_.short_tableau, stabilisation_,
      control, runs_.scale[which], runs_.scratch[which]};
  }
  Status explicit_step(Index which);
  Status make_step(Index which, double limit);
  void begin(double time, Values state);
  void open_window();
  void set_reference_back();
  bool same_for_reference() const;
  void take_same();
  void update_monitor(bool lost);
  void tighten();
  double distance() const;

  const System & system_;
  const Tableau & tableau_;
  Stabilisation stabilisation_;
  const Runs & runs_;
  Interrupt interrupt_;
};

/// Start at a state; the reference run continues from its own, if that is of the same time.
void Pair::begin(double time, Values state)
{
  const Values control = runs_.control[RUN], & monitor = runs_.monitor;
  explicit_run(RUN).begin(time, state);
  choose_order(control);
  if (control[switching::STIFF_THRESHOLD] == 0.0) {
    // The past has no bearing on this state.
    control[switching::STIFF_THRESHOLD] = FIRST_THRESHOLD;
    control[switching::SHORT] = control[switching::SHORT_STEP] = 0.0;
    control[switching::SHORT_WAIT] = 0.0;
    change(control, 0.0);
    monitor[monitor::PAUSE] = WINDOW;
    monitor[monitor::SMALLEST] = 0.0;
    open_window();
  } else if (monitor[monitor::OPEN] == 1.0) {
    const Values other = runs_.control[REFERENCE];
    // The reference run restarts where it is within a step, which a restored run does not have, and
    // where both runs would make the same step.
    const bool within_step =
      std::abs(other[control::REACHED] - time) > LEAST * std::max(std::abs(time), 1e-3);
    const double least = std::min(control[control::NEXT_STEP], other[control::NEXT_STEP]);
    if (!within_step && !(control[control::HOLD] > 0.0 && least >= control[control::HOLD])) {
      other[control::HOLD] = control[control::HOLD];
      other[control::RESTARTED] = other[control::REACHED] = time;
      other[control::STEP_SIZE] = 0.0;
    } else {
      monitor[monitor::CARRIED] = monitor[monitor::BOUND];
      set_reference_back();
    }
  }
}

void Pair::open_window()
{
  const Values & monitor = runs_.monitor;
  monitor[monitor::OPEN] = 1.0;
  monitor[monitor::BOUND] = monitor[monitor::CARRIED] = 0.0;
  monitor[monitor::NEXT_BOUND] = TIGHTEN_AT * monitor[monitor::ACCURACY];
  set_reference_back();
}

/// Restart the reference run at the state of the run.
void Pair::set_reference_back()
{
  const Values control = runs_.control[RUN], other = runs_.control[REFERENCE];
  copy(runs_.scratch[RUN][scratch::AFTER], runs_.scratch[REFERENCE][scratch::AFTER]);
  for (Index column : {
      static_cast<Index>(control::REACHED), static_cast<Index>(control::RESTARTED),
      static_cast<Index>(control::HOLD), static_cast<Index>(switching::STIFF),
      static_cast<Index>(switching::TRIAL_STEPS),
      static_cast<Index>(switching::STIFF_THRESHOLD)})
  {
    other[column] = control[column];
  }
  other[control::STEP_SIZE] = other[switching::STIFF_COUNT] = other[switching::NONSTIFF_COUNT] =
    other[switching::EXPLICIT_RATE] = 0.0;
  if (other[control::NEXT_STEP] == 0.0) {
    other[control::NEXT_STEP] = control[control::NEXT_STEP];
  }
}

/// Whether the reference run would make the step that the run has just made: both were in one
/// state, and neither tolerance, but the time for which torques are held, limits their steps.
bool Pair::same_for_reference() const
{
  const Values control = runs_.control[RUN], other = runs_.control[REFERENCE];
  const double start = control[control::STEP_START], size = control[control::STEP_SIZE];
  const double rest = control[control::RESTARTED] + control[control::HOLD] - start;
  if (control[switching::STIFF] != 0.0 || other[switching::STIFF] != 0.0 ||
    size != rest || !(other[control::NEXT_STEP] >= rest) || other[control::REACHED] != start ||
    other[control::RESTARTED] != control[control::RESTARTED] ||
    other[control::HOLD] != control[control::HOLD])
  {
    return false;
  }
  const Values before = runs_.scratch[RUN][scratch::BEFORE];
  return std::equal(before.begin(), before.end(), runs_.scratch[REFERENCE][scratch::AFTER].begin());
}

/// Copy the same step to the reference run, without evaluations. Its distance does not measure the
/// error then: the bound grows by the step's own estimate.
void Pair::take_same()
{
  const Values control = runs_.control[RUN], other = runs_.control[REFERENCE];
  const Values & monitor = runs_.monitor;
  copy(runs_.scratch[RUN][scratch::AFTER], runs_.scratch[REFERENCE][scratch::AFTER]);
  other[control::REACHED] = control[control::REACHED];
  other[control::NEXT_STEP] = std::max(other[control::NEXT_STEP], control[control::NEXT_STEP]);
  other[control::STEP_SIZE] = NOTHING_BETWEEN;
  monitor[monitor::CARRIED] += control[control::ERROR] * monitor[monitor::TOLERANCE];
}

/// Distance of the reference run's coordinates from those of the run.
double Pair::distance() const
{
  const Table reference = runs_.scratch[REFERENCE];
  const Values out = reference[scratch::OUT], after = runs_.scratch[RUN][scratch::AFTER];
  double most = 0.0;
  explicit_run(REFERENCE).interpolate_at(system_, runs_.control(RUN, control::REACHED), out);
  for (Index i = 0; i < runs_.weight.size; ++i) {
    most = std::max(most, runs_.weight[i] * std::abs(out[i] - after[i]));
  }
  return most;
}

/// Tighten the tolerance of both runs.
void Pair::tighten()
{
  const Values & monitor = runs_.monitor;
  const double factor = std::max(TIGHTER, FLOOR / monitor[monitor::TOLERANCE]);
  monitor[monitor::TOLERANCE] *= factor;
  monitor[monitor::NEXT_BOUND] *= 10.0;
  monitor[monitor::TIGHTENED] += 1.0;
  for (Index which : {RUN, REFERENCE}) {
    for (double & each : runs_.scale[which].all()) {
      each *= factor;
    }
  }
  runs_.control(RUN, control::NEXT_STEP) *= 0.5;
  monitor[monitor::PAUSE] = WINDOW;
}

/// Compare the run with its reference, and tighten the tolerance where it must be; `lost`: the
/// reference run could not follow.
void Pair::update_monitor(bool lost)
{
  const Values control = runs_.control[RUN], & monitor = runs_.monitor;
  const double now = control[control::REACHED], next = control[control::NEXT_STEP];
  if (monitor[monitor::OPEN] == 0.0) {
    // Much smaller steps than were seen while it was open: it is another motion now.
    if (now >= monitor[monitor::UNTIL] || (
        control[control::STEP_SIZE] > 0.0 && next < 0.25 * monitor[monitor::SMALLEST]))
    {
      monitor[monitor::UNTIL] = now + WINDOW;
      monitor[monitor::SMALLEST] = next;
      open_window();
    }
    return;
  }
  if (monitor[monitor::SMALLEST] == 0.0) {
    monitor[monitor::UNTIL] = now + WINDOW;
    monitor[monitor::SMALLEST] = next;
  }
  monitor[monitor::SMALLEST] = std::min(monitor[monitor::SMALLEST], next);
  double bound = std::numeric_limits<double>::infinity();
  if (!lost) {
    bound = monitor[monitor::CARRIED] + CLOSER * distance();
  }
  if (!lost || monitor[monitor::TOLERANCE] <= FLOOR) {
    monitor[monitor::BOUND] = std::max(monitor[monitor::BOUND], bound);
    monitor[monitor::LARGEST_BOUND] =
      std::max(monitor[monitor::LARGEST_BOUND], monitor[monitor::BOUND]);
  }
  if (bound > monitor[monitor::NEXT_BOUND] && monitor[monitor::TOLERANCE] > FLOOR) {
    tighten();
  }
  if (lost) {
    set_reference_back();
  }
  if (now >= monitor[monitor::UNTIL]) {
    monitor[monitor::OPEN] = 0.0;
    monitor[monitor::UNTIL] = now + monitor[monitor::PAUSE];
    monitor[monitor::PAUSE] = std::min(2.0 * monitor[monitor::PAUSE], LONGEST_PAUSE);
  }
}

/// Make one step of a run by its present explicit method.
Status Pair::explicit_step(Index which)
{
  const Values control = runs_.control[which];
  if (control[switching::SHORT] != 0.0 && control[control::STEP_SIZE] != 0.0) {
    // Torques are held for longer than expected, or something else ended its step.
    control[switching::SHORT] = 0.0;
    control[control::STEP_SIZE] = NOTHING_BETWEEN;
  }
  if (control[switching::SHORT] == 0.0) {
    return explicit_run(which).accepted_step(system_, interrupt_);
  }
  const double next = control[control::NEXT_STEP];
  control[control::NEXT_STEP] = time_held(control);
  const Status status = explicit_run(which).accepted_step(system_, interrupt_);
  control[switching::SHORT_STEP] = control[control::NEXT_STEP];
  control[control::NEXT_STEP] = std::max(next, control[control::NEXT_STEP]);
  return status;
}

/// Make one step of a run by its present method.
Status Pair::make_step(Index which, double limit)
{
  const Values control = runs_.control[which];
  if (control[switching::STIFF] == 0.0) {
    const Status status = explicit_step(which);
    if (status == Status::DONE) {
      consider_stiff(control);
    } else if (status != Status::INTERRUPTED && status != Status::POOR_EQUATIONS) {
      // Where one method fails, the other may not.
      control[switching::EXPLICIT_RATE] = 0.0;
      change(control, 1.0);
      return Status::DONE;
    }
    return status;
  }
  const StiffRun stiff{
    stabilisation_, control, runs_.scale[which], runs_.matrix, runs_.pivots,
    runs_.stiff_scratch[which]};
  const Status status = stiff.accepted_step(
    system_, runs_.scratch[which][scratch::AFTER], limit, interrupt_);
  if (status == Status::DONE) {
    control[control::STEP_SIZE] = NOTHING_BETWEEN;
    consider_explicit(control);
  }
  return status;
}

// There is one place for the steps of both runs: whichever is behind makes the next one.
Status Pair::advance(Values state, const Grid & grid)
{
  const Values control = runs_.control[RUN], other = runs_.control[REFERENCE];
  if (control[control::STEP_SIZE] == 0.0) {
    begin(grid.start(), state);
  }
  const double target = grid.target();
  const auto work = [&]() {return control[control::WORK] + other[control::WORK];};
  WorkLimit work_limit(grid, system_.work.health, work(), 2.0 * MOST_EVALUATIONS);
  Status status = Status::DONE;
  bool follows = false;
  while (status == Status::DONE && (follows || is_before(control[control::REACHED], target))) {
    const Index which = follows ? REFERENCE : RUN;
    double limit = control[control::REACHED];
    if (!follows) {
      // A stiff step ends on the grid, where the state may be output.
      const double passed =
        std::floor((control[control::REACHED] - grid.origin) / grid.step_size + 1e-6);
      limit = grid.origin + (passed + 1.0) * grid.step_size;
    }
    status = make_step(which, limit);
    if (status == Status::POOR_EQUATIONS) {
      runs_.control[which][control::STEP_SIZE] = NOTHING_BETWEEN;
    }
    if (which == RUN && status == Status::DONE && runs_.monitor[monitor::OPEN] == 1.0 &&
      same_for_reference())
    {
      take_same();
    }
    const bool lost =
      which == REFERENCE && status != Status::DONE && status != Status::INTERRUPTED &&
      status != Status::POOR_EQUATIONS;
    follows = runs_.monitor[monitor::OPEN] == 1.0 && !lost && is_before(
      other[control::REACHED], control[control::REACHED]);
    if (lost) {
      status = Status::DONE;
    } else if (status == Status::DONE && work_limit.exceeded(
        follows ? other[control::REACHED] : control[control::REACHED], work()))
    {
      status = Status::TOO_MUCH_WORK;
    }
    if (!follows && status == Status::DONE) {
      update_monitor(lost);
    }
  }
  if (status != Status::DONE) {
    copy(runs_.scratch[RUN][scratch::AFTER], state);
    // With other equations both continue.
    if (status != Status::POOR_EQUATIONS) {
      control[control::STEP_SIZE] = 0.0;
    }
    return status;
  }
  explicit_run(RUN).interpolate_at(system_, target, state);
  if (is_before(target, control[control::REACHED]) &&
    !stabilise_between(system_, stabilisation_, state))
  {
    return Status::OPEN_LOOP;
  }
  return Status::DONE;
}
}  // namespace

Status advance_switching(
  const System & system, const Tableau & tableau, Stabilisation stabilisation, const Runs & runs,
  Values state, double origin, Index done, double step_size, Index steps)
{
  return Pair(system, tableau, stabilisation, runs).advance(
    state, {origin, done, step_size, steps});
}

}  // namespace closedloop
