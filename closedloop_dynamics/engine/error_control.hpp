// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ERROR_CONTROL_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ERROR_CONTROL_HPP_

#include <algorithm>
#include <cmath>
#include <cstring>
#include <type_traits>

#include "interrupt.hpp"
#include "scratch.hpp"
#include "stepper.hpp"

// Error-controlled steps of an embedded Runge-Kutta pair, with dense output between them.

namespace closedloop
{

/// Progress of a method with error control.
struct StepControl
{
  double reached = 0.0;  ///< Time reached by whole steps [s]
  double next_step = 0.0;  ///< The step to try next [s]; 0: to be estimated
  /// Start and size of the latest step [s]; size 0: the integration starts at a state.
  double step_start = 0.0;
  double step_size = 0.0;
  double extended = 0.0;  ///< Whether its slopes for dense output are complete
  double span = 0.0;  ///< Size of the step that its slopes are of, longer where an event cut it [s]
  /// The size that it was tried with before events cut it [s]; 0 where its error did.
  double tried = 0.0;
  /// Steps since the count began.
  double accepted = 0.0;
  double rejected = 0.0;
  /// The latest and the largest accepted error relative to the tolerance.
  double error = 0.0;
  double largest_error = 0.0;
  double work = 0.0;  ///< Evaluations
  double restarted = 0.0;  ///< Time of the latest restart [s]
  double hold = 0.0;  ///< Time from the one before to that [s]
  double stiffness = 0.0;  ///< Step size times fastest rate, as the latest step shows it

  void clear_counts() {accepted = rejected = error = largest_error = 0.0;}
};

/// Write numbers that are a record of double precision to an array, and read them; returns the place
/// behind them.
template<class Record>
double * store(const Record & from, double * to)
{
  static_assert(std::is_trivially_copyable_v<Record> && sizeof(Record) % sizeof(double) == 0);
  std::memcpy(to, &from, sizeof(Record));
  return to + sizeof(Record) / sizeof(double);
}
template<class Record>
const double * recall(const double * from, Record & to)
{
  static_assert(std::is_trivially_copyable_v<Record> && sizeof(Record) % sizeof(double) == 0);
  std::memcpy(static_cast<void *>(&to), from, sizeof(Record));
  return from + sizeof(Record) / sizeof(double);
}

/// Rows of the scratch of the explicit methods, shape (stages + FIRST_SLOPE, ns).
namespace scratch
{
enum : Index {STAGE, OUT, BEFORE, AFTER, LAST_STAGE, FIRST_SLOPE};
}

/// The step size aimed a little below the tolerance.
constexpr double SAFETY = 0.9;
/// The least step, relative to the time that it has to change; times closer than that are the same.
constexpr double LEAST = 1e-14;
/// In place of a step size: no step to interpolate, but the method has a history.
constexpr double NOTHING_BETWEEN = -1.0;
/// Evaluation limit between two times of output; one next to a singular position counts as so many,
/// about what it takes where it finds a branch.
constexpr double MOST_EVALUATIONS = 200000;
constexpr double RANK_REVEALING_WORK = 20;

/// Whether a time is before another by more than rounding.
inline bool is_before(double time, double target)
{
  return target - time > LEAST * std::fmax(std::abs(target), 1e-3);
}

/// The evaluations since a run passed a time of output, in one call or in several.
class WorkLimit
{
public:
  /// The limit of a run that made `evaluations` so far and may make so many more.
  WorkLimit(const Grid & grid, const Values & health, double evaluations, double most)
  : grid_(grid), health_(health), since_(work(evaluations)), most_(most) {}

  /// Whether a run that has come to a time made too many.
  bool exceeded(double reached, double evaluations)
  {
    if (next_ < grid_.steps && !is_before(reached, grid_.time(next_))) {
      since_ = work(evaluations);
      // One step may pass millions of them.
      const double passed = (reached - grid_.time(0)) / grid_.step_size;
      next_ = std::max(
        next_, (passed < static_cast<double>(grid_.steps) ? static_cast<Index>(passed) :
        grid_.steps) - 1);
      while (next_ < grid_.steps && !is_before(reached, grid_.time(next_))) {
        ++next_;
      }
    }
    return work(evaluations) - since_ > most_;
  }

private:
  double work(double evaluations) const
  {
    return evaluations + RANK_REVEALING_WORK * health_[health::RANK_REVEALING_COUNT];
  }

  Grid grid_;
  Values health_;
  double since_, most_;
  Index next_ = 1;
};

/// Make accepted steps up to the end of a grid, or past it, until one fails or they take too much work.
template<class Make>
Status make_steps_to(
  const Grid & grid, const Values & health, const StepControl & control, Make && make)
{
  WorkLimit limit(grid, health, control.work, MOST_EVALUATIONS);
  Status status = Status::DONE;
  while (status == Status::DONE && is_before(control.reached, grid.target())) {
    status = make();
    if (status == Status::DONE && limit.exceeded(control.reached, control.work)) {
      status = Status::TOO_MUCH_WORK;
    }
  }
  return status;
}

/// Tolerances of the components of a state, shape (2, ns): absolute and relative. Of coordinates they
/// are absolute, of others both.
void fill_scale(const System &, double tolerance, Table scale);
/// Those of the effects' states alone, by their present parameters.
void follow_effects(const System &, double tolerance, Table scale);

/// One step of an embedded pair, with dense output, on the memory of a run.
struct ExplicitStep
{
  Tableau tableau;
  Stabilisation stabilisation;
  StepControl & control;
  Table scale;  ///< Shape (2, ns)
  Table scratch;  ///< Shape (stages + FIRST_SLOPE, ns); its row AFTER is the state at `reached`

  /// Start at a state, or start again where torques have changed.
  void begin(double time, Values state) const;
  /// Make one accepted step from where the latest ended.
  Status make(const System &, Interrupt &) const;
  /// State at a time within the latest step, before it is stabilised.
  void interpolate_at(const System &, double time, Values out) const;
};

/// Steps of an embedded pair as long as the tolerance allows; they need not end on the grid.
class ErrorControlledSteps : public StepperOf<ErrorControlledSteps>
{
public:
  ErrorControlledSteps(const System &, const MethodOptions &);
  Advance advance(const System &, Values state, const Grid &) override;
  void go_on() override;
  void restart(const System &, bool moved) override;
  void rewind(const System &) override;
  Index memory_length() const override {return sizeof(StepControl) / sizeof(double);}
  void store_memory(Values to) const override {store(control_, to.data);}
  void recall_memory(Values from) override {recall(from.data, control_);}
  StepReport report() const override;
  void clear_report() override {control_.clear_counts();}

private:
  OwnedTableau tableau_;
  double tolerance_;
  StepControl control_;
  OwnedTable scale_, scratch_;
};

/// The report of a method with a tolerance, from its control record.
StepReport report_of(const StepControl &, double tolerance);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ERROR_CONTROL_HPP_
