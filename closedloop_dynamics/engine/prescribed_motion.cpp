// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "laws.hpp"
#include "scene_code.hpp"

namespace closedloop
{

double * right_side(const EffectTable & table, Index row)
{
  const Index * places = table.places_of(row);
  return table.motions.row(places[effect::CUT_ROW]) + places[effect::COLUMN];
}

void update_driven_motions(const EffectTable & table)
{
  take_pieces(table);
  for (Index row = 0; row < table.count(); ++row) {
    if (table.role[row] == effect::MOTION) {
      apply_generated(table, row, {}, {}, {}, {});
    }
  }
}

void output_driving_forces(const EffectTable & table, Values lam)
{
  for (Index row = 0; row < table.count(); ++row) {
    if (table.role[row] == effect::MOTION) {
      const double * right = right_side(table, row);
      const Values output = table.output[row];
      const double force = lam[table.places_of(row)[effect::MULTIPLIER]], rate = right[1];
      table.rates[table.first_state[row] + 2] = force * rate;
      output[1] = force;
      output[2] = force * rate;
      output[3] = right[0];
      output[4] = rate;
    }
  }
}

}  // namespace closedloop
