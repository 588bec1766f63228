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

/// Progress of a run, or of its reference run.
struct SwitchingControl : StepControl
{
  double stiff = 0.0;  ///< Whether the stiff method steps
  /// Consecutive explicit steps that seem limited by stability, and that do not; how many of the
  /// former start a trial of the stiff method.
  double stiff_count = 0.0;
  double nonstiff_count = 0.0;
  double stiff_threshold = 0.0;
  /// Work and time when that count, or the trial, began; work per time of the explicit method before
  /// the trial; steps of the trial.
  double since_work = 0.0;
  double since_time = 0.0;
  double explicit_rate = 0.0;
  double trial_steps = 0.0;
  /// Whether the present step is DOPRI5's, the step that it would make next, and after how many
  /// restarts it is tried again.
  double is_short = 0.0;
  double short_step = 0.0;
  double short_wait = 0.0;
};

/// Estimate of the error by the reference run.
struct ErrorMonitor
{
  double accuracy = 0.0;
  double tolerance = 0.0;  ///< The present one
  double open = 0.0;  ///< Whether a window is open
  double until = 0.0;  ///< When it ends, or the next begins [s]
  double pause = 0.0;  ///< How long the next pause is [s]
  double smallest = 0.0;  ///< The smallest step in the window [s]
  /// The bound of the error in the present window, and the part of it from before the reference run
  /// was set back; the largest of all windows; the one at which the tolerance is tightened next.
  double bound = 0.0;
  double carried = 0.0;
  double largest_bound = 0.0;
  double next_bound = 0.0;
  double tightened = 0.0;  ///< How often it was
};

/// The reference run's tolerance, times that of the run.
constexpr double LOOSER = 30.0;

/// The default method.
class SwitchingSteps : public StepperOf<SwitchingSteps>
{
public:
  SwitchingSteps(const System &, const MethodOptions &);
  Advance advance(const System &, Values state, const Grid &) override;
  void go_on() override;
  void restart(const System &, bool moved) override;
  void rewind(const System &) override;
  Index memory_length() const override;
  void store_memory(Values) const override;
  void recall_memory(Values) override;
  StepReport report() const override;
  void clear_report() override {run_.control.clear_counts();}
  /// The run goes on with another accuracy, and a new window begins.
  void aim(double accuracy) override;

private:
  /// The run, or its reference run.
  struct Track
  {
    SwitchingControl control;
    OwnedTable scale, scratch, stiff_scratch;

    Values after() const {return scratch[scratch::AFTER];}
  };

  ExplicitStep explicit_step(Track &);
  Status make_explicit_step(const System &, Track &, Interrupt &);
  Status make_step(const System &, Track &, double limit, Interrupt &);
  void begin(double time, Values state);
  void open_window();
  void set_reference_back();
  bool same_for_reference();
  void take_same();
  void update_monitor(const System &, bool lost);
  void tighten();
  double distance(const System &);
  void set_scale();

  OwnedTableau tableau_, short_tableau_;
  double accuracy_;  ///< The one that it is rewound to
  ErrorMonitor monitor_;
  Track run_, reference_;
  OwnedTable unit_;  ///< Shape (2, ns): tolerances for one of 1
  StiffMemory stiff_;
  std::vector<double> weight_;  ///< Shape (nq,): of a component in the distance of the two
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SWITCHING_HPP_
