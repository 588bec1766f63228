// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__GUARDED_RUN_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__GUARDED_RUN_HPP_

#include <vector>

#include "energy_balance.hpp"
#include "stepper.hpp"

// A run that is watched while it is made: its energy balance, its loops, windings of cables. Here
// it is found that something is to be told; simulation/guards.py tells it.

namespace closedloop
{

/// When a run is looked at, and what must hold then.
struct Watch
{
  /// Steps before the energy balance is looked at first, and the most between two looks.
  Index first = 1;
  Index rarely = 1;
  /// Steps that must be made at once so that it is looked at after them.
  Index call = 1;
  /// Whether nothing is looked at before all steps are made that are made at once.
  bool whole = false;
  /// Whether equations that repeat others are left out again, where all had to be taken.
  bool chooses = false;
  /// The most steps between two looks at loops or cables.
  Index most = 1;
  /// Closure error at which loops count as open; infinite where the method closes them.
  double closure = 0.0;
  /// Whether a singular position ends the run.
  bool regular = false;
  /// Of the mechanism [m].
  double extent = 0.0;
  /// Torques up to this one are not asked for what they would do within a step [N m or N].
  double usual = 0.0;
  /// Whether the CPU time of the thread is measured, too: as long as an evaluation or two.
  bool timed = false;
  /// Places, among the data of effects, of the windings of cables round pulleys; the radii stand
  /// before them.
  Indices windings;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(first, rarely, call, whole, chooses, most, closure, regular, extent, usual, timed,
      windings);
  }
};

namespace guard
{
/// GuardedRun.numbers: the time is TIME_BASE and STEPS times STEP_SIZE [s]; the size of the steps
/// that are made now, and how far the portion came that failed [s]; what steps have cost: time
/// simulated [s], steps, time of the clock spent and, where it is measured, CPU time of the thread
/// [ns]; the most energy that has moved up to any look [J], the largest error of the balance
/// relative to what had moved by then, when it was found, itself and what had moved [J]; the
/// balance at the latest look less that of the one before, and what moved in between [J]; when
/// these looks were [s]; balances where the guard began, at the latest look
/// that was well and now; when cables were looked at and the error of the balance then; the mass of
/// the mechanism [kg].
enum Number : Index
{
  TIME_BASE, STEP_SIZE, SIZE, ELAPSED, COST_TIME, COST_STEPS, COST_NANOSECONDS,
  COST_CPU_NANOSECONDS, MOVED, WORST, WORST_TIME, WORST_LOST, WORST_MOVED, LOST, MOVING, LOOK_TIME,
  BEGIN, LOOK = 21, PRESENT = 26, CABLE_TIME = 31, CABLE_RESIDUAL, MASS, NUMBERS
};
/// GuardedRun.counts: steps since TIME_BASE; those left of the present call, and all of it; the
/// portion handed to the host, how many steps of it were made, and how it ended; what is to be
/// looked at; steps until the error of one is estimated, negative where none is; steps since the
/// latest look at energy, and between two; the same for equations; whether the guards have seen
/// where they begin; whether the guard has warned, and has ended a run.
enum Count : Index
{
  STEPS, LEFT, CALL, HANDED, MADE, STATUS, DUE, TO_SAMPLE, SINCE, BETWEEN, EQUATIONS_SINCE,
  EQUATIONS_BETWEEN, LOOKED, BEGUN, CABLES_LOOKED, WARNED, FAILED, COUNTS
};
/// Values of LOOKED: not; at the state alone; at its balance, too.
enum Looked : Index {NOT, AT_STATE, AT_BALANCE};
}  // namespace guard

/// Why a run pauses: all is made; or the host is to check torques, find the energy at the start,
/// estimate an error, make steps itself, go on after a failure or tell it, choose equations anew;
/// or there is to be told of energy that is lost, a little or too much, a cable that has leapt, a
/// singular position, open loops.
enum class Pause : Index
{
  NONE, COMMAND, START_ENERGY, SAMPLE, HAND_OVER, FAILURE, CHOICE, INACCURATE, ENERGY_LOST,
  CABLE_LEAPT, NOT_REGULAR, LOOPS_OPEN
};

/// A run with its memory (integration/guarded_run.py).
struct GuardedRun
{
  Stepper stepper;
  Watch watch;
  EnergyAccount account;
  Values state;
  /// Scratch: the state before the steps that are made now.
  Values before;
  /// State and memory of the method at the latest look at energy, and at cables.
  Values kept;
  Values kept_by_cables;
  /// At the latest look at cables.
  Values windings;
  Values numbers;
  Indices counts;

  double time() const
  {
    return numbers[guard::TIME_BASE] +
           static_cast<double>(counts[guard::STEPS]) * numbers[guard::STEP_SIZE];
  }

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      stepper, watch, account, state, before, kept, kept_by_cables, windings, numbers, counts);
  }
};

/// Let torques act and make steps, until all are made or the host has something to do.
Pause advance_run(const System &, const GuardedRun &, const Given & tau, Index steps);

/// Go on with what is left of a call.
Pause resume_run(const System &, const GuardedRun &);

/// Look at the energy balance now.
Pause look_at_energy(const System &, const GuardedRun &);

/// Draw the energy balance and compare it, without a verdict: `out` becomes the balance, shape (5,).
void note_energy(const System &, const GuardedRun &, Values out);

/// Compare an error of the energy balance with the energy that moved, both [J], at a time [s].
void note_loss(Values numbers, double lost, double moved, double rounding, double time);

/// Columns of the findings: the largest error of the energy balance relative to the energy that had
/// moved by then; that error and that energy [J]; when it was found [s].
namespace finding
{
enum : Index {SHARE, LOST, MOVED, TIME, COLUMNS};
}

/// A copy of a run, to make others like it.
class CopiedRun
{
public:
  explicit CopiedRun(const GuardedRun & like);
  CopiedRun(const CopiedRun &) = delete;
  CopiedRun & operator=(const CopiedRun &) = delete;

  /// Begin at a state, its energy known.
  void begin(const System &, Values start);
  /// Let torques act.
  void command(const System &, Values torque);
  Values state() const {return run_.state;}
  /// Make steps; DOUBTFUL where the host alone can tell how the run ends.
  Status advance(const System &, Index steps);
  /// Look at energy; whether the run goes on.
  bool keeps_energy(const System &);
  /// Look at a state that steps and torques, the work of which is known [J], led to elsewhere: at
  /// its loops, and if asked at its energy; whether the run goes on.
  bool keeps_to(const System &, Values state, Index steps, double work, bool at_energy);
  /// What is known of the energy.
  void report(Values found) const;

private:
  GuardedRun run_;
  std::vector<double> values_;
  std::vector<Index> counts_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__GUARDED_RUN_HPP_
