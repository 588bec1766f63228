// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__FIXED_STEPS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__FIXED_STEPS_HPP_

#include <algorithm>
#include <utility>

#include "contact_events.hpp"
#include "evaluation.hpp"
#include "interrupt.hpp"
#include "left_out.hpp"
#include "projection.hpp"
#include "scratch.hpp"
#include "stepper.hpp"
#include "static_friction.hpp"
#include "stick_slip.hpp"

// Whole steps of one size, with a stabilisation after each.

namespace closedloop
{

/// Time until the next corner of a force over time [s]; infinity if there is none.
double time_to_corner(const System &, Values state);

/// State at a share of a step, by the parabola through both its ends with a slope at its start;
/// quadratic, which is enough to see where a path leads.
void interpolate_parabola(
  const System &, Values state, Values slope, Values out, double size, double share,
  Values between);

/// A step made in parts, as joints come to rest or forces have corners within it.
struct StepSplit
{
  double whole;  ///< Size of the step [s]
  double left;  ///< Remaining part [s]
  double size;  ///< The next part [s]
  int cuts = 0;

  explicit StepSplit(double step_size)
  : whole(step_size), left(step_size), size(step_size) {}

  /// Find whether the part from `state` to `out` must be shorter as a joint turns round within it.
  template<class StateAt>
  bool shorten(const System & system, Values state, Values out, StateAt && state_at)
  {
    const double part =
      locate_stick_event(system, state, out, size, least_part(whole, cuts), state_at);
    if (!(part < size)) {
      return false;
    }
    size = part;
    ++cuts;
    return true;
  }
  /// Accept the part: `state` becomes `out`.
  void accept(const System &, Values state, Values out);
};

/// Rows of a scratch that steps of one size need, shape (ns,) each.
struct StepScratch
{
  Values slope;
  Values out;
  Values start;
  Values between;
};

/// Advance a state in place by steps of one size [s]; on failure it is the one before the failing
/// step. `attempt(size, interrupt)` makes a step of that size from the state and its slope into
/// `out`, in `evaluations`; false where it was interrupted. Returns the status and the steps
/// completed.
template<class Attempt>
std::pair<Status, Index> make_steps_in_parts(
  const System & system, Stabilisation stabilisation, Values state, double step_size, Index steps,
  const StepScratch & scratch, Index evaluations, Attempt && attempt)
{
  const auto [slope, out, start, between] = scratch;
  Interrupt interrupt(system.interrupted, system.nv());
  ResponsesKept responses(system.effects);
  for (Index done = 0; done < steps; ++done) {
    StepSplit split(step_size);
    copy(state, start);
    // Once, but where a joint under dry friction comes to rest within the step, or a force over
    // time has a corner.
    while (split.left > 0.0) {
      split.size = std::min(split.size, time_to_corner(system, state));
      const ContactGuard contacts(system);
      responses.renew();
      derivative(system, state, slope);
      contacts.begin();
      if (!attempt(split.size, interrupt)) {
        copy(start, state);
        return {Status::INTERRUPTED, done};
      }
      const bool closed = stabilise(system, stabilisation, out);
      const bool finite = all_finite(out), stops = interrupt.after(evaluations);
      const auto state_at = [&, slope = slope, out = out, between = between](double share) {
          interpolate_parabola(system, state, slope, out, split.size, share, between);
          return between;
        };
      Status failure = Status::DONE;
      if (!(closed && finite) || stops) {
        failure = stops ? Status::INTERRUPTED : finite ? Status::OPEN_LOOP : Status::NOT_FINITE;
      } else if (!equations_suffice(system, stabilisation, out)) {
        failure = Status::POOR_EQUATIONS;
      } else if (split.shorten(system, state, out, state_at)) {
        continue;
      } else if (contacts.is_passed(out, split.size, state_at)) {
        failure = Status::CONTACT_PASSED;
      }
      if (failure != Status::DONE) {
        copy(start, state);
        return {failure, done};
      }
      responses.renew();
      split.accept(system, state, out);
    }
  }
  return {Status::DONE, steps};
}

/// What methods that take steps of one size have in common: how many the latest call completed.
template<class Method>
class StepsOfOneSize : public StepperOf<Method>
{
public:
  Advance advance(const System & system, Values state, const Grid & grid) override
  {
    const Index before = std::exchange(continued_, 0);
    const auto [status, made] = static_cast<Method *>(this)->make(
      system, state, grid.step_size, grid.steps - before);
    made_ = before + made;
    return {status, static_cast<double>(made_) * grid.step_size};
  }
  void go_on() override {continued_ = made_;}
  void restart(const System &, bool) override {}

protected:
  using StepperOf<Method>::StepperOf;

private:
  Index made_ = 0, continued_ = 0;
};

/// Explicit steps of one size; a tableau without weights means semi-implicit Euler.
class FixedSteps : public StepsOfOneSize<FixedSteps>
{
public:
  FixedSteps(const System &, const MethodOptions &);
  void rewind(const System &) override {}
  bool is_in_lanes() const override {return true;}
  Tableau tableau() const override {return tableau_.view();}

  std::pair<Status, Index> make(
    const System &, Values state, double step_size, Index steps);

private:
  OwnedTableau tableau_;
  OwnedTable scratch_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__FIXED_STEPS_HPP_
