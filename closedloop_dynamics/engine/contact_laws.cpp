// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <cmath>

#include "forces.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
/// Hunt and Crossley's normal force, friction and scraping; written to the row, too.
ContactForces contact_forces(
  const EffectTable & table, Index row, double depth, double rate, double slip)
{
  const Values values = table.values[row], output = table.output[row];
  const double sign = slip / std::sqrt(slip * slip + values[10] * values[10]);
  const double elastic = elastic_force(values[6], values[7], -depth);
  const double normal = elastic * std::max(0.0, 1.0 + values[8] * rate);
  const double friction = values[9] * normal * sign;
  const double scraping = values[11] * depth * sign;
  const double along = -friction - scraping;
  table.rates[table.index(row, effect::STATE)] = (normal - elastic) * rate - along * slip;
  output[effect::STORED] = elastic * depth / (values[7] + 1.0);
  output[1] = depth;
  output[2] = normal;
  output[3] = -friction;
  output[4] = -scraping;
  return {normal, along};
}
}  // namespace

void apply_contact(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const Index i = table.index(row, effect::FIRST);
  const Vector2 offset = to_world(body, i, vector2(values));
  // Along the line (x, y), out of it (-y, x).
  const Vector2 line = vector2(values + 4);
  const Vector2 apart = origin_in_plane(body, i) + offset - vector2(values + 2);
  const double depth = line.y * apart.x - line.x * apart.y;
  table.output[row].fill(0.0);
  const Vector2 velocity = velocity_at_offset(body, i, offset);
  const double rate = line.y * velocity.x - line.x * velocity.y;
  if (update_contact(table.contacts, row, -depth, -rate)) {
    const double slip = dot(line, velocity);
    const auto [normal, along] = contact_forces(table, row, depth, rate, slip);
    apply_force(
      body, i, offset, {along * line.x - normal * line.y, along * line.y + normal * line.x});
  }
}

void apply_spatial_contact(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const Index i = table.index(row, effect::FIRST);
  const Vector3 offset = to_world(body, i, vector3(values)), out = vector3(values + 3);
  const double depth = values[12] - dot(out, origin_in_space(body, i) + offset);
  table.output[row].fill(0.0);
  const Vector3 velocity = velocity_at_offset(body, i, offset);
  const double rate = -dot(out, velocity);
  if (update_contact(table.contacts, row, -depth, -rate)) {
    // The tangential part of the velocity.
    const Vector3 sliding = velocity + rate * out;
    const double slip = std::sqrt(dot(sliding, sliding));
    const auto [normal, along] = contact_forces(table, row, depth, rate, slip);
    const double drag = slip > 0.0 ? along / slip : 0.0;
    apply_force(body, i, offset, normal * out + drag * sliding);
  }
}

}  // namespace closedloop
