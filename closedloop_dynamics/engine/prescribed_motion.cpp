// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "course.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
/// Position, rate and acceleration that the closure equation of a prescribed motion is to have.
double * right_sides(const EffectTable & table, Index row)
{
  const Index * places = table.places_of(row);
  return table.motions.row(places[effect::CUT_ROW]) + places[effect::COLUMN];
}

/// Set the right-hand sides of a prescribed motion to the time in its state.
void update_driven_motion(const EffectTable & table, Index row)
{
  const Values values = table.values[row];
  double * right = right_sides(table, row);
  double value, rate, change;
  if (values[1] == 1.0) {
    const Index begin = table.index(row, effect::DATA);
    const double time = table.states[table.index(row, effect::STATE)];
    value = expression_value(table, begin, time);
    rate = expression_value(table, begin + static_cast<Index>(values[3]), time);
    change = expression_value(table, begin + static_cast<Index>(values[4]), time);
  } else {
    const CourseDerivatives derivatives = course_derivatives(table, row, values[0]);
    value = course_value(table, row, values[0]);
    rate = derivatives.rate;
    change = derivatives.change;
  }
  right[0] = values[2] + value;
  right[1] = rate;
  right[2] = change;
}
}  // namespace

void apply_prescribed_motion(
  const EffectTable & table, Index row, Table, Values, Values, Values)
{
  update_driven_motion(table, row);
  table.rates[table.index(row, effect::STATE)] = 1.0;
}

void update_driven_motions(const EffectTable & table)
{
  for (Index row = 0; row < table.count(); ++row) {
    if (table.role[row] == effect::MOTION) {
      update_driven_motion(table, row);
    }
  }
}

void output_driving_forces(const EffectTable & table, Values lam)
{
  for (Index row = 0; row < table.count(); ++row) {
    if (table.role[row] == effect::MOTION) {
      const double * right = right_sides(table, row);
      const Values output = table.output[row];
      const double force = lam[table.places_of(row)[effect::MULTIPLIER]], rate = right[1];
      table.rates[table.index(row, effect::STATE) + 2] = force * rate;
      output[1] = force;
      output[2] = force * rate;
      output[3] = right[0];
      output[4] = rate;
    }
  }
}

}  // namespace closedloop
