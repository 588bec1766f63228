// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STICK_SLIP_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STICK_SLIP_HPP_

#include <cmath>

#include "data.hpp"

// The instants at which joints under dry friction stick or slip. Within a step each of them slides
// in one direction, or is held (static_friction.hpp), so that all methods keep their order. A step on
// which a sliding joint would turn round is cut where it comes to rest; there it sticks, or sets
// out again.

namespace closedloop
{

/// The least part of a step worth trying after a number of cuts [s].
double least_part(double size, int cuts);

/// A sliding joint has come to rest where its rate is less than this [rad/s; m/s].
constexpr double ARRIVED = 1e-9;

/// The first joint that comes to rest within a step, and turns round.
struct Rest
{
  Index row;  ///< Of its friction; negative: there is none
  double part;  ///< Of the step, by the secant [s]
  double start, end;  ///< Forward rates before and after the step [rad/s; m/s]
};

/// The first rest in a step; parts of `floor` or less are not worth a step.
Rest first_rest(const System &, Values before, Values after, double size, double floor);

/// Rate, forward before the step, of the joint of a friction in a state [rad/s; m/s].
double forward_rate(const System &, Index row, Values before, Values state);

/// Where a function is zero, to `near`, between 0 with the value `start` and `high` with `end` less
/// than zero: by regula falsi that halves the end that stays (Illinois).
template<class Function>
double first_zero(double high, double start, double end, double near, Function && function)
{
  constexpr int MOST_ITERATIONS = 50;
  double low = 0.0, found = high;
  for (int k = 0, stayed = 0; k < MOST_ITERATIONS; ++k) {
    found = low + (high - low) * start / (start - end);
    const double value = function(found);
    if (std::abs(value) <= near) {
      break;
    }
    if (value < 0.0) {
      high = found;
      end = value;
      start *= stayed < 0 ? 0.5 : 1.0;
      stayed = -1;
    } else {
      low = found;
      start = value;
      end *= stayed > 0 ? 0.5 : 1.0;
      stayed = 1;
    }
  }
  return found;
}

/// The part of a step on which no joint turns round [s]; `size` where the step may be taken. A
/// smaller one is an estimate, to be tried; parts of `floor` or less are not worth a step.
/// `state_at(share)` returns a state between, by dense output: the rest is found there without
/// evaluations.
template<class StateAt>
double locate_stick_event(
  const System & system, Values before, Values after, double size, double floor,
  StateAt && state_at)
{
  // Midway between at rest and turned round.
  constexpr double AIM = 0.5 * ARRIVED, NEAR = 0.25 * ARRIVED;
  double found = size;
  Rest rest = first_rest(system, before, after, size, floor);
  // Another joint may have turned round before.
  for (Index n = 0; rest.row >= 0 && n < system.effects.count(); ++n) {
    Values state = after;
    found = first_zero(
      found, rest.start + AIM, rest.end + AIM, NEAR, [&](double part) {
        state = state_at(part / size);
        return forward_rate(system, rest.row, before, state) + AIM;
      });
    rest = first_rest(system, before, state, found, floor);
  }
  return found;
}

/// Update the stick/slip modes after an accepted step, in place, and set the remaining rates of
/// stuck joints to zero by an impulse.
void update_friction_modes(const System &, Values state);

/// Initialise the modes of joints under dry friction from the rates of all joints, those of cut
/// joints last, in the effects' own states.
void begin_friction(const EffectTable &, Values rates, Values own);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STICK_SLIP_HPP_
