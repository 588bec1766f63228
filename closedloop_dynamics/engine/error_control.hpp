// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ERROR_CONTROL_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ERROR_CONTROL_HPP_

#include <algorithm>
#include <cmath>

#include "interrupt.hpp"
#include "runge_kutta.hpp"

// Error-controlled steps of an embedded Runge-Kutta pair, with dense output between them.

namespace closedloop
{

/// Columns of the control record, of all error-controlled methods: the time reached by whole steps;
/// the step to try next (0: to be estimated); the start and the size of the latest step (0: no step
/// to interpolate); whether its slopes for dense output are complete; steps accepted and rejected
/// since the last reset; the latest and the largest accepted error relative to the tolerance;
/// evaluations; the time of the latest restart and the time since the one before; step size times
/// fastest rate, as the latest step shows it.
namespace control
{
enum : Index
{
  REACHED, NEXT_STEP, STEP_START, STEP_SIZE, EXTENDED, ACCEPTED, REJECTED, ERROR, LARGEST_ERROR,
  WORK, RESTARTED, HOLD, STIFFNESS, COLUMNS
};
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

/// Times of output on a grid: number n is at origin + n * step_size.
struct Grid
{
  double origin;
  Index done;  ///< Steps before this call
  double step_size;
  Index steps;  ///< Steps to advance

  double time(Index step) const {return origin + static_cast<double>(done + step) * step_size;}
  double start() const {return time(0);}
  double target() const {return time(steps);}
};

/// The evaluations since a run passed a time of output, in one call or in several.
class WorkLimit
{
public:
  /// Of a run that made `evaluations` so far and may make so many more.
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

/// An error-controlled explicit run: the method, its tolerances, shape (2, ns), and its memory.
struct ExplicitRun
{
  const Tableau & tableau;
  Stabilisation stabilisation;
  Values control;
  Table scale;
  Table scratch;

  /// Start at a state, or start again where torques have changed.
  void begin(double time, Values state) const;
  /// Make one accepted step from where the latest ended.
  Status accepted_step(const System &, Interrupt &) const;
  /// State at a time within the latest step, before it is stabilised.
  void interpolate_at(const System &, double time, Values out) const;
};

/// Advance a state, shape (ns,), over the grid by error-controlled steps that need not end on it.
/// With STEP_SIZE zero the integration starts at the state; otherwise it continues from the end of
/// the latest step. On failure the state and REACHED are the latest good ones.
Status advance_explicit(
  const System &, const Tableau &, Stabilisation, Values control, Table scale, Table scratch,
  Values state, double origin, Index done, double step_size, Index steps);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ERROR_CONTROL_HPP_
