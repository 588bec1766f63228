// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <cmath>

#include "forces.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
/// Tension of a spring and damper at a length and its rate [N]; written to the row, too.
double spring_tension(const EffectTable & table, Index row, double length, double rate)
{
  const Values values = table.values[row];
  const double stretch = length - values[2];
  const double tension = length > 0.0 ? values[0] * stretch + values[1] * rate : 0.0;
  table.rates[table.index(row, effect::STATE)] = values[1] * rate * rate;
  table.output(row, effect::STORED) = 0.5 * values[0] * stretch * stretch;
  table.output(row, 1) = tension;
  table.output(row, 2) = length;
  return tension;
}

template<class V>
void pull_between(const EffectTable & table, Index row, Table body)
{
  const double * places = table.values.row(row) + 3;
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  const V offset_a = to_world(body, a, vector_at(places, V()));
  const V offset_b = to_world(body, b, vector_at(places + size_of(V()), V()));
  V direction = origin(body, b, V()) - origin(body, a, V()) + offset_b - offset_a;
  const double length = std::sqrt(dot(direction, direction));
  double rate = 0.0;
  if (length > 0.0) {
    direction = direction / length;
    rate = dot(
      direction,
      velocity_at_offset(body, b, offset_b) - velocity_at_offset(body, a, offset_a));
  }
  const double tension = spring_tension(table, row, length, rate);
  if (length > 0.0) {
    apply_force(body, a, offset_a, tension * direction);
    apply_force(body, b, offset_b, -tension * direction);
  }
}

/// A force and a torque, in the axes of the world or of the body.
template<class V>
void push(const EffectTable & table, Index row, Table body)
{
  const double * values = table.values.row(row);
  const double * torques = values + 2 * size_of(V());
  const Index i = table.index(row, effect::FIRST);
  const V offset = to_world(body, i, vector_at(values, V()));
  V force = vector_at(values + size_of(V()), V());
  auto torque = turning_at(torques, V());
  if (torques[turning_size(V())] > 0.0) {
    force = to_world(body, i, force);
    torque = to_world(body, i, torque);
  }
  apply_force(body, i, offset, force);
  apply_torque(body, i, torque);
  const double power = dot(force, velocity_at_offset(body, i, offset)) +
    dot(torque, spin(body, i, V()));
  table.rates[table.index(row, effect::STATE)] = power;
  table.output(row, 1) = power;
}
}  // namespace

void apply_point_spring(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  pull_between<Vector2>(table, row, body);
}

void apply_spatial_point_spring(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  pull_between<Vector3>(table, row, body);
}

void apply_external_force(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  push<Vector2>(table, row, body);
}

void apply_spatial_external_force(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  push<Vector3>(table, row, body);
}

}  // namespace closedloop
