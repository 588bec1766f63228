// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "course.hpp"
#include "forces.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
/// Present value of the course of a force.
double prescribed_value(const EffectTable & table, Index row)
{
  const Values values = table.values[row];
  if (values[1] == 1.0) {
    return expression_value(
      table, table.index(row, effect::DATA), table.states[table.index(row, effect::STATE)]);
  }
  return course_value(table, row, values[0]);
}

void write_readings(const EffectTable & table, Index row, double force, double power)
{
  const Index state = table.index(row, effect::STATE);
  table.rates[state] = 1.0;
  table.rates[state + 2] = power;
  table.output(row, 1) = force;
  table.output(row, 2) = power;
}

/// Apply a force at a point along a direction, which turns with the body or is one of the world.
template<class V>
void apply_at_point(
  const EffectTable & table, Index row, Table body, V point, V direction, bool turns)
{
  const Index i = table.index(row, effect::FIRST);
  const V offset = to_world(body, i, point);
  const double force = prescribed_value(table, row);
  if (turns) {
    direction = to_world(body, i, direction);
  }
  apply_force(body, i, offset, force * direction);
  write_readings(
    table, row, force, force * dot(direction, velocity_at_offset(body, i, offset)));
}

/// Position, rate and acceleration that the closure equation of a prescribed motion is to have.
double * right_sides(const EffectTable & table, Index row)
{
  return table.motions.row(table.index(row, effect::FIRST)) +
         static_cast<Index>(table.values(row, 3));
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
    rate = expression_value(table, begin + static_cast<Index>(values[4]), time);
    change = expression_value(table, begin + static_cast<Index>(values[5]), time);
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

void apply_prescribed_torque(
  const EffectTable & table, Index row, Table, Values, Values qd, Values)
{
  const Index joint = table.index(row, effect::FIRST);
  const double torque = prescribed_value(table, row);
  table.applied[joint] += torque;
  write_readings(table, row, torque, torque * qd[joint]);
}

void apply_prescribed_force(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  apply_at_point(
    table, row, body, vector2(values + 2), vector2(values + 4), values[6] == 1.0);
}

void apply_spatial_prescribed_force(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  apply_at_point(
    table, row, body, vector3(values + 2), vector3(values + 5), values[8] == 1.0);
}

void apply_prescribed_motion(
  const EffectTable & table, Index row, Table, Values, Values, Values)
{
  update_driven_motion(table, row);
  table.rates[table.index(row, effect::STATE)] = 1.0;
}

void update_driven_motions(const EffectTable & table)
{
  for (Index row = 0; row < table.count(); ++row) {
    if (table.kind[row] == effect::PRESCRIBED_MOTION) {
      update_driven_motion(table, row);
    }
  }
}

void output_driving_forces(const EffectTable & table, Values lam)
{
  for (Index row = 0; row < table.count(); ++row) {
    if (table.kind[row] == effect::PRESCRIBED_MOTION) {
      const double * right = right_sides(table, row);
      const Values output = table.output[row];
      const double force = lam[table.index(row, effect::SECOND)], rate = right[1];
      table.rates[table.index(row, effect::STATE) + 2] = force * rate;
      output[1] = force;
      output[2] = force * rate;
      output[3] = right[0];
      output[4] = rate;
    }
  }
}

}  // namespace closedloop
