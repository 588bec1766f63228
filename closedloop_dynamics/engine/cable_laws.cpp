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

/// The axis that all pulleys lie across; in the plane its normal.
template<class V>
struct Pulleys
{
  /// Component along the axis, and a vector along it.
  double height(V) const {return 0.0;}
  V raised(double) const {return {0.0, 0.0};}
  /// A vector across the axis, turned by a right angle to the right.
  V turned(V a) const {return {a.y, -a.x};}
  /// Vector product as seen along the axis.
  double product(V a, V b) const {return cross(a, b);}
  /// Rate of the length by the turning of the axis, and the moment that this makes, of a piece from
  /// end to end and its force.
  double turning(Table, V, V) const {return 0.0;}
  void twist(Table, V, V) const {}
};

template<>
struct Pulleys<Vector3>
{
  /// Zero where no pulley has a radius.
  Vector3 axis;
  /// Row of the body that it turns with; negative likewise.
  Index carrier;

  double height(Vector3 a) const {return dot(a, axis);}
  Vector3 raised(double height) const {return height * axis;}
  Vector3 turned(Vector3 a) const {return cross(a, axis);}
  double product(Vector3 a, Vector3 b) const {return dot(cross(a, b), axis);}
  double turning(Table body, Vector3 apart, Vector3 force) const
  {
    return carrier < 0 ? 0.0 : -dot(spin_in_space(body, carrier), cross(apart, force));
  }
  void twist(Table body, Vector3 apart, Vector3 force) const
  {
    if (carrier >= 0) {
      apply_torque(body, carrier, cross(apart, force));
    }
  }
};

/// A straight piece of cable between points, or centers of pulleys (doc/theory.md).
template<class V>
struct Piece
{
  /// Rows of the bodies at both ends, and the places there [m].
  Index first;
  Index second;
  V start;
  V end;
  /// Direction as seen along the axis, and f: the gradient of the length.
  V tangent;
  V force;
  /// Length as seen along the axis, along the axis, and in all: a, h, L [m].
  double seen;
  double high;
  double length;
};

template<class V, Index columns>
Piece<V> piece_at(Table body, const double * entry, const Pulleys<V> & pulleys)
{
  const double * next = entry + columns;
  const Index first = static_cast<Index>(entry[0]), second = static_cast<Index>(next[0]);
  const V start = position(body, first, vector_at(entry + 1, V()));
  const V end = position(body, second, vector_at(next + 1, V()));
  const double high = pulleys.height(end - start);
  const V apart = end - start - pulleys.raised(high);
  // The line of centers has a component along the tangent, and one across: the difference of the
  // radii.
  const double between = dot(apart, apart), across = next[columns - 2] - entry[columns - 2];
  const double seen = std::sqrt(std::max(0.0, between - across * across));
  V tangent = {}, force = {};
  if (between > 0.0) {
    force = tangent = (seen * apart + across * pulleys.turned(apart)) / between;
  }
  double length = seen;
  if (high != 0.0) {
    length = std::sqrt(seen * seen + high * high);
    if (seen > 0.0) {
      // (a / L - 1) / a without a difference.
      const double less = high * high / (length * seen * (length + seen));
      force = tangent - less * apart + pulleys.raised(high / length);
    }
  }
  return {first, second, start, end, tangent, force, seen, high, length};
}

/// Length of cable on a pulley, of the scalar and the vector product of the directions before and
/// after it [m].
double wrapped_length(double radius, double cosine, double sine)
{
  // A quarter turn from -180 to 180 degrees: -90 to 270.
  const double turn = 0.5 * M_PI + std::atan2(-cosine, std::copysign(1.0, radius) * sine);
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

template<class V, Index columns>
void apply_over(
  const EffectTable & table, Index row, Table body, const Pulleys<V> & pulleys)
{
  double * entries = table.data.data + table.index(row, effect::DATA);
  const double * last = entries + columns * (table.index(row, effect::ENTRIES) - 1);
  double length = 0.0, rate = 0.0, fleet = 0.0;
  V before = {};
  for (double * entry = entries; entry < last; entry += columns) {
    const Piece<V> piece = piece_at<V, columns>(body, entry, pulleys);
    const V velocity = velocity_at(body, piece.second, piece.end) -
      velocity_at(body, piece.first, piece.start);
    length += piece.length;
    rate += dot(piece.force, velocity) +
      pulleys.turning(body, piece.end - piece.start, piece.force);
    if (piece.high != 0.0) {
      fleet = std::max(fleet, std::atan2(std::fabs(piece.high), piece.seen));
    }
    const double radius = entry[columns - 2];
    if (entry > entries && radius != 0.0) {
      entry[columns - 1] = wrapped_length(
        radius, dot(before, piece.tangent), pulleys.product(before, piece.tangent));
      length += entry[columns - 1];
    }
    before = piece.tangent;
  }
  const double tension = cable_tension(table, row, length, rate);
  table.output(row, 3) = fleet;
  if (tension != 0.0) {
    for (const double * entry = entries; entry < last; entry += columns) {
      const Piece<V> piece = piece_at<V, columns>(body, entry, pulleys);
      const V force = tension * piece.force;
      apply_force_at(body, piece.first, piece.start, force);
      apply_force_at(body, piece.second, piece.end, -force);
      pulleys.twist(body, piece.end - piece.start, force);
    }
  }
}
}  // namespace

void apply_cable(const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  apply_over<Vector2, COLUMNS>(table, row, body, {});
}

void apply_spatial_cable(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * values = table.values.row(row);
  const Index carrier = static_cast<Index>(values[CARRIER]);
  Vector3 axis = {0.0, 0.0, 0.0};
  if (carrier >= 0) {
    axis = to_world(body, carrier, vector3(values + AXIS));
  }
  apply_over<Vector3, SPATIAL_COLUMNS>(table, row, body, {axis, carrier});
}

}  // namespace closedloop
