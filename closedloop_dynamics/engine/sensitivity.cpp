// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "sensitivity.hpp"

#include <algorithm>
#include <stdexcept>

#include "evaluation.hpp"
#include "interrupt.hpp"
#include "left_out.hpp"
#include "manifold.hpp"
#include "manifold_derivatives.hpp"
#include "null_space.hpp"
#include "requests.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
void add(Values from, double share, Values to)
{
  dense(to) += share * dense(from.part(0, to.size));
}

/// Replays a tape, step by step.
class TapeReplay
{
public:
  TapeReplay(
    const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
    const StepRoutines & routines)
  : system_(system), run_(run), scratch_(scratch), tape_(tape), routines_(routines),
    closes_(run.stabilisation >= Stabilisation::VELOCITY && system.lam.size > 0) {}

protected:
  Index nq() const {return system_.nq();}
  Index nv() const {return system_.nv();}
  Index nx() const {return nq() + nv();}
  /// A row of the scratch, the first ones for the stages.
  Values slope(Index stage) const {return scratch_[stage].part(0, nx());}
  Values spare(Index number) const {return scratch_[run_.stages() + number];}

  /// Parts of an argument of the routines, or of a gradient.
  Values q_of(Values all) const {return all.part(0, nq());}
  Values qd_of(Values all) const {return all.part(nq(), nv());}
  Values tau_of(Values all) const {return all.part(nx(), nv());}
  Values parameters_of(Values all) const
  {
    return all.part(nx() + nv(), routines_.seed.size - nx() - nv());
  }

  /// Call the routines of accelerations in a state that was evaluated.
  bool call_at(Index which, Values stage) const
  {
    copy(stage.part(system_.ns(), nv()), routines_.qdd);
    copy(stage.from(system_.ns() + nv()), routines_.lam);
    return call(routines_.table, which, system_.q(stage), system_.qd(stage));
  }

  /// Positions before each correction of a step, and the corrections.
  Values place(Index number) const {return spare(4 + number).part(0, nq());}
  Values correction(Index number) const
  {
    return spare(4 + MOST_POSITION_CORRECTIONS + number).part(0, nv());
  }

  /// Correct the positions of a step again; false where the elimination does not do.
  bool correct_again(Index step) const
  {
    const Values raw = tape_.raw[step];
    const Index count = tape_.corrections[step];
    const Manifold & manifold = system_.manifold;
    for (Index n = 0; n < count; ++n) {
      copy(n == 0 ? raw : place(n - 1), place(n));
      if (n == 0) {
        normalise(manifold, place(n));
      } else {
        move(manifold, place(n), correction(n - 1), 1.0);
      }
      // The last one is needed where displacements are no numbers that are added.
      if (n < count - 1 || !manifold.empty()) {
        if (!call(system_.table, routine::CORRECTION, place(n), system_.qd(raw))) {
          return false;
        }
        copy(system_.corrections[0], correction(n));
      }
    }
    return true;
  }

  const System & system_;
  const SteppedRun & run_;
  Table scratch_;
  const Tape & tape_;
  const StepRoutines & routines_;
  /// Whether states are corrected after steps.
  bool closes_;
};

/// Changes in one direction, from step to step.
class Forward : TapeReplay
{
public:
  Forward(
    const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
    const StepRoutines & routines, const RunInputs & change)
  : TapeReplay(system, run, scratch, tape, routines), given_(change), now_(spare(0).part(0, nx())),
    stage_(spare(1).part(0, nx()))
  {
    copy(change.start, now_);
  }

  Values now() const {return now_;}

  bool step(Index number)
  {
    const Values seed = routines_.seed;
    copy(given_.torque[number / run_.zero_order_hold], tau_of(seed));
    copy(given_.parameter, parameters_of(seed));
    const Tableau & method = run_.tableau;
    const double size = run_.step_size;
    const Table stages = tape_.stage[number];
    const bool made = method.steps() == 0 ? euler(stages[0]) : stages_of(method, size, stages);
    return made && stabilise_change(number);
  }

private:
  bool stages_of(const Tableau & method, double size, Table stages)
  {
    for (Index k = 0; k < method.steps(); ++k) {
      copy(now_, stage_);
      for (Index j = 0; j < k; ++j) {
        if (method.a(k, j) != 0.0) {
          add(slope(j), size * method.a(k, j), stage_);
        }
      }
      if (!slope_of(stages[k], stage_, slope(k))) {
        return false;
      }
    }
    for (Index k = 0; k < method.steps(); ++k) {
      add(slope(k), size * method.b[k], now_);
    }
    return true;
  }

  bool euler(Values stage)
  {
    if (!slope_of(stage, now_, slope(0))) {
      return false;
    }
    const Values rate = spare(2).part(0, nv());
    copy(system_.qd(stage), rate);
    add(stage.part(system_.ns(), nv()), run_.step_size, rate);
    add(qd_of(slope(0)), run_.step_size, qd_of(now_));
    change_of_move(
      system_.manifold, system_.q(stage), rate, run_.step_size, q_of(now_), qd_of(now_));
    return true;
  }

  bool slope_of(Values stage, Values change, Values out) const
  {
    copy(change, routines_.seed.part(0, nx()));
    if (!call_at(step_routine::ACCELERATION_FORWARD, stage)) {
      return false;
    }
    change_of_rates(
      system_.manifold, system_.q(stage), system_.qd(stage), q_of(change), qd_of(change),
      q_of(out));
    copy(routines_.result, qd_of(out));
    return true;
  }

  bool stabilise_change(Index number)
  {
    const Values raw = tape_.raw[number], seed = routines_.seed;
    const Manifold & manifold = system_.manifold;
    change_of_norm(manifold, system_.q(raw), q_of(now_));
    if (!closes_) {
      return true;
    }
    if (!correct_again(number)) {
      return false;
    }
    for (Index n = 0; n < tape_.corrections[number]; ++n) {
      copy(now_, seed.part(0, nx()));
      if (!call(routines_.table, step_routine::POSITION_FORWARD, place(n), system_.qd(raw))) {
        return false;
      }
      change_of_move(
        manifold, place(n), correction(n), 1.0, q_of(now_), routines_.result.part(0, nv()));
    }
    copy(now_, seed.part(0, nx()));
    const Values after = tape_.state[number + 1];
    if (!call(routines_.table, step_routine::RATE_FORWARD, system_.q(after), system_.qd(raw))) {
      return false;
    }
    add(routines_.result, 1.0, qd_of(now_));
    return true;
  }

  const RunInputs & given_;
  Values now_, stage_;
};

/// Weights in reverse, from step to step; those of several costs side by side in lanes.
class Reverse : TapeReplay
{
public:
  Reverse(
    const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
    const StepRoutines & routines, const RunInputs & gradient)
  : Reverse(system, run, scratch, tape, routines, {}, scratch, {}, gradient) {}
  /// In lanes, with scratch for these.
  Reverse(
    const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
    const StepRoutines & routines, const LaneRoutines & beside, Table wide, Values seed,
    const RunInputs & gradient)
  : TapeReplay(system, run, scratch, tape, routines), beside_(beside), wide_(wide), seed_(seed),
    gradient_(gradient), now_(gradient.start), lanes_(now_.size / nx()),
    before_(wide[run.stages()].part(0, now_.size))
  {
    now_.fill(0.0);
    gradient.torque.fill(0.0);
    gradient.parameter.fill(0.0);
  }

  Values now() const {return now_;}

  bool step(Index number)
  {
    if (!stabilise_weights(number)) {
      return false;
    }
    const Values of_torque = gradient_.torque[number / run_.zero_order_hold];
    const Table stages = tape_.stage[number];
    return run_.tableau.steps() == 0 ? euler(stages[0], of_torque) :
           stages_of(stages, of_torque);
  }

private:
  bool stages_of(Table stages, Values of_torque)
  {
    const Tableau & method = run_.tableau;
    const double size = run_.step_size;
    for (Index k = 0; k < method.steps(); ++k) {
      dense(weights(k)) = size * method.b[k] * dense(now_);
    }
    for (Index k = method.steps() - 1; k >= 0; --k) {
      const Values stage = stages[k], weight = weights(k);
      before_.fill(0.0);
      if (!accelerate(stage, rates_in(weight), before_, of_torque)) {
        return false;
      }
      weights_of_rates(
        system_.manifold, system_.q(stage), system_.qd(stage), places_in(weight),
        places_in(before_), rates_in(before_), lanes_);
      add(before_, 1.0, now_);
      for (Index j = 0; j < k; ++j) {
        if (method.a(k, j) != 0.0) {
          add(before_, size * method.a(k, j), weights(j));
        }
      }
    }
    return true;
  }

  /// Rows of the scratch in lanes, the first ones for the stages; and parts of what is in lanes.
  Values weights(Index row) const {return wide_[row].part(0, nx() * lanes_);}
  Values places_in(Values all) const {return all.part(0, nq() * lanes_);}
  Values rates_in(Values all) const {return all.part(nq() * lanes_, nv() * lanes_);}

  bool euler(Values stage, Values of_torque)
  {
    const double size = run_.step_size;
    const Values rate = spare(2).part(0, nv()), weight = rates_in(weights(0));
    copy(system_.qd(stage), rate);
    add(stage.part(system_.ns(), nv()), size, rate);
    weights_of_move(
      system_.manifold, system_.q(stage), rate, size, places_in(now_), rates_in(now_), lanes_);
    weight.fill(0.0);
    add(rates_in(now_), size, weight);
    return accelerate(stage, weight, now_, of_torque);
  }

  /// Call a routine in a state, of weights, and add its results.
  bool call_with(
    Index which, Values q, Values qd, Values weight, Values to, Values of_torque) const
  {
    if (lanes_ == 1) {
      copy(weight, routines_.seed.part(0, nv()));
      if (!call(routines_.table, which, q, qd)) {
        return false;
      }
      collect<1>(routines_.result, 0, to, of_torque);
      return true;
    }
    const Indices table = beside_.prepare(which, q, qd);
    for (Index first = 0; table.size > 0 && first < lanes_; first += LANES) {
      for (Index k = 0; k < nv(); ++k) {
        std::copy_n(&weight[k * lanes_ + first], LANES, &seed_[k * LANES]);
      }
      if (!call(table, 2 * which + 1, seed_, beside_.result)) {
        return false;
      }
      collect<LANES>(beside_.result, first, to, of_torque);
    }
    return table.size > 0;
  }

  /// Add the gradient of weighted accelerations.
  bool accelerate(Values stage, Values weight, Values to, Values of_torque) const
  {
    copy(stage.part(system_.ns(), nv()), routines_.qdd);
    copy(stage.from(system_.ns() + nv()), routines_.lam);
    return call_with(
      step_routine::ACCELERATION_REVERSE, system_.q(stage), system_.qd(stage), weight, to,
      of_torque);
  }

  /// Add the gradient of a weighted correction.
  bool correct(Index which, Values q, Values qd, Values weight) const
  {
    return call_with(which, q, qd, weight, now_, {});
  }

  /// Add the results of some lanes, from the first one on.
  template<int Count>
  void collect(Values found, Index first, Values to, Values of_torque) const
  {
    using Lanes = Eigen::Matrix<double, Count, Eigen::Dynamic>;
    const auto add_to = [&](Index number, Values sum) {
        Eigen::Map<Lanes, 0, Eigen::OuterStride<>>(
          sum.data + first, Count, sum.size / lanes_, Eigen::OuterStride<>(lanes_)) +=
          Eigen::Map<Lanes>(&found[number * Count], Count, sum.size / lanes_);
      };
    add_to(0, to);
    add_to(nx(), of_torque);
    add_to(nx() + nv(), gradient_.parameter);
  }

  bool stabilise_weights(Index number)
  {
    const Values raw = tape_.raw[number], qd = system_.qd(raw);
    const Manifold & manifold = system_.manifold;
    if (closes_) {
      const Values after = tape_.state[number + 1], weight = rates_in(weights(run_.stages() + 1));
      if (!correct_again(number) ||
        !correct(step_routine::RATE_REVERSE, system_.q(after), qd, rates_in(now_)))
      {
        return false;
      }
      for (Index n = tape_.corrections[number] - 1; n >= 0; --n) {
        weight.fill(0.0);
        weights_of_move(
          manifold, place(n), correction(n), 1.0, places_in(now_), weight, lanes_);
        if (!correct(step_routine::POSITION_REVERSE, place(n), qd, weight)) {
          return false;
        }
      }
    }
    change_of_norm(manifold, system_.q(raw), places_in(now_), lanes_);
    return true;
  }

  LaneRoutines beside_;
  Table wide_;
  Values seed_;
  const RunInputs & gradient_;
  Values now_;
  Index lanes_;
  Values before_;
};
}  // namespace

Indices LaneRoutines::prepare(Index which, Values q, Values qd) const
{
  for (Index n = 0; n < table.size; n += step_routine::STEP_COLUMNS) {
    const Indices one = table.part(n, step_routine::STEP_COLUMNS);
    if (call(one, 2 * which, q, qd)) {
      return one;
    }
  }
  return {};
}

void check(const System & system, const SteppedRun & run, const Tape & tape)
{
  if (!(fits(run.tableau) && run.stages() == tape.stage.rows && system.is_unrolled() &&
    !system.is_independent() && (run.stabilisation == Stabilisation::NONE ||
    run.stabilisation == Stabilisation::VELOCITY ||
    run.stabilisation == Stabilisation::PROJECTION)))
  {
    throw std::invalid_argument(
            "expected a run by steps of one size, of a system with routines of its own, and its tape");
  }
}

std::pair<Status, Index> record_steps(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape)
{
  check(system, run, tape);
  const Index ns = system.ns(), nv = system.nv(), stages = run.stages();
  const Values out = scratch[stages];
  Interrupt interrupt(system.interrupted, nv);
  for (Index done = 0; done < tape.steps(); ++done) {
    const Values state = tape.state[done];
    const Table evaluated = tape.stage[done];
    copy(run.torque[done / run.zero_order_hold], system.tau);
    const bool begins = step(
      run.tableau, system.manifold, nv, state, run.step_size, scratch, scratch[stages + 1], out,
      [&](Index k, Values at, Values slope) {
        copy(at, evaluated[k].part(0, ns));
        derivative_with_multipliers(system, at, slope);
        copy(system.qdd, evaluated[k].part(ns, nv));
        copy(system.lam, evaluated[k].from(ns + nv));
        return done + k > 0 || closes_loops(system, system.qd(at));
      });
    if (!begins) {
      return {Status::OPEN_LOOP, -1};
    }
    copy(out, tape.raw[done]);
    const bool closed = stabilise(system, run.stabilisation, out);
    tape.corrections[done] = run.stabilisation == Stabilisation::PROJECTION ?
      static_cast<Index>(system.work.health[health::PROJECTION_ITERATIONS]) : 0;
    if (!all_finite(out)) {
      return {Status::NOT_FINITE, done};
    }
    if (!closed) {
      return {Status::OPEN_LOOP, done};
    }
    if (!equations_suffice(system, run.stabilisation, out)) {
      return {Status::POOR_EQUATIONS, done};
    }
    copy(out, tape.state[done + 1]);
    if (interrupt.after(1 + stages)) {
      return {Status::INTERRUPTED, done};
    }
  }
  return {Status::DONE, tape.steps()};
}

std::pair<Status, Index> change_of_steps(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
  const StepRoutines & routines, const RunInputs & change, Table out)
{
  check(system, run, tape);
  Forward walk(system, run, scratch, tape, routines, change);
  Interrupt interrupt(system.interrupted, system.nv());
  copy(walk.now(), out[0]);
  for (Index done = 0; done < tape.steps(); ++done) {
    if (!walk.step(done)) {
      return {Status::SINGULAR, done};
    }
    if ((done + 1) % run.decimation == 0) {
      copy(walk.now(), out[(done + 1) / run.decimation]);
    }
    if (interrupt.after(2 * (1 + run.stages()))) {
      return {Status::INTERRUPTED, done};
    }
  }
  return {Status::DONE, tape.steps()};
}

std::pair<Status, Index> gradient_of_steps(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
  const StepRoutines & routines, Table weight, const RunInputs & gradient)
{
  check(system, run, tape);
  Reverse walk(system, run, scratch, tape, routines, gradient);
  Interrupt interrupt(system.interrupted, system.nv());
  for (Index left = tape.steps(); left > 0; --left) {
    if (left % run.decimation == 0) {
      add(weight[left / run.decimation], 1.0, walk.now());
    }
    if (!walk.step(left - 1)) {
      return {Status::SINGULAR, left - 1};
    }
    if (interrupt.after(2 * (1 + run.stages()))) {
      return {Status::INTERRUPTED, left - 1};
    }
  }
  add(weight[0], 1.0, walk.now());
  return {Status::DONE, tape.steps()};
}

bool gradients_in_lanes(
  const System & system, const SteppedRun & run, Table scratch, Table wide, Values seed,
  const Tape & tape, const StepRoutines & routines, const LaneRoutines & beside, Values weight,
  const RunInputs & gradients)
{
  Reverse walk(system, run, scratch, tape, routines, beside, wide, seed, gradients);
  copy(weight, walk.now());
  for (Index left = tape.steps(); left > 0; --left) {
    if (!walk.step(left - 1)) {
      return false;
    }
  }
  return true;
}

}  // namespace closedloop
