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
// Numbers of an entry: row of a point's body, place in its frame [m], radius of the pulley [m], and
// length of cable on it at the latest evaluation [m]; in space one more.
constexpr Index COLUMNS = 5, SPATIAL_COLUMNS = 6;
// Columns of EffectTable.values in space: row of the body of the pulleys' axis, negative with
// guides only; the axis in the frame of that row.
constexpr Index CARRIER = 3, AXIS = 4;

/// Row of the body of an entry's point.
Index body_row(const double * entry) {return static_cast<Index>(entry[0]);}

/// A straight piece in the plane, tangent to the pulleys at both its ends.
Line<Vector2> straight(Table body, const double * entry)
{
  const double * next = entry + COLUMNS;
  const Vector2 start = position(body, body_row(entry), vector2(entry + 1));
  const Vector2 end = position(body, body_row(next), vector2(next + 1));
  const Vector2 velocity =
    velocity_at(body, body_row(next), end) - velocity_at(body, body_row(entry), start);
  const Vector2 apart = end - start;
  // The line of centers has a component along the tangent, and one across: the difference of the
  // radii.
  const double between = dot(apart, apart), across = next[3] - entry[3];
  const double length = std::sqrt(std::max(0.0, between - across * across));
  Line<Vector2> line = {start, end, apart, length, 0.0};
  if (between > 0.0) {
    line.direction = {
      (length * apart.x + across * apart.y) / between,
      (length * apart.y - across * apart.x) / between};
    line.rate = dot(line.direction, velocity);
  }
  return line;
}

/// Length of cable on a pulley between two directions [m].
double wrapped_length(double radius, Vector2 before, Vector2 after)
{
  // A quarter turn from -180 to 180 degrees: -90 to 270.
  const double turn = 0.5 * M_PI +
    std::atan2(-dot(before, after), std::copysign(1.0, radius) * cross(before, after));
  return std::fabs(radius) * turn;
}

/// Tension at a length and its rate [N]; written to the row, too.
double cable_tension(const EffectTable & table, Index row, double length, double rate)
{
  const Values values = table.values[row], output = table.output[row];
  double stretch = length - values[1];
  if (!update_contact(table.contacts, row, -stretch, -rate)) {
    stretch = 0.0;
  }
  const double elastic = values[0] * stretch;
  const double tension = elastic * std::max(0.0, 1.0 + values[2] * rate);
  table.rates[table.index(row, effect::STATE)] = (tension - elastic) * rate;
  output[effect::STORED] = 0.5 * elastic * stretch;
  output[1] = tension;
  output[2] = length;
  return tension;
}

/// A straight piece in space where no pulley has a radius.
Line<Vector3> straight_in_space(Table body, const double * entry)
{
  const double * next = entry + SPATIAL_COLUMNS;
  return line_between(
    body, body_row(entry), vector3(entry + 1), body_row(next), vector3(next + 1));
}

/// Forces in space where no pulley has a radius.
void apply_over_guides(const EffectTable & table, Index row, Table body)
{
  const double * entries = table.data.data + table.index(row, effect::DATA);
  const Index pieces = table.index(row, effect::ENTRIES) - 1;
  double length = 0.0, rate = 0.0;
  for (Index k = 0; k < pieces; ++k) {
    const Line<Vector3> line = straight_in_space(body, entries + SPATIAL_COLUMNS * k);
    length += line.length;
    rate += line.rate;
  }
  const double tension = cable_tension(table, row, length, rate);
  if (tension != 0.0) {
    for (Index k = 0; k < pieces; ++k) {
      const double * entry = entries + SPATIAL_COLUMNS * k;
      const Line<Vector3> line = straight_in_space(body, entry);
      apply_force_at(body, body_row(entry), line.start, tension * line.direction);
      apply_force_at(
        body, body_row(entry + SPATIAL_COLUMNS), line.end, -tension * line.direction);
    }
  }
}

/// A straight piece in space between pulleys that lie across one axis (doc/theory.md).
struct PulleyPiece
{
  /// Positions of both centers [m].
  Vector3 start;
  Vector3 end;
  /// Direction as seen along the axis, and f: the gradient of the length.
  Vector3 tangent;
  Vector3 force;
  /// Length as seen along the axis, along the axis, and in all: a, h, L [m].
  double seen;
  double high;
  double length;
};

PulleyPiece tangent_in_space(Table body, const double * entry, Vector3 axis)
{
  const double * next = entry + SPATIAL_COLUMNS;
  const Vector3 start = position(body, body_row(entry), vector3(entry + 1));
  const Vector3 end = position(body, body_row(next), vector3(next + 1));
  const double high = dot(end - start, axis);
  const Vector3 apart = end - start - high * axis;
  const double between = dot(apart, apart), across = next[4] - entry[4];
  const double seen = std::sqrt(std::max(0.0, between - across * across));
  const double length = std::sqrt(seen * seen + high * high);
  Vector3 tangent = {0.0, 0.0, 0.0}, force = {0.0, 0.0, 0.0};
  if (between > 0.0 && seen > 0.0) {
    tangent = (seen * apart + across * cross(apart, axis)) / between;
    // (a / L - 1) / a without a difference.
    const double less = high * high / (length * seen * (length + seen)), up = high / length;
    force = tangent - less * apart + up * axis;
  }
  return {start, end, tangent, force, seen, high, length};
}

/// Forces in space where pulleys have a radius.
void apply_over_pulleys(const EffectTable & table, Index row, Table body)
{
  const double * values = table.values.row(row);
  double * entries = table.data.data + table.index(row, effect::DATA);
  const Index pieces = table.index(row, effect::ENTRIES) - 1;
  const Index carrier = static_cast<Index>(values[CARRIER]);
  const Vector3 axis = to_world(body, carrier, vector3(values + AXIS));
  const Vector3 spin = spin_in_space(body, carrier);
  double length = 0.0, rate = 0.0, fleet = 0.0;
  Vector3 before = {0.0, 0.0, 0.0};
  for (Index k = 0; k < pieces; ++k) {
    double * entry = entries + SPATIAL_COLUMNS * k;
    const PulleyPiece piece = tangent_in_space(body, entry, axis);
    const Vector3 velocity =
      velocity_at(body, body_row(entry + SPATIAL_COLUMNS), piece.end) -
      velocity_at(body, body_row(entry), piece.start);
    length += piece.length;
    rate += dot(piece.force, velocity) - dot(spin, cross(piece.end - piece.start, piece.force));
    fleet = std::max(fleet, std::atan2(std::fabs(piece.high), piece.seen));
    if (k > 0 && entry[4] != 0.0) {
      // Seen along the axis: the turn from one tangent to the next.
      entry[5] = wrapped_length(
        entry[4], {1.0, 0.0},
        {dot(before, piece.tangent), dot(cross(before, piece.tangent), axis)});
      length += entry[5];
    }
    before = piece.tangent;
  }
  const double tension = cable_tension(table, row, length, rate);
  table.output(row, 3) = fleet;
  if (tension != 0.0) {
    for (Index k = 0; k < pieces; ++k) {
      const double * entry = entries + SPATIAL_COLUMNS * k;
      const PulleyPiece piece = tangent_in_space(body, entry, axis);
      const Vector3 force = tension * piece.force;
      apply_force_at(body, body_row(entry), piece.start, force);
      apply_force_at(body, body_row(entry + SPATIAL_COLUMNS), piece.end, -force);
      apply_torque(body, carrier, cross(piece.end - piece.start, force));
    }
  }
}
}  // namespace

void apply_cable(const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  double * entries = table.data.data + table.index(row, effect::DATA);
  const Index pieces = table.index(row, effect::ENTRIES) - 1;
  double length = 0.0, rate = 0.0;
  Vector2 before = {0.0, 0.0};
  for (Index k = 0; k < pieces; ++k) {
    double * entry = entries + COLUMNS * k;
    const Line<Vector2> line = straight(body, entry);
    length += line.length;
    rate += line.rate;
    if (k > 0 && entry[3] != 0.0) {
      entry[4] = wrapped_length(entry[3], before, line.direction);
      length += entry[4];
    }
    before = line.direction;
  }
  const double tension = cable_tension(table, row, length, rate);
  if (tension != 0.0) {
    for (Index k = 0; k < pieces; ++k) {
      const double * entry = entries + COLUMNS * k;
      const Line<Vector2> line = straight(body, entry);
      apply_force_at(body, body_row(entry), line.start, tension * line.direction);
      apply_force_at(body, body_row(entry + COLUMNS), line.end, -tension * line.direction);
    }
  }
}

void apply_spatial_cable(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  if (table.values(row, CARRIER) >= 0.0) {
    apply_over_pulleys(table, row, body);
  } else {
    apply_over_guides(table, row, body);
  }
}

}  // namespace closedloop
