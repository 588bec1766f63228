// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <cmath>

#include "forces.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
// Numbers of an entry in space: an axis in the body's frame, coefficients of the force along it
// and of the torque about it, linear and quadratic.
constexpr Index COLUMNS = 7;

/// Drag at a speed [N; N m].
double drag(double linear, double quadratic, double speed)
{
  return -(linear + quadratic * std::fabs(speed)) * speed;
}

/// `lost` is dissipated, `work` done by the flow [W].
void write_rates(
  const EffectTable & table, Index row, double lost, double work, double force, double torque)
{
  const Index state = table.index(row, effect::STATE);
  table.rates[state] = lost;
  table.rates[state + 1] = work;
  table.output(row, 1) = force;
  table.output(row, 2) = torque;
}
}  // namespace

void apply_fluid_drag(const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const Index i = table.index(row, effect::FIRST);
  const Vector2 offset = to_world(body, i, vector2(values)), flow = vector2(values + 10);
  const Vector2 axis = to_world(body, i, vector2(values + 2)), other = {-axis.y, axis.x};
  const Vector2 velocity = velocity_at_offset(body, i, offset) - flow;
  const double omega = body(i, plane::OMEGA);
  const double along = drag(values[4], values[6], dot(axis, velocity));
  const double across = drag(values[5], values[7], dot(other, velocity));
  const double torque = drag(values[8], values[9], omega);
  const Vector2 force = along * axis + across * other;
  apply_force(body, i, offset, force);
  apply_torque(body, i, torque);
  write_rates(
    table, row, -dot(force, velocity) - torque * omega, dot(force, flow),
    std::sqrt(dot(force, force)), torque);
}

void apply_spatial_fluid_drag(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const double * data = table.data.data + table.index(row, effect::DATA);
  const Index i = table.index(row, effect::FIRST);
  const Vector3 offset = to_world(body, i, vector3(values)), flow = vector3(values + 3);
  const Vector3 velocity = velocity_at_offset(body, i, offset) - flow;
  const Vector3 spin = spin_in_space(body, i);
  Vector3 force = {0.0, 0.0, 0.0}, torque = {0.0, 0.0, 0.0};
  for (Index k = 0; k < 3; ++k) {
    const double * entry = data + COLUMNS * k;
    const Vector3 axis = to_world(body, i, vector3(entry));
    force = force + drag(entry[3], entry[4], dot(axis, velocity)) * axis;
    torque = torque + drag(entry[5], entry[6], dot(axis, spin)) * axis;
  }
  apply_force(body, i, offset, force);
  apply_torque(body, i, torque);
  write_rates(
    table, row, -dot(force, velocity) - dot(torque, spin), dot(force, flow),
    std::sqrt(dot(force, force)), std::sqrt(dot(torque, torque)));
}

}  // namespace closedloop
