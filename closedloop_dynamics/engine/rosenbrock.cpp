// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "rosenbrock.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "batch.hpp"
#include "contact_events.hpp"
#include "evaluation.hpp"
#include "fixed_steps.hpp"
#include "left_out.hpp"
#include "lu.hpp"
#include "manifold.hpp"
#include "projection.hpp"
#include "routines.hpp"
#include "scene_code.hpp"
#include "stick_slip.hpp"
#include "time_events.hpp"

namespace closedloop
{

namespace
{
constexpr Index STAGES = 6;
// Rows of the scratch.
enum : Index {STAGE, OUT, SLOPE, MOVED, DIRECTION, START, FIRST_SLOPE};
constexpr double GAMMA = 0.25;
constexpr double A[STAGES][STAGES - 1] = {
  {0.0, 0.0, 0.0, 0.0, 0.0},
  {1.544, 0.0, 0.0, 0.0, 0.0},
  {0.9466785280815826, 0.2557011698983284, 0.0, 0.0, 0.0},
  {3.314825187068521, 2.896124015972201, 0.9986419139977817, 0.0, 0.0},
  {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 0.0},
  {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0}};
constexpr double C[STAGES][STAGES - 1] = {
  {0.0, 0.0, 0.0, 0.0, 0.0},
  {-5.6688, 0.0, 0.0, 0.0, 0.0},
  {-2.430093356833875, -0.2063599157091915, 0.0, 0.0, 0.0},
  {-0.1073529058151375, -9.594562251023355, -20.47028614809616, 0.0, 0.0},
  {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160, 0.0},
  {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136,
    -6.058818238834054}};
// Step of the finite differences, relative to a state of size 1: half the digits each for
// truncation and rounding.
constexpr double DIFFERENCE = 1.5e-8;

/// Multiply a direction, shape (ns,), by a matrix twice; return the root of the growth of its
/// length: of a conjugate pair of eigenvalues two products show the magnitude.
double fastest_rate(Table matrix, Values direction, Values once, Values twice)
{
  const Index n = direction.size;
  double length = 0.0;
  for (double each : direction) {
    length += each * each;
  }
  for (Index i = 0; i < n; ++i) {
    // Any direction that is not an eigenvector to begin with.
    direction[i] = length > 0.0 ?
      direction[i] / std::sqrt(length) : std::cos(static_cast<double>(i * i) + 1.0);
  }
  for (Index i = 0; i < n; ++i) {
    once[i] = 0.0;
    for (Index j = 0; j < n; ++j) {
      once[i] += matrix(i, j) * direction[j];
    }
  }
  length = 0.0;
  for (Index i = 0; i < n; ++i) {
    twice[i] = 0.0;
    for (Index j = 0; j < n; ++j) {
      twice[i] += matrix(i, j) * once[j];
    }
    length += twice[i] * twice[i];
  }
  for (Index i = 0; i < n; ++i) {
    direction[i] = length > 0.0 && std::isfinite(length) ? twice[i] : 0.0;
  }
  return std::pow(length, 0.25);
}

/// Fill in -J at a state by generated code; return whether that is there, and good in this state.
bool differentiate(const System & system, Values state, Values moved, Table matrix)
{
  const AccelerationDerivatives & code = system.derivatives;
  const Index nv = system.nv(), columns = 2 * nv;
  // Each number of a quaternion is a state.
  if (code.empty() || !system.manifold.empty() || system.is_independent() ||
    system.settings->baumgarte_gain != 0.0)
  {
    return false;
  }
  // The code works on accelerations and multipliers of this state.
  derivative_with_multipliers(system, state, moved);
  if (system.has_effects()) {
    store_sides(system.effects);
  }
  // Derivatives by torques, in the last columns, are not part of it.
  const Index blocks = (columns + LANES - 1) / LANES;
  if (!call_for_columns(
      code.table, system.q(state), system.qd(state),
      {code.columns.data, blocks, code.columns.columns},
      {code.found.data, blocks, code.found.columns}))
  {
    return false;
  }
  for (Index i = 0; i < nv; ++i) {
    for (Index j = 0; j < columns; ++j) {
      const double found = code.found(j / LANES, LANES * i + j % LANES);
      if (!std::isfinite(found)) {
        return false;
      }
      matrix(i, j) = j == nv + i ? -1.0 : 0.0;
      matrix(nv + i, j) = -found;
    }
  }
  // No rate depends on the effects' states: these are energies that are gained or lost.
  for (Index i = 0; i < state.size; ++i) {
    for (Index j = i < columns ? columns : 0; j < state.size; ++j) {
      matrix(i, j) = j < columns ? -code.flows(j, i - columns) : 0.0;
    }
  }
  return true;
}

/// Rate and cost of a factored Jacobian.
struct Factored
{
  double rate;  ///< Fastest rate of the motion [1/s]
  Index evaluations;  ///< Evaluations spent on it
};

/// Factor I / (h gamma) - J at a state; empty where interrupted.
std::optional<Factored> factor_jacobian(
  const System & system, Values state, double step_size, Table matrix, Indices pivots,
  Table scratch, Interrupt & interrupt)
{
  const Values stage = scratch[STAGE], slope = scratch[SLOPE], moved = scratch[MOVED];
  const Index n = state.size;
  copy(state, stage);
  const bool generated = differentiate(system, state, moved, matrix);
  for (Index j = 0; !generated && j < n; ++j) {
    stage[j] = state[j] + DIFFERENCE * std::max(1.0, std::abs(state[j]));
    // The change that the rounded sum really made.
    const double change = stage[j] - state[j];
    derivative(system, stage, moved);
    stage[j] = state[j];
    if (interrupt.after(1)) {
      return std::nullopt;
    }
    for (Index i = 0; i < n; ++i) {
      matrix(i, j) = (slope[i] - moved[i]) / change;
    }
  }
  const double rate = fastest_rate(matrix, scratch[DIRECTION], stage, moved);
  for (Index i = 0; i < n; ++i) {
    matrix(i, i) += 1.0 / (step_size * GAMMA);
  }
  factorize(matrix, pivots);
  return Factored{rate, generated ? 1 : n};
}

/// Make one step with a factored Jacobian into OUT; the last of the slopes is the error estimate.
void stiff_step(
  const System & system, Values state, double step_size, Table matrix, Indices pivots,
  Table scratch)
{
  const Values stage = scratch[STAGE], out = scratch[OUT];
  const Table slopes = scratch.from(FIRST_SLOPE);
  const Index n = state.size;
  for (Index k = 0; k < STAGES; ++k) {
    copy(state, stage);
    for (Index m = 0; m < k; ++m) {
      for (Index i = 0; i < n; ++i) {
        stage[i] += A[k][m] * slopes(m, i);
      }
    }
    derivative(system, stage, slopes[k]);
    for (Index m = 0; m < k; ++m) {
      for (Index i = 0; i < n; ++i) {
        slopes(k, i) += C[k][m] / step_size * slopes(m, i);
      }
    }
    solve(matrix, pivots, slopes[k]);
  }
  for (Index i = 0; i < n; ++i) {
    out[i] = stage[i] + slopes(STAGES - 1, i);
  }
}

/// State within a step by the cubic through both states and their slopes `slope` and `end`.
void interpolate_cubic(
  Values state, Values slope, Values out, Values end, double size, double share, Values stage)
{
  const double left = 1.0 - share;
  for (Index i = 0; i < state.size; ++i) {
    const double rise = out[i] - state[i];
    stage[i] = left * state[i] + share * out[i] + share * left * (
      left * (size * slope[i] - rise) + share * (rise - size * end[i]));
  }
}
}  // namespace

std::pair<Status, Index> FixedStiffSteps::make(
  const System & system, Values state, double step_size, Index steps)
{
  const auto [matrix, pivots, rows] = memory_.view();
  return make_steps_in_parts(
    system, stabilisation(), state, step_size, steps,
    {rows[SLOPE], rows[OUT], rows[START], rows[STAGE]}, STAGES + 1,
    [&, matrix = matrix, pivots = pivots, rows = rows](double size, Interrupt & interrupt) {
      if (!factor_jacobian(system, state, size, matrix, pivots, rows, interrupt)) {
        return false;
      }
      stiff_step(system, state, size, matrix, pivots, rows);
      return true;
    });
}

StiffSteps::StiffSteps(const System & system, const MethodOptions & options)
: StepperOf(system, options.stabilisation), tolerance_(options.tolerance), scale_(2, system.ns()),
  memory_(system.ns())
{
  fill_scale(system, tolerance_, scale_.view());
}

Advance StiffSteps::advance(const System & system, Values state, const Grid & grid)
{
  StepControl & control = control_;
  if (!std::exchange(continues_, false)) {
    control.reached = grid.start();
  }
  const StiffStep run{stabilisation(), control, scale_.view(), memory_.view()};
  Interrupt interrupt(system.interrupted, system.nv());
  const double target = grid.target();
  const Status status = make_steps_to(
    grid, system.work.health, control, [&] {return run.make(system, state, target, interrupt);});
  return {status, status == Status::DONE ? static_cast<double>(grid.steps) * grid.step_size :
    control.reached - grid.start()};
}

void StiffSteps::restart(const System & system, bool)
{
  control_.next_step = 0.0;
  follow_effects(system, tolerance_, scale_.view());
}

void StiffSteps::rewind(const System & system)
{
  control_ = {};
  memory_.view().rows.fill(0.0);
  restart(system, true);
}

Status StiffStep::make(
  const System & system, Values state, double limit, Interrupt & interrupt) const
{
  const auto & [matrix, pivots, rows] = scratch;
  const Values stage = rows[STAGE], out = rows[OUT], slope = rows[SLOPE], moved = rows[MOVED];
  const Table slopes = rows.from(FIRST_SLOPE);
  const Index n = state.size;
  const double rest = limit - control.reached;
  const double least = LEAST * std::max(std::abs(limit), 1e-3);
  // A smaller step, at whose end a joint under dry friction comes to rest, or a force over time
  // has a corner.
  double cut = time_to_corner(system, state);
  double size = control.next_step > 0.0 ? control.next_step : 1e-4;
  derivative(system, state, slope);
  if (!all_finite(slope)) {
    return Status::NOT_FINITE;
  }
  if (freeze_modes(system)) {
    // As in error_control.cpp: the slope of the side on which the step begins.
    derivative(system, state, slope);
  }
  ContactSearch contacts;
  bool closed = true, last = false;
  int cuts = 0;
  double error = 0.0, factor = 1.0, rate = 0.0, used = 0.0;
  while (true) {
    const double whole = std::min(size, rest);
    last = size >= rest && !(cut < whole);
    used = std::min(whole, cut);
    if (!(used > least)) {
      release_modes(system);
      return closed ? Status::STEP_TOO_SMALL : Status::OPEN_LOOP;
    }
    const std::optional<Factored> factored = interrupt.after(STAGES + 1) ? std::nullopt :
      factor_jacobian(system, state, used, matrix, pivots, rows, interrupt);
    if (!factored) {
      release_modes(system);
      return Status::INTERRUPTED;
    }
    rate = factored->rate;
    stiff_step(system, state, used, matrix, pivots, rows);
    control.work += static_cast<double>(factored->evaluations + STAGES + 1 + n / 8);
    double total = 0.0;
    for (Index i = 0; i < n; ++i) {
      const double each = slopes(STAGES - 1, i) / (
        scale(0, i) + scale(1, i) * std::max(std::abs(state[i]), std::abs(out[i])));
      total += each * each;
    }
    error = std::sqrt(total / static_cast<double>(std::max<Index>(n, 1)));
    factor = error < 1e30 ? SAFETY * std::pow(std::max(error, 1e-10), -0.25) : 0.0;
    factor = std::min(6.0, std::max(0.2, factor));
    // Written so that a NaN counts as an error too large.
    if (error <= 1.0 && stabilise(system, stabilisation, out)) {
      bool ended = false;
      const auto state_at = [&](double share) {
          if (!ended) {
            derivative(system, out, moved);
            ended = true;
          }
          interpolate_cubic(state, slope, out, moved, used, share, stage);
          normalise(system.manifold, stage);
          return stage;
        };
      double part = locate_stick_event(
        system, state, out, used, std::max(least_part(whole, cuts), least), state_at);
      if (!(part < used)) {
        part = contacts.part(system, out, used, state_at);
        forget_rates(system);
        if (part == used) {
          break;
        }
        part = contacts.sought >= -1 ? part : used;
      } else {
        forget_trials(system);
        contacts.sought = -1;
      }
      cut = part;
      ++cuts;
      continue;
    }
    closed = !(error <= 1.0);
    contacts.sought = -1;
    forget_trials(system);
    control.rejected += 1.0;
    size = used * (closed ? std::min(factor, SAFETY) : 0.5);
  }
  release_modes(system);
  if (!equations_suffice(system, stabilisation, out)) {
    return Status::POOR_EQUATIONS;
  }
  update_friction_modes(system, out);
  if (system.has_effects()) {
    handle_time_events(system.effects, out.from(system.own()));
  }
  copy(out, state);
  control.reached = last ? limit : control.reached + used;
  control.accepted += 1.0;
  control.error = error;
  control.largest_error = std::max(control.largest_error, error);
  control.stiffness = rate;
  // A step cut short is no reason to reduce the size to try next.
  const bool shortened = last || cuts > 0 || cut <= used;
  control.next_step = shortened ? std::max(size, used * factor) : used * factor;
  return Status::DONE;
}

}  // namespace closedloop
