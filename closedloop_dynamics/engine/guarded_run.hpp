// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__GUARDED_RUN_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__GUARDED_RUN_HPP_

#include <memory>
#include <vector>

#include "energy_balance.hpp"
#include "stepper.hpp"

// A run that is checked while it is made: its energy balance, its loops, windings of cables.
// Findings are made here; simulation/guards.py reports them.

namespace closedloop
{

/// Times and limits of the checks of a run.
struct Watch
{
  /// Steps before the first check of the energy balance, and the most between two checks.
  Index first = 1;
  Index rarely = 1;
  /// Least steps of a call after which it is checked.
  Index call = 1;
  /// Whether checks wait for the end of a call.
  bool whole = false;
  /// Whether redundant equations are left out again, where all had to be kept.
  bool chooses = false;
  /// The most steps between two checks of loops or cables.
  Index most = 1;
  /// Closure error at which loops count as open; infinite where the method closes them.
  double closure = 0.0;
  /// Whether a singular position ends the run.
  bool regular = false;
  /// Of the mechanism [m].
  double extent = 0.0;
  /// Torques up to this one are not checked for their effect within a step [N m or N].
  double usual = 0.0;
  /// Whether the CPU time of the thread is measured, too: as long as an evaluation or two.
  bool timed = false;
  /// Places, among the data of effects, of the windings of cables round pulleys; each behind its
  /// radius.
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
/// GuardedRun.numbers: the time is TIME_BASE and STEPS times STEP_SIZE [s]; the present step size,
/// and the time reached by the portion that failed [s]; cost of steps: time simulated [s], steps,
/// wall time and, if measured, CPU time of the thread [ns]; the largest energy exchanged up to any
/// check [J]; the largest error of the balance relative to the energy exchanged by then, its time,
/// itself and that energy [J]; error and energy exchanged since the latest check [J]; the time of
/// the latest check [s]; balances where the guard began, at the latest good check and now; time of
/// the latest check of cables and the error of the balance then; the mass of the mechanism [kg].
enum Number : Index
{
  TIME_BASE, STEP_SIZE, SIZE, ELAPSED, COST_TIME, COST_STEPS, COST_NANOSECONDS,
  COST_CPU_NANOSECONDS, MOVED, WORST, WORST_TIME, WORST_LOST, WORST_MOVED, LOST, MOVING, CHECK_TIME,
  BEGIN, CHECK = 21, PRESENT = 26, CABLE_TIME = 31, CABLE_RESIDUAL, MASS, NUMBERS
};
/// GuardedRun.counts: steps since TIME_BASE; steps left of the present call, and all of them; the
/// portion handed to the host, and its status; the checks that are due; steps until
/// the next error estimate, negative without; steps since the latest check of energy, and between
/// two; the same for equations; whether the guards have checked the start; whether the guard has
/// warned, and has ended a run.
enum Count : Index
{
  STEPS, LEFT, CALL, HANDED, STATUS, DUE, TO_SAMPLE, SINCE, BETWEEN, EQUATIONS_SINCE,
  EQUATIONS_BETWEEN, CHECKED, BEGUN, CABLES_CHECKED, WARNED, FAILED, COUNTS
};
/// Values of CHECKED: not; at the state alone; at its balance, too.
enum Checked : Index {NOT, AT_STATE, AT_BALANCE};
}  // namespace guard

/// Why a run pauses: all steps are made; or the host is to check torques, find the energy at the
/// start, estimate an error, make steps itself, continue after a failure or report it, choose other
/// equations; or to report a small or large error of the energy balance, a leap of a cable, a
/// singular position, open loops.
enum class Pause : Index
{
  NONE, COMMAND, START_ENERGY, SAMPLE, HAND_OVER, FAILURE, CHOICE, INACCURATE, ENERGY_LOST,
  CABLE_LEAPT, NOT_REGULAR, LOOPS_OPEN
};

/// A run with its memory (integration/guarded_run.py).
struct GuardedRun
{
  /// nullptr: the host makes the steps.
  Stepper * stepper = nullptr;
  Watch watch;
  EnergyAccount account;
  Values state;
  /// Scratch: the state before the steps that are made now.
  Values before;
  /// State and memory of the method at the latest check of energy, and of cables.
  Values kept;
  Values kept_by_cables;
  /// At the latest check of cables.
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

/// Apply torques and make steps, until all are made or the host has to act.
Pause advance_run(const System &, const GuardedRun &, const Given & tau, Index steps);

/// Continue with the rest of a call.
Pause resume_run(const System &, const GuardedRun &);

/// Check the energy balance now.
Pause check_energy(const System &, const GuardedRun &);

/// Draw and compare the energy balance, without a finding: `out` becomes the balance, shape (5,).
void record_energy(const System &, const GuardedRun &, Values out);

/// Compare an error of the energy balance with the energy exchanged, both [J], at a time [s].
void record_loss(Values numbers, double lost, double moved, double rounding, double time);

/// Columns of the findings: the largest error of the energy balance relative to the energy
/// exchanged by then; that error and that energy [J]; its time [s].
namespace finding
{
enum : Index {SHARE, LOST, MOVED, TIME, COLUMNS};
}

/// Energies of a state that were found elsewhere [J], and the forces in its joints, by size.
struct Stored
{
  double kinetic;
  double potential;
  double felt;
};

/// A copy of a run, to make others like it.
class CopiedRun
{
public:
  explicit CopiedRun(const GuardedRun & like);
  CopiedRun(const CopiedRun &) = delete;
  CopiedRun & operator=(const CopiedRun &) = delete;

  /// To be written before a run begins, and before a state is checked; else to be read.
  Values state() const {return run_.state;}
  /// Begin at the state.
  void begin(const System &);
  /// Apply torques.
  void command(const System &, Values torque);
  Stepper & stepper() {return *stepper_;}
  /// Make steps; DOUBTFUL where the host has to decide how the run ends.
  Status advance(const System &, Index steps);
  /// Check the energy; return whether the run continues.
  bool keeps_energy(const System &);
  /// Check the state after steps made elsewhere, with the work of its torques [J]: its loops and,
  /// if requested, its energy, with `stored` energies unless that is nullptr; return whether the run
  /// continues.
  bool check_state(
    const System &, Index steps, double work, const Stored * stored, bool at_energy);
  /// Write the energy columns of a result.
  void report(Values found) const;

private:
  GuardedRun run_;
  std::unique_ptr<Stepper> stepper_;
  std::vector<double> values_;
  std::vector<Index> counts_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__GUARDED_RUN_HPP_
