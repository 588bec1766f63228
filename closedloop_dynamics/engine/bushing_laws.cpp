// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <cmath>

#include "forces.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
// Where the numbers of a bushing in space begin: places in both bodies' frames, the axes as rows,
// in the frames of body a and of body b, stiffness and damping along the axes.
constexpr Index PLACE_B = 3, AXES_A = 6, AXES_B = 15, ALONG = 24, LOSS = 27;
}  // namespace

void apply_bushing(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const double * data = table.data.data + table.index(row, effect::DATA);
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  const Vector2 start = position(body, a, vector2(data));
  const Vector2 end = position(body, b, vector2(data + 2));
  // The first axis (x, y), the second (-y, x).
  const Vector2 axis = to_world(body, a, vector2(values + 3));
  // Relative to the point of body a that coincides with b, as seen in the turning axes.
  const Vector2 velocity = velocity_at(body, b, end) - velocity_at(body, a, end);
  const Vector2 apart = end - start;
  const double along = dot(axis, apart), across = cross(axis, apart);
  const double rate_1 = dot(axis, velocity), rate_2 = cross(axis, velocity);
  const double turn = body(b, plane::ALPHA) - body(a, plane::ALPHA) - values[2];
  const double spin = body(b, plane::OMEGA) - body(a, plane::OMEGA);
  const double force_1 = -data[4] * along - data[6] * rate_1;
  const double force_2 = -data[5] * across - data[7] * rate_2;
  const double moment = -values[0] * turn - values[1] * spin;
  const Vector2 force = {
    axis.x * force_1 - axis.y * force_2, axis.y * force_1 + axis.x * force_2};
  apply_force_at(body, b, end, force);
  apply_force_at(body, a, end, -force);
  apply_torque(body, b, moment);
  apply_torque(body, a, -moment);
  table.rates[table.index(row, effect::STATE)] =
    data[6] * rate_1 * rate_1 + data[7] * rate_2 * rate_2 + values[1] * spin * spin;
  table.output(row, effect::STORED) = 0.5 * (
    data[4] * along * along + data[5] * across * across + values[0] * turn * turn);
  table.output(row, 1) = force_1;
  table.output(row, 2) = force_2;
  table.output(row, 3) = moment;
}

void apply_spatial_bushing(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const double * data = table.data.data + table.index(row, effect::DATA);
  double * output = table.output.row(row);
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  const Vector3 start = position(body, a, vector3(data));
  const Vector3 end = position(body, b, vector3(data + PLACE_B));
  // Relative to the point of body a that coincides with b, as seen in the turning axes.
  const Vector3 velocity = velocity_at(body, b, end) - velocity_at(body, a, end);
  const Vector3 turning = spin_in_space(body, b) - spin_in_space(body, a), apart = end - start;
  Vector3 force = {0.0, 0.0, 0.0}, moment = {0.0, 0.0, 0.0};
  double stored = 0.0, lost = 0.0;
  for (Index k = 0; k < 3; ++k) {
    const Vector3 axis = to_world(body, a, vector3(data + AXES_A + 3 * k));
    const Vector3 other = to_world(body, b, vector3(data + AXES_B + 3 * k));
    const double along = dot(axis, apart), rate = dot(axis, velocity), spin = dot(axis, turning);
    const double stiffness = data[ALONG + k], damping = data[LOSS + k];
    const double component = -stiffness * along - damping * rate;
    output[1 + k] = component;
    force = force + component * axis;
    // 1 - a . b of both bodies' axes: its gradient is the vector product of the two.
    const double share = values[k], loss = -values[3 + k] * spin;
    moment = moment + (share * cross(other, axis) + loss * axis);
    stored += 0.5 * stiffness * along * along + share * (1.0 - dot(axis, other));
    lost += damping * rate * rate - loss * spin;
  }
  apply_force_at(body, b, end, force);
  apply_force_at(body, a, end, -force);
  apply_torque(body, b, moment);
  apply_torque(body, a, -moment);
  table.rates[table.index(row, effect::STATE)] = lost;
  output[effect::STORED] = stored;
  output[4] = std::sqrt(dot(moment, moment));
}

}  // namespace closedloop
