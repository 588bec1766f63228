// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SWITCHING_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SWITCHING_HPP_

#include "rosenbrock.hpp"

// The default method: error control that changes between DOP853 and RODAS4.
//
// Where torques are held for so short that one step of order five does, DOPRI5 makes it, with fewer
// evaluations than DOP853.
//
// Where steps of the explicit method are limited by stability, the stiff one is tried, and the one
// with less work per time continues; work is counted in evaluations, so that the same run changes
// at the same steps every time.
//
// The local tolerance is a thousandth of the requested accuracy. Whether that is enough is
// monitored: in windows of one second a reference run with a tolerance 30 times as large starts
// from the same state. The distance of the two bounds the global error of the run within a second;
// the tolerance of both is tightened where that bound comes near the accuracy. Where torques are held
// for so short that both would make the same steps, the reference run takes over those of the run.

namespace closedloop
{

/// Columns of the control record that follow those of error_control.hpp: whether the stiff method
/// steps; consecutive explicit steps that seem limited by stability, and that do not; how many of
/// the former start a trial of the stiff method; work and time when that count, or the trial,
/// began; work per time of the explicit method before the trial; steps of the trial; whether the
/// present step is DOPRI5's, the step that it would make next, and after how many restarts it is
/// tried again.
namespace switching
{
enum : Index
{
  STIFF = control::COLUMNS, STIFF_COUNT, NONSTIFF_COUNT, STIFF_THRESHOLD, SINCE_WORK, SINCE_TIME,
  EXPLICIT_RATE, TRIAL_STEPS, SHORT, SHORT_STEP, SHORT_WAIT, COLUMNS
};
}

/// Columns of the monitor: the accuracy; the present tolerance; whether a window is open; when it
/// ends or the next begins; how long the next pause is; the smallest step in a window; the bound of
/// the error in the present window, the part of it from before the reference run was set back, and
/// the largest of all windows; the bound at which the tolerance is tightened next; how often it
/// was.
namespace monitor
{
enum : Index
{
  ACCURACY, TOLERANCE, OPEN, UNTIL, PAUSE, SMALLEST, BOUND, CARRIED, LARGEST_BOUND, NEXT_BOUND,
  TIGHTENED, COLUMNS
};
}

/// The reference run's tolerance, times that of the run.
constexpr double LOOSER = 30.0;

/// A run and its reference run (integration/drivers.py).
struct Runs
{
  /// DOPRI5.
  Tableau short_tableau;
  Table control;
  Cube<double> scale;
  Cube<double> scratch;
  Cube<double> stiff_scratch;
  Table matrix;
  Indices pivots;
  Values monitor;
  Values weight;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      short_tableau, control, scale, scratch, stiff_scratch, matrix, pivots, monitor, weight);
  }
};

/// Advance a state over the grid; arguments and result as of `advance_explicit`.
Status advance_switching(
  const System &, const Tableau &, Stabilisation, const Runs &, Values state, double origin,
  Index done, double step_size, Index steps);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SWITCHING_HPP_
