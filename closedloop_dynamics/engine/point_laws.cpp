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
}  // namespace

void apply_point_spring(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  const Vector2 offset_a = to_world(body, a, vector2(values + 3));
  const Vector2 offset_b = to_world(body, b, vector2(values + 5));
  Vector2 direction = origin_in_plane(body, b) - origin_in_plane(body, a) + offset_b - offset_a;
  const double length = std::sqrt(dot(direction, direction));
  double rate = 0.0;
  if (length > 0.0) {
    direction = direction / length;
    const double omega_a = body(a, plane::OMEGA), omega_b = body(b, plane::OMEGA);
    const Vector2 velocity = {
      body(b, plane::VX) - body(a, plane::VX) - omega_b * offset_b.y + omega_a * offset_a.y,
      body(b, plane::VY) - body(a, plane::VY) + omega_b * offset_b.x - omega_a * offset_a.x};
    rate = dot(direction, velocity);
  }
  const double tension = spring_tension(table, row, length, rate);
  if (length > 0.0) {
    apply_force(body, a, offset_a, tension * direction);
    apply_force(body, b, offset_b, -tension * direction);
  }
}

void apply_spatial_point_spring(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  const Vector3 offset_a = to_world(body, a, vector3(values + 3));
  const Vector3 offset_b = to_world(body, b, vector3(values + 6));
  Vector3 direction = origin_in_space(body, b) - origin_in_space(body, a) + offset_b - offset_a;
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

void apply_external_force(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const Index i = table.index(row, effect::FIRST);
  const Vector2 offset = to_world(body, i, vector2(values));
  Vector2 force = vector2(values + 2);
  const double torque = values[4];
  if (values[5] > 0.0) {
    force = to_world(body, i, force);
  }
  apply_force(body, i, offset, force);
  double power = dot(force, velocity_at_offset(body, i, offset));
  if (torque != 0.0) {
    apply_torque(body, i, torque);
    power += torque * body(i, plane::OMEGA);
  }
  table.rates[table.index(row, effect::STATE)] = power;
  table.output(row, 1) = power;
}

void apply_spatial_external_force(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const Index i = table.index(row, effect::FIRST);
  const Vector3 offset = to_world(body, i, vector3(values));
  Vector3 force = vector3(values + 3), torque = vector3(values + 6);
  if (values[9] > 0.0) {
    force = to_world(body, i, force);
    torque = to_world(body, i, torque);
  }
  apply_force(body, i, offset, force);
  apply_torque(body, i, torque);
  const Vector3 velocity = velocity_at_offset(body, i, offset), spin = spin_in_space(body, i);
  const double power = force.x * velocity.x + force.y * velocity.y + force.z * velocity.z +
    torque.x * spin.x + torque.y * spin.y + torque.z * spin.z;
  table.rates[table.index(row, effect::STATE)] = power;
  table.output(row, 1) = power;
}

}  // namespace closedloop
