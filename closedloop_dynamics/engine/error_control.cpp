// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "error_control.hpp"

#include <algorithm>
#include <stdexcept>

#include "contact_events.hpp"
#include "evaluation.hpp"
#include "left_out.hpp"
#include "manifold.hpp"
#include "projection.hpp"
#include "stick_slip.hpp"
#include "static_friction.hpp"
#include "time_events.hpp"

namespace closedloop
{

namespace
{
// Hairer's choices: change the step gently.
constexpr double LARGEST_GROWTH = 6.0, LARGEST_CUT = 0.2;
// Smaller errors of the step before do not show a trend, and dense output is as good as the step.
constexpr double SIGNIFICANT = 1e-2;
// Guesses of the first step, each this many times the one before.
constexpr int GUESSES = 4;
constexpr double FARTHER = 100.0;

/// What a mean over the numbers of a state is divided by; there are none where all is fixed.
double number_of(Values state)
{
  return static_cast<double>(std::max<Index>(state.size, 1));
}

/// Error of a step relative to the tolerance (1: just accepted). Hairer, Norsett and Wanner (1993),
/// section II.10: a coarser estimate, where the method has one, keeps the finer from being fooled.
double error_norm(
  const Tableau & tableau, double step_size, Table slopes, Values state, Values out, Table scale)
{
  double fine = 0.0, coarse = 0.0;
  for (Index i = 0; i < state.size; ++i) {
    double first = 0.0, second = 0.0;
    for (Index k = 0; k < tableau.error.columns; ++k) {
      first += tableau.error(0, k) * slopes(k, i);
      second += tableau.error(1, k) * slopes(k, i);
    }
    const double weight =
      1.0 / (scale(0, i) + scale(1, i) * std::max(std::abs(state[i]), std::abs(out[i])));
    fine += (first * weight) * (first * weight);
    coarse += (second * weight) * (second * weight);
  }
  const double count = number_of(state);
  if (coarse > 0.0) {
    return step_size * fine / std::sqrt((fine + 0.01 * coarse) * count);
  }
  return step_size * std::sqrt(fine / count);
}

/// Guess the size of the first step [s] (Hairer, Norsett and Wanner 1993, section II.4). Where
/// their guess is cut short, as for a mechanism that starts at rest with all coordinates zero,
/// another is made from there: an evaluation costs less than small steps do.
double first_step(
  const System & system, const Tableau & tableau, Values state, Table slopes, Table scale,
  Values stage)
{
  double size = 0.0, slope = 0.0;
  const Index count = state.size;
  const auto weight = [&](Index i) {
      return 1.0 / (scale(0, i) + scale(1, i) * std::abs(state[i]));
    };
  for (Index i = 0; i < count; ++i) {
    const double one = state[i] * weight(i), other = slopes(0, i) * weight(i);
    size += one * one;
    slope += other * other;
  }
  size = std::sqrt(size / number_of(state));
  slope = std::sqrt(slope / number_of(state));
  double guess = size < 1e-5 || slope < 1e-5 ? 1e-6 : 0.01 * size / slope;
  for (int n = 0; n < GUESSES; ++n) {
    for (Index i = 0; i < count; ++i) {
      stage[i] = state[i] + guess * slopes(0, i);
    }
    derivative(system, stage, slopes[1]);
    double second = 0.0;
    for (Index i = 0; i < count; ++i) {
      const double change = (slopes(1, i) - slopes(0, i)) * weight(i);
      second += change * change;
    }
    const double steepest =
      std::max(slope, std::sqrt(second / number_of(state)) / guess);
    if (steepest <= 1e-15) {
      return std::max(1e-6, guess * 1e-3);
    }
    const double best =
      std::pow(0.01 / steepest, 1.0 / static_cast<double>(tableau.error_order + 1));
    guess *= FARTHER;
    if (!(best > guess)) {
      return std::min(guess, best);
    }
  }
  return guess;
}

/// The part of a step after which a joint at rest breaks away [s]; zero where its load is too much only
/// in between. `state_at(share)` returns a state between.
template<class StateAt>
double locate_breakaway(
  const System & system, const HeldJoints & held, Values out, double size, StateAt && state_at)
{
  const auto margin = [&](Values state) {
      evaluate_for(system, state, Outputs::MOTION);
      return BREAKAWAY - held.load();
    };
  const double end = margin(out);
  return !(end < -NEAR_BREAKAWAY) ? 0.0 : first_zero(
    size, BREAKAWAY - held.load_at_start(), end, NEAR_BREAKAWAY,
    [&](double part) {return margin(state_at(part / size));});
}

/// Evaluate the slopes that only dense output needs.
void extend_slopes(
  const System & system, const Tableau & tableau, Values state, double size, Table slopes,
  Values stage)
{
  Index first = tableau.steps();
  if (tableau.error(0, first) != 0.0) {
    ++first;
  }
  extend(system, tableau, state, size, slopes, stage, first);
}
}  // namespace

void ExplicitStep::begin(double time, Values state) const
{
  control.hold = time - control.restarted;
  control.restarted = control.reached = time;
  control.stiffness = 0.0;
  copy(state, scratch[scratch::AFTER]);
}

void ExplicitStep::interpolate_at(const System & system, double time, Values out) const
{
  const Values before = scratch[scratch::BEFORE];
  const double size = control.span;
  if (control.step_size == 0.0 || !is_before(time, control.reached)) {
    copy(scratch[scratch::AFTER], out);
    return;
  }
  const Table slopes = scratch.from(scratch::FIRST_SLOPE);
  if (control.extended == 0.0) {
    extend_slopes(system, tableau, before, size, slopes, scratch[scratch::STAGE]);
    control.extended = 1.0;
  }
  interpolate(
    tableau, before, size, slopes, (time - control.step_start) / size, out);
  normalise(system.manifold, out);
}

// Torques are expected to change again after the last holding time: a step ends there, since the
// rest of it would be discarded.
//
// The step size times the fastest rate is estimated as by Hairer and Wanner (1996), section IV.2:
// two states at the end of a step, the last stage's and the result, differ most in the direction
// of the largest eigenvalue.
//
// The next step follows the trend of the error, too (Gustafsson's predictive control, Hairer and
// Wanner 1996, section IV.8): where steps have to become smaller, every one would be rejected once
// otherwise.
Status ExplicitStep::make(const System & system, Interrupt & interrupt) const
{
  const Values stage = scratch[scratch::STAGE], out = scratch[scratch::OUT];
  const Values before = scratch[scratch::BEFORE], after = scratch[scratch::AFTER];
  const Values last = scratch[scratch::LAST_STAGE];
  const Table slopes = scratch.from(scratch::FIRST_SLOPE);
  const Index count = after.size, stages = tableau.steps();
  const double exponent = 1.0 / static_cast<double>(tableau.error_order + 1);
  const double reached = control.reached;
  const double least = LEAST * std::max(std::abs(reached), 1e-3);
  ResponsesKept responses(system.effects);
  derivative(system, after, slopes[0]);
  const bool landed = freeze_modes(system);
  if (landed) {
    // Forces of a law may jump where its side changes, and the sign of the gap is rounding here.
    derivative(system, after, slopes[0]);
  }
  ContactSearch contacts;
  HeldJoints held(system.effects);
  if (control.step_size > 0.0) {
    double turned = 0.0, moved = 0.0;
    for (Index i = 0; i < count; ++i) {
      const double turn = slopes(0, i) - slopes(stages - 1, i), move = after[i] - last[i];
      turned += turn * turn;
      moved += move * move;
    }
    control.stiffness =
      moved > 0.0 ? control.step_size * std::sqrt(turned / moved) : 0.0;
  }
  double size = control.next_step;
  if (size == 0.0) {
    size = first_step(system, tableau, after, slopes, scale, stage);
  } else if (landed) {
    // The step size of the motion before does not fit the new one.
    size = std::min(size, first_step(system, tableau, after, slopes, scale, stage));
  }
  double wanted = size;
  const double rest = control.restarted + control.hold - reached;
  if (rest > least) {
    // Two half steps rather than a full and a tiny one.
    size = size >= rest ? rest : size > 0.5 * rest ? std::min(size, 0.5 * rest) : size;
  }
  const double tried = size;
  bool rejected = false, closed = true, extended = false;
  int cuts = 0;
  double error = 0.0, span = 0.0;
  const double size_before = control.step_size;
  const double error_before = std::max(control.error, SIGNIFICANT);
  if (system.has_effects()) {
    size = std::min(size, time_to_next_corner(system.effects, after.from(system.own())));
  }
  while (true) {
    if (!(size > least)) {
      release_modes(system);
      return !all_finite(slopes[0]) ? Status::NOT_FINITE :
             closed ? Status::STEP_TOO_SMALL : Status::OPEN_LOOP;
    }
    if (interrupt.after(stages)) {
      release_modes(system);
      return Status::INTERRUPTED;
    }
    held.begin_step();
    step(system, tableau, after, size, slopes, stage, out);
    control.work += static_cast<double>(stages);
    copy(stage, last);
    if (tableau.error(0, stages) != 0.0) {
      derivative(system, out, slopes[stages]);
    }
    error = error_norm(tableau, size, slopes, after, out, scale);
    extended = false;
    span = size;
    const auto state_at = [&](double share) {
        if (!extended) {
          extend_slopes(system, tableau, after, span, slopes, stage);
          extended = true;
        }
        interpolate(tableau, after, span, slopes, share * (size / span), stage);
        normalise(system.manifold, stage);
        return stage;
      };
    // Written so that a NaN counts as an error too large.
    if (error <= 1.0) {
      // Where the step is good, events end it at states of dense output: it is not repeated.
      const bool dense = error <= SIGNIFICANT && contacts.sought < 0;
      const auto end_at = [&](double part) {
          copy(state_at(part / size), out);
          size = part;
          return size;
        };
      const double floor =
        std::max(least_part(std::max(size, wanted), cuts), LEAST * std::abs(reached));
      const double part = locate_stick_event(system, after, out, size, floor, state_at);
      if (part < size && dense) {
        end_at(part);
      } else if (part < size) {
        size = part;
        ++cuts;
        contacts.sought = -1;
        forget_trials(system);
        continue;
      }
      double touched = contacts.part(system, out, size, state_at);
      while (dense && touched != size && contacts.sought >= 0 && touched > least) {
        touched = contacts.part(system, out, end_at(touched), state_at);
      }
      forget_rates(system);
      if (touched != size) {
        size = contacts.sought >= -1 ? touched : size;
        ++cuts;
        continue;
      }
      const double broken = held.is_overloaded() ?
        locate_breakaway(system, held, out, size, state_at) : size;
      if (broken < size && dense && broken > floor) {
        end_at(broken);
      } else if (broken < size) {
        // One that breaks away at once slides from the start.
        size = broken > floor ? broken : held.release(size);
        ++cuts;
        contacts.sought = -1;
        forget_trials(system);
        continue;
      }
      if (stabilise(system, stabilisation, out)) {
        break;
      }
    }
    rejected = true;
    contacts.sought = -1;
    forget_trials(system);
    control.rejected += 1.0;
    // Loops that cannot be closed after a step can be after a shorter one.
    closed = !(error <= 1.0);
    const double cut = !closed ? 0.5 : !(error < 1e30) ? 0.0 : SAFETY * std::pow(error, -exponent);
    size *= std::max(LARGEST_CUT, cut);
    wanted = size;
  }
  if (!equations_suffice(system, stabilisation, out)) {
    release_modes(system);
    return Status::POOR_EQUATIONS;
  }
  copy(after, before);
  copy(out, after);
  release_modes(system);
  held.release(size);
  responses.renew();
  update_friction_modes(system, after);
  if (system.has_effects()) {
    handle_time_events(system.effects, after.from(system.own()));
  }
  double growth = error < 1e-10 ? LARGEST_GROWTH :
    std::min(LARGEST_GROWTH, SAFETY * std::pow(error, -exponent));
  if (rejected) {
    growth = std::min(growth, 1.0);
  }
  if (size_before > 0.0 && error > SIGNIFICANT) {
    growth *= std::min(1.0, size / size_before * std::pow(error_before / error, exponent));
  }
  control.step_start = reached;
  control.step_size = size;
  control.span = span;
  control.tried = rejected ? 0.0 : tried;
  control.reached += size;
  // A step cut short is no reason to reduce the size to try next.
  control.next_step =
    std::max(size * std::max(growth, LARGEST_CUT), size < wanted ? wanted : 0.0);
  control.extended = extended ? 1.0 : 0.0;
  control.accepted += 1.0;
  control.error = error;
  control.largest_error = std::max(control.largest_error, error);
  return Status::DONE;
}

ErrorControlledSteps::ErrorControlledSteps(const System & system, const MethodOptions & options)
: StepperOf(system, options.stabilisation), tableau_(options.tableau),
  tolerance_(options.tolerance), scale_(2, system.ns()),
  scratch_(options.tableau.a.rows + scratch::FIRST_SLOPE, system.ns())
{
  if (options.tableau.steps() == 0) {
    throw std::invalid_argument("error control: a tableau without steps");
  }
  fill_scale(system, tolerance_, scale_.view());
}

Advance ErrorControlledSteps::advance(const System & system, Values state, const Grid & grid)
{
  StepControl & control = control_;
  const ExplicitStep run{tableau_.view(), stabilisation(), control, scale_.view(), scratch_.view()};
  Interrupt interrupt(system.interrupted, system.nv());
  if (control.step_size == 0.0) {
    run.begin(grid.start(), state);
  }
  const double target = grid.target();
  Status status = make_steps_to(
    grid, system.work.health, control, [&] {return run.make(system, interrupt);});
  if (status != Status::DONE) {
    copy(scratch_[scratch::AFTER], state);
    control.step_size = 0.0;
    return {status, control.reached - grid.start()};
  }
  run.interpolate_at(system, target, state);
  if (is_before(target, control.reached) && !stabilise_between(system, stabilisation(), state)) {
    status = Status::OPEN_LOOP;
  }
  return {status, status == Status::DONE ? static_cast<double>(grid.steps) * grid.step_size :
    control.reached - grid.start()};
}

void ErrorControlledSteps::go_on()
{
  if (control_.step_size == 0.0) {
    control_.step_size = NOTHING_BETWEEN;
  }
}

void ErrorControlledSteps::restart(const System & system, bool)
{
  control_.step_size = 0.0;
  follow_effects(system, tolerance_, scale_.view());
}

void ErrorControlledSteps::rewind(const System & system)
{
  control_ = {};
  restart(system, true);
}

StepReport ErrorControlledSteps::report() const {return report_of(control_, tolerance_);}

StepReport report_of(const StepControl & control, double tolerance)
{
  StepReport found;
  found.reached = control.reached;
  found.accepted = control.accepted;
  found.rejected = control.rejected;
  found.local_error = control.largest_error * tolerance;
  found.work = control.work;
  return found;
}

void follow_effects(const System & system, double tolerance, Table scale)
{
  const Values of_effects = system.effects.scale;
  for (Index i = 0; i < of_effects.size; ++i) {
    scale(0, system.own() + i) = of_effects[i] * tolerance;
  }
}

void fill_scale(const System & system, double tolerance, Table scale)
{
  scale.fill(tolerance);
  for (Index i = 0; i < system.nq(); ++i) {
    scale(0, i) = tolerance / error_weight(system.manifold, i);
    scale(1, i) = 0.0;
  }
  follow_effects(system, tolerance, scale);
}

}  // namespace closedloop
