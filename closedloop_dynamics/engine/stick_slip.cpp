// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "stick_slip.hpp"

#include <algorithm>
#include <cmath>

#include "arms.hpp"
#include "evaluation.hpp"
#include "static_friction.hpp"

namespace closedloop
{

namespace
{
// Cuts of one step: beyond, it is taken as it is.
constexpr int MOST_CUTS = 200;
// The least part of a step that is made.
constexpr double LEAST_PART = 1e-12;

bool has_friction(const EffectTable & effects, Index row)
{
  return effects.role[row] == effect::FRICTION && effects.enabled[row] == 1;
}

/// Whether any effect listed is dry friction, switched on or not.
bool lists_friction(const System & system)
{
  for (Index role : system.effects.role) {
    if (role == effect::FRICTION) {
      return true;
    }
  }
  return false;
}

/// Rates of all joints in a state, those of cut joints behind, which are written to `room`.
Values rates_of(const System & system, Values state, Values room)
{
  if (!system.has_cut_coordinates()) {
    return system.qd(state);
  }
  rates_with_cuts(system, state, room);
  return room;
}

/// Update the modes of joints by their rates, of which rounding is taken from joints of the tree at
/// rest; return whether one at rest still moves.
bool stick(const EffectTable & effects, Values rates, Values own)
{
  bool slow = false;
  const Index first = rates.size - effects.cuts.index.rows;
  for (Index row = 0; row < effects.count(); ++row) {
    if (has_friction(effects, row)) {
      const bool in_tree = !has_arms(effects, row) && joint_of(effects, row) < first;
      double & mode = own[effects.first_state[row]];
      const double rate = along(effects, row, rates);
      if (std::abs(rate) > REST) {
        mode = std::copysign(1.0, rate);
      } else if (rate * mode <= ARRIVED) {
        mode = 0.0;
        slow = slow || std::abs(rate) > RATE_ROUNDING;
        if (in_tree && std::abs(rate) <= RATE_ROUNDING) {
          rates[joint_of(effects, row)] = 0.0;
        }
      }
    }
  }
  return slow;
}
}  // namespace

double least_part(double size, int cuts)
{
  return size * (cuts < MOST_CUTS ? LEAST_PART : 1.0);
}

double forward_rate(const System & system, Index row, Values before, Values state)
{
  const EffectTable & effects = system.effects;
  return before[system.own() + effects.first_state[row]] *
         along(effects, row, rates_of(system, state, effects.cuts.qd));
}

Rest first_rest(const System & system, Values before, Values after, double size, double floor)
{
  Rest found{-1, size, 0.0, 0.0};
  if (!lists_friction(system) ||
    (system.has_cut_coordinates() && system.effects.static_friction.response.rows <= 1))
  {
    return found;
  }
  const EffectTable & effects = system.effects;
  const Values grips = before.from(system.own());
  const Values first = rates_of(system, before, effects.cuts.before);
  const Values last = rates_of(system, after, effects.cuts.qd);
  for (Index row = 0; row < effects.count(); ++row) {
    if (has_friction(effects, row)) {
      const double grip = grips[effects.first_state[row]];
      const double start = std::max(0.0, grip * along(effects, row, first));
      const double end = grip * along(effects, row, last);
      const double part = end < -ARRIVED ? size * start / (start - end) : size;
      if (part < found.part) {
        found = {row, part, start, end};
      }
    }
  }
  return found.part > floor ? found : Rest{-1, size, 0.0, 0.0};
}

void update_friction_modes(const System & system, Values state)
{
  const EffectTable & effects = system.effects;
  // Without joints that may stick there is no response to their friction.
  if (!system.has_effects() || effects.static_friction.right.size == 0) {
    return;
  }
  const bool with_cuts = system.has_cut_coordinates();
  Values rates = system.qd(state);
  if (with_cuts) {
    rates_with_cuts(system, state, effects.cuts.qd);
    rates = effects.cuts.qd;
  }
  if (stick(effects, rates, state.from(system.own()))) {
    evaluate_with_poses(system, state);
    // The evaluation measures the rates of cut joints again, of the same state.
    stop_sticking_joints(effects, rates);
  }
  if (with_cuts) {
    copy(rates, system.qd(state));
  }
}

void begin_friction(const EffectTable & effects, Values rates, Values own)
{
  for (Index row = 0; row < effects.count(); ++row) {
    if (has_friction(effects, row)) {
      const double rate = along(effects, row, rates);
      own[effects.first_state[row]] =
        std::abs(rate) > REST ? std::copysign(1.0, rate) : 0.0;
    }
  }
}

}  // namespace closedloop
