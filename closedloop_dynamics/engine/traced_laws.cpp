// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>

#include "forces.hpp"
#include "laws.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
using namespace traced;  // NOLINT: columns of one table

/// Inputs of the routine before coordinates and rates: the time; 1 where the gap is negative.
enum Input : Index {TIME, SIDE, COORDINATES};

inline Vector2 unit(Index axis, Vector2) {return {axis == 0 ? 1.0 : 0.0, axis == 1 ? 1.0 : 0.0};}
inline Vector3 unit(Index axis, Vector3)
{
  return {axis == 0 ? 1.0 : 0.0, axis == 1 ? 1.0 : 0.0, axis == 2 ? 1.0 : 0.0};
}

/// A point along a world axis, as a line that begins in a plane through the world's origin.
template<class V>
Line<V> component(Table body, Index row, V point, V axis)
{
  const V place = position(body, row, point);
  return {
    place - dot(axis, place) * axis, place, axis, dot(axis, place),
    dot(axis, velocity_at(body, row, place))};
}

/// Measure the coordinates, evaluate the law, and apply the forces along them.
template<class V>
void apply_law(const EffectTable & table, Index row, Table body, Values q, Values qd)
{
  const double * head = table.data.data + table.index(row, effect::DATA);
  const Index count = table.index(row, effect::FIRST), own = static_cast<Index>(head[OWN]);
  const Index state = table.index(row, effect::STATE), clock = static_cast<Index>(head[CLOCK]);
  double measured[COORDINATES + 2 * MOST_COORDINATES];
  double results[MOST_COORDINATES + MOST_STATES + 2 + READINGS + 2];
  Line<V> lines[MOST_COORDINATES];
  measured[TIME] = clock == 1 ? table.states[state] : 0.0;
  double * coordinates = measured + COORDINATES;
  for (Index k = 0; k < count; ++k) {
    const double * entry = head + (k + 1) * COLUMNS;
    const Index first = static_cast<Index>(entry[FIRST]);
    const Index second = static_cast<Index>(entry[SECOND]);
    const Index kind = static_cast<Index>(entry[MEASURED]);
    if (kind == JOINT) {
      coordinates[2 * k] = q[first];
      coordinates[2 * k + 1] = qd[first];
    } else {
      const V point = vector_at(entry + POINT_A, V());
      lines[k] = kind == COMPONENT ? component(body, first, point, unit(second, V())) :
        line_between(body, first, point, second, vector_at(entry + POINT_B, V()));
      coordinates[2 * k] = lines[k].length;
      coordinates[2 * k + 1] = lines[k].rate;
    }
  }
  const auto run = [&](bool inside) {
      measured[SIDE] = inside ? 1.0 : 0.0;
      run_law(
        table.index(row, effect::SECOND), table.values.row(row), measured,
        table.states.data + state + clock, results);
    };
  const bool inside = table.contacts.mode[row] == contact::TOUCHING;
  run(inside);
  if (head[EVENT] == 1.0) {
    // The gap is the same for both sides of the event; forces may be those of the other side.
    const double * gap = results + count + own + 2 + READINGS;
    if (update_contact(table.contacts, row, gap[0], gap[1]) != inside) {
      run(!inside);
    }
  }
  double power = 0.0;
  for (Index k = 0; k < count; ++k) {
    const double * entry = head + (k + 1) * COLUMNS;
    const double force = results[k];
    power += force * coordinates[2 * k + 1];
    if (entry[MEASURED] == JOINT) {
      table.applied[static_cast<Index>(entry[FIRST])] += force;
    } else {
      const Line<V> & line = lines[k];
      const bool between = entry[MEASURED] == DISTANCE;
      if (between) {
        apply_force_at(body, static_cast<Index>(entry[FIRST]), line.start,
          -force * line.direction);
      }
      apply_force_at(body, static_cast<Index>(entry[between ? SECOND : FIRST]), line.end,
        force * line.direction);
    }
  }
  const double * rates = results + count, * energies = rates + own;
  if (clock == 1) {
    table.rates[state] = 1.0;
  }
  double * flow = std::copy(rates, rates + own, table.rates.data + state + clock);
  *flow = head[BOOKED] == 1.0 ? energies[1] : power;
  table.output(row, effect::STORED) = energies[0];
  table.output(row, 1) = power;
  std::copy(energies + 2, energies + 2 + READINGS, table.output.row(row) + 2);
}
}  // namespace

void apply_traced(
  const EffectTable & table, Index row, Table body, Values q, Values qd, Values)
{
  apply_law<Vector2>(table, row, body, q, qd);
}

void apply_spatial_traced(
  const EffectTable & table, Index row, Table body, Values q, Values qd, Values)
{
  apply_law<Vector3>(table, row, body, q, qd);
}

}  // namespace closedloop
