// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "batch.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "interrupt.hpp"
#include "lane_events.hpp"
#include "manifold.hpp"
#include "projection.hpp"
#include "routines.hpp"
#include "scratch.hpp"

namespace closedloop
{

namespace
{
// As of projection.cpp.
constexpr int MOST_CORRECTIONS = 8;
// Share of the closure error that ends a run below which a lane needs no closer check.
constexpr double CLEARLY = 0.5;

/// Time derivatives of all lanes, those of coordinates if requested; return whether the results are
/// good.
bool batch_derivative(
  const Batch & batch, LaneEvents & events, Values state, bool of_coordinates, Values out)
{
  const Index n = batch.qdd.size, first = LANES * batch.nq();
  const bool good =
    call(batch.table, events.routine(), state.part(0, first), state.part(first, n));
  events.hold_joints();
  if (of_coordinates) {
    rates_of_coordinates(batch.manifold, state, batch.nv(), out, LANES);
  }
  copy(batch.qdd, out.part(first, n));
  copy(batch.rates, out.part(first + n, batch.rates.size));
  power_of_turns(batch.manifold, batch.tau, state, batch.nv(), out, LANES);
  return good;
}

/// Largest closure error of every lane; guards have excluded NaN.
void measure_errors(Values closure, Values error)
{
  error.fill(0.0);
  for (Index k = 0; k < closure.size / LANES; ++k) {
    for (Index lane = 0; lane < LANES; ++lane) {
      error[lane] = std::max(error[lane], std::abs(closure[LANES * k + lane]));
    }
  }
}

/// Correct the coordinates of the lanes that want it.
void correct_coordinates(
  const Manifold & manifold, Values q, Values change, const bool (&moving)[LANES])
{
  if (!manifold.empty()) {
    for (Index lane = 0; lane < LANES; ++lane) {
      if (moving[lane]) {
        move_lane(manifold, q, change, 1.0, LANES, lane);
      }
    }
    return;
  }
  for (Index k = 0; k < q.size / LANES; ++k) {
    for (Index lane = 0; lane < LANES; ++lane) {
      const Index i = LANES * k + lane;
      q[i] = moving[lane] ? q[i] + change[i] : q[i];
    }
  }
}

/// Correct rates, and positions if requested, in every lane, as projection.cpp does in one.
Status project(const Batch & batch, Values q, Values qd, bool positions)
{
  const Values & error = batch.error, & tolerance = batch.tolerance;
  bool moving[LANES];
  bool busy = false;
  if (!call(batch.table, routine::CORRECTION, q, qd)) {
    return Status::SINGULAR;
  }
  measure_errors(batch.closure, error);
  for (Index lane = 0; lane < LANES; ++lane) {
    moving[lane] = positions && error[lane] > tolerance[lane];
    busy = busy || moving[lane];
  }
  for (int n = 0; n < MOST_CORRECTIONS && busy; ++n) {
    correct_coordinates(batch.manifold, q, batch.corrections[0], moving);
    if (!call(batch.table, routine::CORRECTION, q, qd)) {
      return Status::SINGULAR;
    }
    double before[LANES];
    std::copy(error.begin(), error.end(), before);
    measure_errors(batch.closure, error);
    busy = false;
    for (Index lane = 0; lane < LANES; ++lane) {
      moving[lane] =
        moving[lane] && error[lane] < 0.5 * before[lane] && error[lane] > tolerance[lane];
      busy = busy || moving[lane];
    }
  }
  for (Index i = 0; i < qd.size; ++i) {
    qd[i] += batch.corrections(1, i);
  }
  for (Index lane = 0; lane < LANES; ++lane) {
    if (positions && !(error[lane] <= batch.limit[lane])) {
      return Status::OPEN_LOOP;
    }
  }
  return Status::DONE;
}

/// Record one instant.
void record(Values state, Cube<double> position, Cube<double> velocity, Index instant)
{
  const Index nq = position.columns;
  for (Index lane = 0; lane < LANES; ++lane) {
    const double * from = state.data + lane;
    double * const q = position[lane].row(instant), * const qd = velocity[lane].row(instant);
    for (Index k = 0; k < nq; ++k, from += LANES) {
      q[k] = *from;
    }
    for (Index k = 0; k < velocity.columns; ++k, from += LANES) {
      qd[k] = *from;
    }
  }
}
/// Guards of the lanes, each with its own memory.
class GuardedLanes
{
public:
  GuardedLanes(
    const Batch & batch, const std::vector<Lane> & lanes, Values state, Indices status)
  : batch_(batch), lanes_(lanes), status_(status)
  {
    status_.fill(static_cast<Index>(Status::DONE));
    for (const Lane & lane : lanes) {
      runs_.push_back(*lane.run);
      states_.emplace_back(static_cast<std::size_t>(lane.system->ns()));
      load(state, runs_.size() - 1);
      runs_.back().begin_copy(*lane.system, view(states_.back()));
    }
  }
  /// Check all lanes after so many steps, and the work of their torques up to then.
  void check(Values state, const double (&work)[LANES], Index done, bool at_energy)
  {
    const Index first = LANES * batch_.nq();
    const bool known = at_energy && batch_.table[routine::ENERGIES] != 0 && call(
      batch_.table, routine::ENERGIES, state.part(0, first), state.from(first));
    for (std::size_t lane = 0; lane < runs_.size(); ++lane) {
      const System & system = *lanes_[lane].system;
      const double * energy = batch_.energies.data + lane;
      const Stored stored = known ?
        Stored{energy[0], energy[LANES], energy[2 * LANES]} : Stored{};
      if (status_[lane] != static_cast<Index>(Status::DONE)) {
        continue;
      }
      load(state, lane);
      const Outcome found = runs_[lane].check_state(
        system, view(states_[lane]), done, work[lane], known ? &stored : nullptr, at_energy);
      if (found != Outcome::DONE && found != Outcome::INACCURATE) {
        status_[lane] = static_cast<Index>(Status::DOUBTFUL);
      }
    }
  }
  void report(Table found) const
  {
    for (std::size_t lane = 0; lane < runs_.size(); ++lane) {
      runs_[lane].write_finding(found[lane]);
    }
  }

private:
  /// Copy the state of a lane to its run.
  void load(Values state, std::size_t lane)
  {
    const double * from = state.data + lane;
    for (double & each : states_[lane]) {
      each = *from;
      from += LANES;
    }
  }

  const Batch & batch_;
  const std::vector<Lane> & lanes_;
  Indices status_;
  std::vector<Run> runs_;
  std::vector<std::vector<double>> states_;
};

/// Whether the generated routines are there and work on these very arrays.
bool is_linked(const Batch & batch)
{
  const auto is_at = [&](Index place, Values array) {
      return array.size == 0 || batch.table[place] == reinterpret_cast<Index>(array.data);
    };
  return batch.table.size == routine::TABLE_COLUMNS && batch.table[batch.evaluation()] != 0 &&
         batch.table[routine::CORRECTION] != 0 && is_at(routine::TAU, batch.tau) &&
         is_at(routine::RATES, batch.rates) && is_at(routine::GAPS, batch.gaps) &&
         is_at(routine::TRIALS, batch.trials) && is_at(routine::RESPONSE, batch.response) &&
         is_at(routine::LIMIT, batch.friction) &&
         (batch.rates.size + batch.gaps.size == 0 || is_at(routine::COMMAND, batch.tau)) &&
         is_at(routine::QDD, batch.qdd) && is_at(routine::CLOSURE, batch.closure) &&
         is_at(routine::CORRECTIONS, batch.corrections.all()) &&
         (batch.table[routine::ENERGIES] == 0 || batch.energies.size > 0) &&
         is_at(routine::ENERGY, batch.energies);
}

bool fits(const Batch & batch)
{
  const Index nv = batch.nv(), width = LANES * nv;
  return width > 0 && is_linked(batch) && batch.qdd.size == width && batch.tau.size == width &&
         batch.closure.size % LANES == 0 && batch.corrections.rows == 2 &&
         batch.corrections.columns == width && batch.tolerance.size == LANES &&
         batch.limit.size == LANES && batch.error.size == LANES &&
         batch.rates.size % LANES == 0 &&
         (batch.energies.size == 0 || batch.energies.size == 3 * LANES) && batch.manifold.fits(batch.nq(), nv);
}

bool lists(const EffectTable & effects, Index role)
{
  return std::find(effects.role.begin(), effects.role.end(), role) != effects.role.end();
}

bool same(Indices one, Indices other)
{
  return std::equal(one.begin(), one.end(), other.begin(), other.end());
}

bool fits(const Batch & batch, const Lane & lane, const Lane & first)
{
  return lane.system != nullptr && lane.system->nv() == batch.nv() &&
         lane.system->nq() == batch.nq() && lane.run != nullptr && lane.run->fits(*lane.system) &&
         LANES * lane.system->effects.states.size == batch.rates.size &&
         LANES * contact::NODE_COLUMNS * lane.system->effects.count() == batch.gaps.size &&
         LANES * contact::TRIAL_COLUMNS * lane.system->effects.count() == batch.trials.size &&
         LANES * lane.system->effects.static_friction.right.size == batch.friction.size &&
         batch.friction.size / LANES * (batch.qdd.size + batch.closure.size) ==
         batch.response.size &&
         same(lane.system->effects.role, first.system->effects.role) &&
         same(lane.system->effects.places, first.system->effects.places) &&
         (batch.table[routine::AT_REST] != 0 ||
         !lists(lane.system->effects, effect::FRICTION)) &&
         lane.system->tau.size == batch.nv() && lane.run->stepper().is_in_lanes() &&
         lane.run->stepper().stabilisation() == first.run->stepper().stabilisation() &&
         lane.run->guard_limits().step_size == first.run->guard_limits().step_size;
}
}  // namespace

Status run_batch(
  const Batch & batch, const std::vector<Lane> & lanes, Values state, Table torque,
  Index zero_order_hold, Index decimation, Index steps, Cube<double> position,
  Cube<double> velocity, Indices status, Table found)
{
  const Index count = static_cast<Index>(lanes.size());
  if (count < 1 || count > LANES || !fits(batch) || !std::all_of(
      lanes.begin(), lanes.end(), [&](const Lane & lane) {return fits(batch, lane, lanes[0]);}))
  {
    throw std::invalid_argument("run_batch: lanes that do not fit together");
  }
  for (const Lane & lane : lanes) {
    lane.system->latest->forget();
  }
  const Run & like = *lanes[0].run;
  const Tableau tableau = like.stepper().tableau();
  const Stabilisation stabilisation = like.stepper().stabilisation();
  const GuardLimits & limits = like.guard_limits();
  const double step_size = limits.step_size;
  const Index n = batch.qdd.size, first = LANES * batch.nq();
  const Index ns = lanes[0].system->ns();
  const auto has_rows = [&](Cube<double> rows, Index columns) {
      return rows.pages == LANES && rows.rows == steps / decimation + 1 &&
             rows.columns == columns;
    };
  if (zero_order_hold < 1 || decimation < 1 || steps < 0 || state.size != LANES * ns ||
    torque.columns != n || torque.rows < 1 ||
    (steps > 0 && torque.rows <= (steps - 1) / zero_order_hold) ||
    !has_rows(position, batch.nq()) || !has_rows(velocity, batch.nv()) ||
    status.size != count || found.rows != count || found.columns != finding::COLUMNS)
  {
    throw std::invalid_argument("run_batch: arrays that do not fit together");
  }
  Interrupt interrupt(lanes[0].system->interrupted, n);
  const OwnedTable memory(std::max<Index>(tableau.a.rows, 1) + 3, state.size);
  const Table scratch = memory.view();
  const Values stage = scratch[0], out = scratch[1], since = scratch[2];
  const Table slopes = scratch.from(3);
  double worked[LANES] = {};
  const auto add_work_since = [&] {
      add_work(batch.manifold, batch.tau, since, state, LANES, {worked, LANES});
      copy(state, since);
    };
  LaneEvents events(batch, lanes);
  GuardedLanes guarded(batch, lanes, state, status);
  const auto check = [&](Index done, bool at_energy) {
      add_work_since();
      guarded.check(state, worked, done, at_energy);
    };
  // Corrections of the rates have measured the loops of the states that they were made in.
  const bool measures =
    stabilisation == Stabilisation::VELOCITY && !lanes[0].system->has_effects();
  const auto are_closed = [&] {
      return measures && std::all_of(
        batch.error.begin(), batch.error.end(),
        [&](double error) {return error <= CLEARLY * limits.closure;});
    };
  const auto step_together = [&](Values from) {
      const bool good = closedloop::step(
        tableau, batch.manifold, batch.nv(), from, step_size, slopes, stage, out,
        [&](Index k, Values at, Values slope) {
          const bool found = batch_derivative(batch, events, at, tableau.steps() > 0, slope);
          if (k == 0 && found) {
            events.store_start();
          }
          return found;
        }, LANES);
      if (!good) {
        return Status::SINGULAR;
      }
      normalise(batch.manifold, out, LANES);
      if (stabilisation >= Stabilisation::VELOCITY) {
        const Status closed = project(
          batch, out.part(0, first), out.part(first, n),
          stabilisation == Stabilisation::PROJECTION);
        if (closed != Status::DONE) {
          return closed;
        }
      }
      events.find(from, out, step_size);
      return Status::DONE;
    };
  const auto step = [&] {
      const Values from = events.begin(state);
      Status made = from.size == 0 ? Status::DONE : step_together(from);
      made = made == Status::DONE ? events.make(state, out, step_size) : made;
      if (made != Status::DONE) {
        return made;
      }
      if (interrupt.after(1 + tableau.steps())) {
        return Status::INTERRUPTED;
      }
      if (!all_finite(out)) {
        return Status::NOT_FINITE;
      }
      copy(out, state);
      return Status::DONE;
    };
  record(state, position, velocity, 0);
  copy(state, since);
  Index unchecked = 0, between = limits.first;
  for (Index done = 0; done < steps; ) {
    if (done % zero_order_hold == 0) {
      add_work_since();
      copy(torque[done / zero_order_hold], batch.tau);
    }
    // As one call of a simulation.
    const Index at_once = std::min(
      {zero_order_hold - done % zero_order_hold, decimation - done % decimation, steps - done});
    for (Index left = at_once; left > 0; ) {
      const Index portion = std::min({left, limits.most, between - unchecked});
      for (Index made = 0; made < portion; ++made) {
        const Status ended = step();
        if (ended != Status::DONE) {
          return ended;
        }
      }
      left -= portion;
      done += portion;
      unchecked += portion;
      const bool at_energy = unchecked >= between;
      if (at_energy) {
        between = std::max(std::min(2 * between, limits.rarely), limits.first);
        unchecked = 0;
      }
      if (at_energy || !(std::isinf(limits.closure) || are_closed())) {
        check(done, at_energy);
      }
    }
    if (unchecked > 0 && (at_once >= limits.call || done == steps)) {
      unchecked = 0;
      check(done, true);
    }
    if (done % decimation == 0) {
      record(state, position, velocity, done / decimation);
    }
  }
  guarded.report(found);
  return Status::DONE;
}

}  // namespace closedloop
