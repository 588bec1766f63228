// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "time_events.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "profile.hpp"

namespace closedloop
{

namespace
{
/// Whether an effect follows the time.
bool follows_time(const EffectTable & effects, Index row)
{
  const Index role = effects.role[row];
  return effects.enabled[row] == 1 && (role == effect::PROFILE ||
         (role == effect::MOTION && effects.values(row, 1) == 0.0));
}

}  // namespace

double time_to_next_corner(const EffectTable & effects, Values own)
{
  double wait = std::numeric_limits<double>::infinity();
  for (Index row = 0; row < effects.count(); ++row) {
    if (follows_time(effects, row)) {
      const Index state = effects.first_state[row];
      const double end =
        end_of_segment(effects, row, effects.values(row, 0), segment_number(own[state + 1]));
      wait = std::min(wait, end - own[state]);
    }
  }
  return wait;
}

void handle_time_events(const EffectTable & effects, Values own)
{
  for (Index row = 0; row < effects.count(); ++row) {
    if (follows_time(effects, row)) {
      const Index state = effects.first_state[row];
      const double limit = own[state] + SAME_TIME * std::max(1.0, std::abs(own[state]));
      Index segment = segment_number(own[state + 1]);
      while (end_of_segment(effects, row, effects.values(row, 0), segment) <= limit) {
        ++segment;
      }
      own[state + 1] = static_cast<double>(segment);
    }
  }
}

}  // namespace closedloop
