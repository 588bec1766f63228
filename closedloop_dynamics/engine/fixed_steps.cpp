// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "fixed_steps.hpp"

#include <limits>

#include "manifold.hpp"
#include "time_events.hpp"

namespace closedloop
{

namespace
{
// Parts of a step smaller than this share of it are rounding.
constexpr double LEAST_PART = 1e-12;
}  // namespace

void interpolate_parabola(
  const System & system, Values state, Values slope, Values out, double size, double share,
  Values between)
{
  for (Index i = 0; i < state.size; ++i) {
    const double along = size * slope[i];
    between[i] = state[i] + share * (along + share * (out[i] - state[i] - along));
  }
  normalise(system.manifold, between);
}

double time_to_corner(const System & system, Values state)
{
  return system.has_effects() ? time_to_next_corner(
    system.effects, state.from(system.own())) : std::numeric_limits<double>::infinity();
}

void StepSplit::accept(const System & system, Values state, Values out)
{
  update_friction_modes(system, out);
  if (system.has_effects()) {
    handle_time_events(system.effects, out.from(system.own()));
  }
  copy(out, state);
  left -= size;
  if (left <= LEAST_PART * whole) {
    left = 0.0;
  }
  size = left;
}

FixedSteps::FixedSteps(const System & system, const MethodOptions & options)
: StepsOfOneSize(system, options.stabilisation), tableau_(options.tableau),
  scratch_(std::max<Index>(options.tableau.a.rows, 1) + 3, system.ns()) {}

std::pair<Status, Index> FixedSteps::make(
  const System & system, Values state, double step_size, Index steps)
{
  const Table scratch = scratch_.view();
  const Values stage = scratch[0], out = scratch[1], start = scratch[2];
  const Table slopes = scratch.from(3);
  const Tableau tableau = tableau_.view();
  return make_steps_in_parts(
    system, stabilisation(), state, step_size, steps, {slopes[0], out, start, stage},
    1 + tableau.steps(), [&](double size, Interrupt &) {
      step(system, tableau, state, size, slopes, stage, out);
      return true;
    });
}

}  // namespace closedloop
