// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "force_table.hpp"
#include "forces.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
// Numbers of an entry: stroke at which a piece begins, coefficients, energy there.
constexpr Index COLUMNS = 6;

/// Force and energy at a stroke.
ForceAndEnergy look_up(const EffectTable & table, Index row, double stroke)
{
  return look_up_force(
    table.data.part(table.index(row, effect::DATA), COLUMNS * table.index(row, effect::ENTRIES)),
    stroke);
}

void write_readings(
  const EffectTable & table, Index row, double force, double stroke, double energy,
  double dissipated)
{
  table.rates[table.index(row, effect::STATE)] = dissipated;
  table.output(row, effect::STORED) = energy;
  table.output(row, 1) = force;
  table.output(row, 2) = stroke;
}

template<class V>
void pull_between(const EffectTable & table, Index row, Table body)
{
  const double * values = table.values.row(row);
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  const Line<V> line = line_between(
    body, a, vector_at(values + 1, V()), b, vector_at(values + 1 + size_of(V()), V()));
  const auto [force, energy] = look_up(table, row, line.length);
  const double tension = line.length > 0.0 ? force + values[0] * line.rate : 0.0;
  apply_force_at(body, a, line.start, tension * line.direction);
  apply_force_at(body, b, line.end, -tension * line.direction);
  write_readings(table, row, tension, line.length, energy, values[0] * line.rate * line.rate);
}
}  // namespace

ForceAndEnergy look_up_force(Values pieces, double stroke)
{
  // The piece before the table begins where its first one does.
  Index low = 0, high = pieces.size / COLUMNS - 1;
  if (stroke < pieces[0]) {
    high = 0;
  }
  while (high - low > 0) {
    const Index middle = (low + high + 1) / 2;
    if (pieces[COLUMNS * middle] <= stroke) {
      low = middle;
    } else {
      high = middle - 1;
    }
  }
  const double * c = pieces.data + COLUMNS * low;
  const double u = stroke - c[0];
  return {
    c[1] + u * (c[2] + u * (c[3] + u * c[4])),
    c[5] + u * (c[1] + u * (c[2] / 2.0 + u * (c[3] / 3.0 + u * c[4] / 4.0)))};
}

void apply_joint_force_table(
  const EffectTable & table, Index row, Table, Values q, Values qd, Values)
{
  const Index joint = table.index(row, effect::FIRST);
  const double damping = table.values(row, 0);
  const auto [force, energy] = look_up(table, row, q[joint]);
  const double loss = damping * qd[joint];
  table.applied[joint] += force - loss;
  write_readings(table, row, force - loss, q[joint], -energy, loss * qd[joint]);
}

void apply_point_force_table(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  pull_between<Vector2>(table, row, body);
}

void apply_spatial_force_table(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  pull_between<Vector3>(table, row, body);
}

}  // namespace closedloop
