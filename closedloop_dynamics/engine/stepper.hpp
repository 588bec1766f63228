// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_

#include <limits>
#include <memory>
#include <utility>
#include <string_view>

#include "runge_kutta.hpp"

// What every method of time integration promises. To add one:
//
// 1. Derive a class from StepperOf<the class>, in a file of its own. It owns its scratch, allocated
//    in its constructor from a system's lengths; nothing is allocated in a step. Its copy
//    constructor copies all of it: a rollout makes its runs by copies.
// 2. `advance` brings a state over a grid of times, in steps of its own choice, closes the loops
//    after each (`stabilise`), asks whether the equations suffice there (`equations_suffice`), ends
//    steps at events (time_events, stick_slip, contact_events) and asks `Interrupt` whether to stop.
//    Where it fails the state is the latest good one, and it says how far it came.
// 3. `go_on`: the next `advance` is the same as the one that failed, on other closure equations, and
//    continues where that ended.
// 4. `restart`: torques or parameters have changed, or, with `moved`, the state. What is left then
//    is the memory, by which a run that was saved goes on to the last bit: `memory` visits it.
// 5. `rewind`: as after construction, so that a motion repeated is the same to the last bit.
// 6. `report`: what it knows of its steps; NaN where it knows nothing.
// 7. Its name is a line in stepper.cpp, and with a summary for people in scene/integrators.py.

namespace closedloop
{

/// Times of output on a grid: number n is at origin + n * step_size.
struct Grid
{
  double origin;
  Index done;  ///< Steps before this call
  double step_size;
  Index steps;  ///< Steps to advance

  double time(Index step) const {return origin + static_cast<double>(done + step) * step_size;}
  double start() const {return time(0);}
  double target() const {return time(steps);}};

/// How an advance ended.
struct Advance
{
  Status status;
  double elapsed;  ///< Time advanced by [s]
};

/// Numbers that a method knows of its steps, since it was rewound.
struct StepReport
{
  static constexpr double UNKNOWN = std::numeric_limits<double>::quiet_NaN();

  double reached = UNKNOWN;  ///< Time reached by whole steps [s]
  double accepted = UNKNOWN;
  double rejected = UNKNOWN;
  double local_error = UNKNOWN;  ///< Largest estimate of an accepted step [rad or m]
  double work = UNKNOWN;  ///< Evaluations
  /// The default method: evaluations of its reference run; the accuracy that is kept, and the
  /// tolerance for it; bounds of the error within a second, the largest and that of the latest one
  /// [rad or m]; whether the stiff method, or the one of lower order, makes the present step.
  double reference_work = UNKNOWN;
  double accuracy = UNKNOWN;
  double tolerance = UNKNOWN;
  double largest_bound = UNKNOWN;
  double bound = UNKNOWN;
  bool stiff = false;
  bool is_short = false;

  template<class Visitor>
  void names(Visitor && visit) const
  {
    visit(
      "reached", reached, "accepted", accepted, "rejected", rejected, "local_error", local_error,
      "work", work, "reference_work", reference_work, "accuracy", accuracy, "tolerance", tolerance,
      "largest_bound", largest_bound, "bound", bound, "stiff", stiff, "is_short", is_short);
  }
};

/// A method of time integration with its memory and scratch.
class Stepper
{
public:
  virtual ~Stepper() = default;
  virtual std::unique_ptr<Stepper> clone() const = 0;

  virtual Advance advance(const System &, Values state, const Grid &) = 0;
  virtual void go_on() = 0;
  virtual void restart(const System &, bool moved) = 0;
  virtual void rewind(const System &) = 0;

  /// Length of the memory; write it to an array, and read it from there.
  virtual Index memory_length() const {return 0;}
  virtual void store_memory(Values) const {}
  virtual void recall_memory(Values) {}

  virtual StepReport report() const {return {};}
  /// Count from here on.
  virtual void clear_report() {}
  /// Keep another accuracy from the next step on.
  virtual void aim(double accuracy);

  Stabilisation stabilisation() const {return stabilisation_;}
  /// Whether lanes may make its steps, which are explicit and of one size, by its tableau.
  virtual bool is_in_lanes() const {return false;}
  virtual Tableau tableau() const {return {};}
  /// Whether a state of this system can be stepped.
  bool fits(const System & system) const {return system.ns() == states_;}

protected:
  Stepper(const System & system, Stabilisation stabilisation)
  : stabilisation_(stabilisation), states_(system.ns()) {}
  Stepper(const Stepper &) = default;
  Stepper & operator=(const Stepper &) = default;

private:
  Stabilisation stabilisation_;
  Index states_;
};

/// What follows from a copy constructor.
template<class Method>
class StepperOf : public Stepper
{
public:
  std::unique_ptr<Stepper> clone() const override
  {
    return std::make_unique<Method>(static_cast<const Method &>(*this));
  }

protected:
  using Stepper::Stepper;
};

/// What a method is built from.
struct MethodOptions
{
  Tableau tableau;  ///< Of explicit methods
  Tableau short_tableau;  ///< Of the default method: for steps while torques are held for short
  Stabilisation stabilisation = Stabilisation::NONE;
  /// Local error allowed per step, of the default method the accuracy [rad or m].
  double tolerance = 0.0;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "tableau?, short_tableau?, stabilisation, tolerance", tableau, short_tableau, stabilisation,
      tolerance);
  }
};

/// Build a method by its name, one of: fixed, explicit, auto, rodas4_fixed, rodas4.
std::unique_ptr<Stepper> make_stepper(const System &, std::string_view name, const MethodOptions &);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_
