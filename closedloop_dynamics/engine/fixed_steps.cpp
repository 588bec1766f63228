// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "fixed_steps.hpp"

#include <algorithm>

#include "contact_events.hpp"
#include "evaluation.hpp"
#include "left_out.hpp"
#include "manifold.hpp"
#include "projection.hpp"
#include "stick_slip.hpp"
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

bool Parts::shorten(const System & system, Values state, Values out)
{
  const double part =
    locate_stick_event(system, state, out, size, least_part(whole, cuts));
  if (!(part < size)) {
    return false;
  }
  size = part;
  ++cuts;
  return true;
}

void Parts::accept(const System & system, Values state, Values out)
{
  update_friction_modes(system, out);
  if (system.has_effects()) {
    pass_corners(system.effects, out.from(system.own()));
  }
  copy(out, state);
  left -= size;
  if (left <= LEAST_PART * whole) {
    left = 0.0;
  }
  size = left;
}

std::pair<Status, Index> advance_fixed(
  const System & system, const Tableau & tableau, Stabilisation stabilisation, Table scratch,
  Values state, double step_size, Index steps)
{
  Interrupt interrupt(system.interrupted);
  return make_fixed_steps(
    system, tableau, stabilisation, state, step_size, steps, scratch, interrupt);
}

std::pair<Status, Index> make_fixed_steps(
  const System & system, const Tableau & tableau, Stabilisation stabilisation, Values state,
  double step_size, Index steps, Table scratch, Interrupt & interrupt)
{
  const Values stage = scratch[0], out = scratch[1], start = scratch[2];
  const Table slopes = scratch.from(3);
  for (Index done = 0; done < steps; ++done) {
    Parts parts(step_size);
    copy(state, start);
    // Once, but where a joint under dry friction comes to rest within the step, or a force over
    // time has a corner.
    while (parts.left > 0.0) {
      if (system.has_effects()) {
        parts.size = std::min(
          parts.size, time_to_next_corner(system.effects, state.from(system.own())));
      }
      const ContactGuard contacts(system);
      derivative(system, state, slopes[0]);
      contacts.begin();
      if (tableau.steps() == 0) {
        semi_implicit_step(system.manifold, state, system.nv(), parts.size, slopes[0], out);
      } else {
        step(system, tableau, state, parts.size, slopes, stage, out);
      }
      const bool closed = stabilise(system, stabilisation, out);
      const bool finite = all_finite(out);
      const bool stops = interrupt.after(1 + tableau.steps());
      if (!(closed && finite) || stops) {
        copy(start, state);
        return {stops ? Status::INTERRUPTED : finite ? Status::OPEN_LOOP : Status::NOT_FINITE,
          done};
      }
      if (!equations_serve(system, stabilisation, out)) {
        copy(start, state);
        return {Status::POOR_EQUATIONS, done};
      }
      if (parts.shorten(system, state, out)) {
        continue;
      }
      const double size = parts.size;
      if (contacts.is_passed(
          out, size, [&](double share) {
            interpolate_parabola(system, state, slopes[0], out, size, share, stage);
            return stage;
          }))
      {
        copy(start, state);
        return {Status::CONTACT_PASSED, done};
      }
      parts.accept(system, state, out);
    }
  }
  return {Status::DONE, steps};
}

}  // namespace closedloop
