// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "stiffness.hpp"

#include <algorithm>
#include <cmath>

#include "evaluation.hpp"
#include "interrupt.hpp"
#include "loop_closure.hpp"
#include "null_space.hpp"
#include "scratch.hpp"

namespace closedloop
{

namespace
{
// Pairs of evaluations; length of the differences, of which no entry is zero.
constexpr int PAIRS = 4;
constexpr double DIFFERENCE = 1e-7, LEAST = 1e-300;
}  // namespace

double fastest_rate(const System & system, Values state, Values start)
{
  Scratch<double, 10 * FEW> room(4 * state.size);
  const Values direction = room.copy_of(start), place = room.copy_of(state);
  const Values slope = room.take(state.size), moved = room.take(state.size);
  Interrupt interrupt(system.interrupted, system.nv());
  derivative(system, place, slope);
  const auto turn = [&] {
      const double size = DIFFERENCE / std::max(largest(direction), LEAST);
      for (Index i = 0; i < state.size; ++i) {
        place[i] = state[i] + size * direction[i];
      }
      derivative(system, place, moved);
      for (Index i = 0; i < state.size; ++i) {
        direction[i] = start[i] == 0.0 ? 0.0 : (moved[i] - slope[i]) / size;
      }
    };
  double rate = 0.0;
  for (int n = 0; n < PAIRS && !interrupt.after(2); ++n) {
    const double norm = dense(direction).norm();
    if (!(std::isfinite(norm) && norm > 0.0)) {
      return rate;
    }
    dense(direction) /= norm;
    turn();
    turn();
    rate = std::sqrt(dense(direction).norm());
  }
  return rate;
}

}  // namespace closedloop
