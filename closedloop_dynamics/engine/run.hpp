// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__RUN_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__RUN_HPP_

#include <memory>
#include <utility>
#include <vector>

#include "energy_balance.hpp"
#include "scratch.hpp"
#include "stepper.hpp"

// A run that is checked while it is made: its energy balance, its loops, windings of cables. A run
// owns its memory: a copy of it is another run. It has neither system nor state, which are arguments
// of what it does: the state of a system that a run advances is always the same one.

namespace closedloop
{

/// Times and limits of the checks of a run (simulation/guards.py).
struct GuardLimits
{
  double step_size = 0.0;  ///< [s]
  Index order = 1;  ///< Of the method
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
  /// Size [m] and mass [kg] of the mechanism.
  double extent = 0.0;
  double mass = 0.0;
  /// Torques up to this one are not checked for their effect within a step [N m or N].
  double usual = 0.0;
  /// Whether the CPU time of the thread is measured, too: as long as an evaluation or two.
  bool timed = false;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "step_size, order, first, rarely, call, whole, chooses, most, closure, regular, extent, mass, "
      "usual, timed", step_size, order, first, rarely, call, whole, chooses, most, closure, regular,
      extent, mass, usual, timed);
  }
};

/// Why a run comes back: all steps are made; or it is for the host to check torques, or to choose
/// closure equations; or it ends at a step that failed; or a guard has found a small or a large error
/// of the energy balance, a leap of a cable, a singular position, open loops.
enum class Outcome : Index
{
  DONE, COMMAND, CHOICE, FAILED, INACCURATE, ENERGY_LOST, CABLE_LEAPT, NOT_REGULAR,
  LOOPS_OPEN
};

/// The largest error of the energy balance.
struct EnergyFinding
{
  double moved = 0.0;  ///< The largest energy exchanged up to any check [J]
  /// Largest error relative to the energy exchanged by then; its time [s], the error and that energy
  /// [J].
  double worst = 0.0;
  double worst_time = 0.0;
  double worst_lost = 0.0;
  double worst_moved = 0.0;

  /// Compare an error of the balance with the energy exchanged, both [J], at a time [s].
  void record(double lost, double energy, double rounding, double time);
};

/// Columns of the findings of many runs: as of EnergyFinding.
namespace finding
{
enum : Index {SHARE, LOST, MOVED, TIME, COLUMNS};
}

/// What is known of a run.
struct RunReport
{
  double time = 0.0;  ///< [s]
  Status status = Status::DONE;  ///< Of the steps that failed
  double size = 0.0;  ///< Of the present steps [s]
  /// Whether the closure equations that are to be chosen are to be looked for around the
  /// position, too, as loops may have opened; whether those in use may be kept.
  bool nearby = false;
  bool or_these = false;
  /// Cost of steps: time simulated [s], steps, wall time and, if measured, CPU time of the thread [s].
  double simulated = 0.0;
  double steps = 0.0;
  double elapsed = 0.0;
  double worked = 0.0;
  double local_error = StepReport::UNKNOWN;  ///< Of sampled steps [rad or m]
  EnergyFinding energy;
  /// Error and energy exchanged since the check before the latest [J]; the time of the latest good one
  /// [s], and the error of the balance then, and where the guard began [J].
  double lost = 0.0;
  double moving = 0.0;
  double check_time = 0.0;
  double check_residual = 0.0;
  double first_residual = 0.0;
  bool failed = false;  ///< Whether a check of the balance has ended the run
  Index unchecked = 0;  ///< Steps since the latest check
  bool at_start = true;  ///< Whether the energy at the start has not been asked for
  /// The cable that has leapt and how far it was wound before [rad], the time of that [s], and the
  /// error of the balance then [J].
  Index leapt = 0;
  double winding = 0.0;
  double cable_time = 0.0;
  double cable_residual = 0.0;

  template<class Visitor>
  void names(Visitor && visit) const
  {
    visit(
      "time", time, "status", status, "size", size, "nearby", nearby, "or_these",
      or_these, "simulated", simulated, "steps", steps, "elapsed", elapsed, "worked", worked, "local_error", local_error, "moved", energy.moved,
      "worst", energy.worst, "worst_time", energy.worst_time, "worst_lost", energy.worst_lost,
      "worst_moved", energy.worst_moved, "lost", lost, "moving", moving, "check_time", check_time,
      "check_residual", check_residual, "first_residual", first_residual, "failed", failed,
      "unchecked", unchecked, "at_start", at_start, "leapt", leapt, "winding", winding,
      "cable_time", cable_time, "cable_residual", cable_residual);
  }
};

/// Energies of a state that were found elsewhere [J], and the forces in its joints, by size.
struct Stored
{
  double kinetic;
  double potential;
  double felt;
};

/// The method of a run; that of its copy is a copy.
class OwnedStepper
{
public:
  explicit OwnedStepper(std::unique_ptr<Stepper> stepper)
  : stepper_(std::move(stepper)) {}
  OwnedStepper(const OwnedStepper & other)
  : stepper_(other->clone()) {}
  OwnedStepper & operator=(const OwnedStepper & other)
  {
    stepper_ = other->clone();
    return *this;
  }
  Stepper * operator->() const {return stepper_.get();}

private:
  std::unique_ptr<Stepper> stepper_;
};

class Run
{
public:
  /// A run by a method; `roles` are those of the effects' states; `windings`: places, among the data of
  /// effects, of the windings of cables round pulleys, each behind its radius.
  Run(
    const System &, std::unique_ptr<Stepper>, const GuardLimits &, Indices roles, Indices windings);

  /// Go on with other limits, or by the method and with the limits of another run.
  void set_guard_limits(const System &, const GuardLimits &, Indices windings);
  void take_method(const System &, const Run & other);
  const GuardLimits & guard_limits() const {return limits_;}
  const Stepper & stepper() const {return *stepper_.operator->();}
  /// Whether it is one of this system.
  bool fits(const System &) const;

  /// Passed on to its method: `Stepper`.
  void restart(const System & system, bool moved) {stepper_->restart(system, moved);}
  void rewind(const System &);
  void aim(double accuracy) {stepper_->aim(accuracy);}
  StepReport steps() {return stepper_->report();}
  /// Make a step of a size [s] from a state, in place, and leave all else as it is.
  Status try_step(const System &, Values state, double size);

  /// The whole state, by which a run goes on to the last bit: a state, the memory of the method and the
  /// choice of coordinates. Its length; write it; read it; the accuracy that is kept in one.
  Index whole_length(const System &);
  void write_whole(const System &, Values state, Values out);
  void recall(const System &, Values state, Values whole);
  double accuracy_in(const System &, Values whole);

  /// Begin at a state, whose energy is evaluated when it is needed.
  void begin(const System &, Values state);
  /// Begin at a state as a copy of a run, which has none of the guards' findings.
  void begin_copy(const System &, Values state);

  double time()
  {
    return time_base_ + static_cast<double>(steps_) * limits_.step_size + advanced_;
  }
  /// The time is so many steps after another one [s].
  std::pair<double, Index> base() {return {time_base_ + advanced_, steps_};}
  void set_time(double base, Index steps);
  RunReport report();
  /// Count cost from here on; estimate the error of fixed steps, unless asked not to.
  void clear_cost();
  void sample(bool wanted);

  /// Apply torques and make steps. Python checks torques that are not finite, or unusual.
  Outcome advance(const System &, Values state, const OptionalVector & tau, Index steps);
  /// Make steps of a size [s]; `call`: the length of the call that they are part of.
  Outcome make(const System &, Values state, double size, Index steps, Index call);
  /// Continue with the rest of a call, on the equations that were chosen or that are in use; or end at
  /// the state that a failed step has left.
  Outcome resume(const System &, Values state, bool goes_on);

  /// Apply torques, and add the work of those that were held up to a state.
  void command(const System &, Values state, Vector<const double> torque);
  void add_work(const System &, Values state);
  /// Find the energy at the start, if it is not known.
  void find_start(const System &);
  /// The energy balance of a state.
  Energies balance(const System &, Values state);
  /// The same, compared with the balances before, without a finding.
  Energies record_energy(const System &, Values state);
  /// Check the energy balance now.
  Outcome check_energy(const System &, Values state);
  /// Begin the comparisons again, as the state or an effect has been changed.
  void jump();
  /// Leave a change of energy from outside, to a state, out of the balance [J].
  void jump_balance(const System &, Values state, double energy);
  /// Restart the guards.
  void restart_guards();
  /// Write the columns of a finding.
  void write_finding(Values found) const;
  /// Status of the steps that failed.
  Status status() const {return report_.status;}
  /// Check a state that was made elsewhere, after so many steps, with the work of its torques [J]: its
  /// loops and, if requested, its energy, with `stored` energies unless that is nullptr.
  Outcome check_state(
    const System &, Values state, Index steps, double work, const Stored * stored, bool at_energy);

  /// Write the whole state at the latest good check of energy, or of cables.
  void write_kept(bool of_cables, Values out);

private:
  enum class Checked {NOT, AT_STATE, AT_BALANCE};

  Outcome check(const System &, Values state);
  void check_start(const System &, Values state);
  Outcome check_cables(const System &, Values state);
  Outcome check_loops(const System &, Values state);
  Outcome compare_balance(const Energies & present, double scale);
  double record_balance(const Energies & present, double scale);
  void accept_balance(const Energies &);
  void accept_windings(const System &, Values state, const Energies &);
  double energy_scale(const System &, double felt) const;
  double winding(const System &, Index number) const;
  void keep(const System &, Values state, std::vector<double> & kept);
  Outcome make_until_outcome(const System &, Values state);
  Outcome make_portion(const System &, Values state, Index steps);
  Outcome choose_or_end(const System &);
  Outcome give_up();
  void begin_call(double size, Index steps, Index call);
  void book(const System &, Index steps);
  Outcome estimate_error(const System &, Values state);

  OwnedStepper stepper_;
  GuardLimits limits_;
  EnergyAccount account_;

  /// The time is that of a base, and whole steps since then [s].
  double time_base_ = 0.0;
  Index steps_ = 0;

  /// Present call: steps left and all of them, the portion that failed and the time by which it
  /// advanced [s]; the checks that are due.
  Index left_ = 0;
  Index call_ = 0;
  Index handed_ = 0;
  double advanced_ = 0.0;
  unsigned due_ = 0;
  /// How often equations were asked for since it last got on, and where that was [s].
  Index exchanges_ = 0;
  double reached_ = 0.0;

  RunReport report_;
  /// Steps until the error of one is estimated, negative if never, and to the next time.
  Index to_sample_ = -1;
  Index between_samples_ = 0;
  /// Balances where the guard began and at the latest good check; steps between two checks; the same
  /// for equations, and steps since then.
  Energies begin_;
  Energies check_;
  Index between_ = 1;
  Index equations_since_ = 0;
  Index equations_between_ = 1;
  /// Whether equations are being chosen that are left out again; the time since which there are none
  /// better than those in use [s].
  bool leaves_out_ = false;
  double lenient_since_ = 0.0;
  Checked checked_ = Checked::NOT;
  bool begun_ = false;
  bool warned_ = false;

  /// Places of the windings, their angles at the latest check [rad], and whether there was one.
  std::vector<Index> windings_;
  std::vector<double> angles_;
  bool cables_checked_ = false;

  /// State and balance at the start, and the state before the steps that are made now.
  std::vector<double> start_;
  Energies start_balance_;
  std::vector<double> before_;
  std::vector<double> kept_;
  std::vector<double> kept_by_cables_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__RUN_HPP_
