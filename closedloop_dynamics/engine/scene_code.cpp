// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "scene_code.hpp"

#include <algorithm>
#include <cmath>

#include "columns.hpp"
#include "profile.hpp"

namespace closedloop
{

namespace
{
/// Bring the present segment of a profile up to the time.
void take_piece(const EffectTable & table, Index row)
{
  const Values values = table.values[row], held = table.code.present[row];
  const Index state = table.first_state[row];
  const bool written = values[1] == 1.0;
  if (written) {
    const Index at = table.first_number[row];
    const double time = table.states[state];
    held[present::COEFFICIENTS] = expression_value(table.data, at, time);
    if (table.role[row] == effect::MOTION) {
      for (Index k = 1; k < 3; ++k) {
        held[present::COEFFICIENTS + k] =
          expression_value(table.data, at + static_cast<Index>(values[2 + k]), time);
      }
    }
  } else if (!(held[present::NUMBER] == table.states[state + 1])) {
    const PresentPiece found = present_piece(table, row, values[0]);
    held[present::NUMBER] = table.states[state + 1];
    held[present::PERIOD_START] = found.period_start;
    std::copy(found.segment, found.segment + profile::COLUMNS, &held[present::PIECE_START]);
  }
}
}  // namespace

void store_sides(const EffectTable & table)
{
  for (Index row : table.contacts.rows) {
    table.code.sides[row] = static_cast<double>(table.contacts.mode[row]);
  }
}

void take_pieces(const EffectTable & table)
{
  for (Index row = 0; row < table.count(); ++row) {
    if (table.role[row] == effect::PROFILE || table.role[row] == effect::MOTION) {
      take_piece(table, row);
    }
  }
}

Index prepare_code(const EffectTable & table)
{
  if (table.code.fits[0] == 0 || table.loaded[0] > 0) {
    return -1;
  }
  Index frictions = 0, resting = 0;
  for (Index row = 0; row < table.count(); ++row) {
    if (table.enabled[row] != 1) {
      return -1;
    }
    if (table.role[row] == effect::FRICTION) {
      ++frictions;
      resting += std::fabs(table.states[table.first_state[row]]) < 0.5 ? 1 : 0;
    }
  }
  take_pieces(table);
  store_sides(table);
  table.static_friction.rows[0] = 0;
  return resting > held_at_once(frictions) ? routine::RESPONSES :
         resting > 0 ? routine::AT_REST : routine::MOTION;
}

}  // namespace closedloop
