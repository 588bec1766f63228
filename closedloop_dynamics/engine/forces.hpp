// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__FORCES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__FORCES_HPP_

#include <cmath>

#include "array.hpp"
#include "columns.hpp"
#include "effect_table.hpp"

// Vectors, and forces at points of bodies, in the plane and in space. `body` is Workspace.body
// after `outward`, `row` a body's row, 0 for the ground; vectors are in world axes unless stated
// otherwise. Functions are overloaded for the plane and for space by the type of the vectors.

namespace closedloop
{

/// A vector in the plane.
struct Vector2
{
  double x;
  double y;
};

/// A vector in space.
struct Vector3
{
  double x;
  double y;
  double z;
};

inline Vector2 operator+(Vector2 a, Vector2 b) {return {a.x + b.x, a.y + b.y};}
inline Vector2 operator-(Vector2 a, Vector2 b) {return {a.x - b.x, a.y - b.y};}
inline Vector2 operator-(Vector2 a) {return {-a.x, -a.y};}
inline Vector2 operator*(double factor, Vector2 a) {return {factor * a.x, factor * a.y};}
inline Vector2 operator/(Vector2 a, double divisor) {return {a.x / divisor, a.y / divisor};}
inline Vector3 operator+(Vector3 a, Vector3 b) {return {a.x + b.x, a.y + b.y, a.z + b.z};}
inline Vector3 operator-(Vector3 a, Vector3 b) {return {a.x - b.x, a.y - b.y, a.z - b.z};}
inline Vector3 operator-(Vector3 a) {return {-a.x, -a.y, -a.z};}
inline Vector3 operator*(double factor, Vector3 a)
{
  return {factor * a.x, factor * a.y, factor * a.z};
}
inline Vector3 operator/(Vector3 a, double divisor)
{
  return {a.x / divisor, a.y / divisor, a.z / divisor};
}

/// Scalar products.
inline double dot(Vector2 a, Vector2 b) {return a.x * b.x + a.y * b.y;}
inline double dot(Vector3 a, Vector3 b) {return a.x * b.x + a.y * b.y + a.z * b.z;}

/// Vector products; in the plane the component out of it.
inline double cross(Vector2 a, Vector2 b) {return a.x * b.y - a.y * b.x;}
inline Vector3 cross(Vector3 a, Vector3 b)
{
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// The two or three numbers at a place, as a vector.
inline Vector2 vector2(const double * at) {return {at[0], at[1]};}
inline Vector3 vector3(const double * at) {return {at[0], at[1], at[2]};}
inline Vector2 vector_at(const double * at, Vector2) {return vector2(at);}
inline Vector3 vector_at(const double * at, Vector3) {return vector3(at);}

/// Place of a body's origin [m].
inline Vector2 origin_in_plane(Table body, Index row)
{
  return {body(row, plane::PX), body(row, plane::PY)};
}
inline Vector3 origin_in_space(Table body, Index row)
{
  return vector3(body.row(row) + space::ORIGIN);
}
inline Vector2 origin(Table body, Index row, Vector2) {return origin_in_plane(body, row);}
inline Vector3 origin(Table body, Index row, Vector3) {return origin_in_space(body, row);}

/// Angular velocity of a body [rad/s].
inline Vector3 spin_in_space(Table body, Index row)
{
  return vector3(body.row(row) + space::SPIN);
}

/// Rotate a vector from a body's axes to those of the world.
inline Vector2 to_world(Table body, Index row, Vector2 a)
{
  const double cosine = body(row, plane::COS), sine = body(row, plane::SIN);
  return {cosine * a.x - sine * a.y, sine * a.x + cosine * a.y};
}
inline Vector3 to_world(Table body, Index row, Vector3 a)
{
  const double * frame = body.row(row) + space::FRAME;
  return {
    frame[0] * a.x + frame[1] * a.y + frame[2] * a.z,
    frame[3] * a.x + frame[4] * a.y + frame[5] * a.z,
    frame[6] * a.x + frame[7] * a.y + frame[8] * a.z};
}

/// Position in the world of a point in a body's frame [m].
template<class V>
inline V position(Table body, Index row, V point)
{
  return origin(body, row, point) + to_world(body, row, point);
}

/// Velocity of a body's point at an offset from its origin [m, m/s].
inline Vector2 velocity_at_offset(Table body, Index row, Vector2 offset)
{
  const double omega = body(row, plane::OMEGA);
  return {body(row, plane::VX) - omega * offset.y, body(row, plane::VY) + omega * offset.x};
}
inline Vector3 velocity_at_offset(Table body, Index row, Vector3 offset)
{
  const Vector3 spin = spin_in_space(body, row);
  const double * origin = body.row(row) + space::VELOCITY;
  return {
    origin[0] + spin.y * offset.z - spin.z * offset.y,
    origin[1] + spin.z * offset.x - spin.x * offset.z,
    origin[2] + spin.x * offset.y - spin.y * offset.x};
}

/// Velocity of a body's point at a position in the world [m, m/s].
template<class V>
inline V velocity_at(Table body, Index row, V position)
{
  return velocity_at_offset(body, row, position - origin(body, row, position));
}

/// Apply a torque to a body [N m]: its bias force is reduced.
inline void apply_torque(Table body, Index row, double torque) {body(row, plane::FZ) -= torque;}
inline void apply_torque(Table body, Index row, Vector3 torque)
{
  double * bias = body.row(row) + space::FORCE;
  bias[0] -= torque.x;
  bias[1] -= torque.y;
  bias[2] -= torque.z;
}

/// Apply a force to a body at an offset from its origin [m, N]: its bias force is reduced.
inline void apply_force(Table body, Index row, Vector2 offset, Vector2 force)
{
  apply_torque(body, row, cross(offset, force));
  body(row, plane::FX) -= force.x;
  body(row, plane::FY) -= force.y;
}
inline void apply_force(Table body, Index row, Vector3 offset, Vector3 force)
{
  apply_torque(body, row, cross(offset, force));
  double * bias = body.row(row) + space::FORCE;
  bias[3] -= force.x;
  bias[4] -= force.y;
  bias[5] -= force.z;
}

/// Apply a force to a body at a position in the world [m, N].
template<class V>
inline void apply_force_at(Table body, Index row, V position, V force)
{
  apply_force(body, row, position - origin(body, row, position), force);
}

/// The line between points of two bodies, in the plane or in space.
template<class V>
struct Line
{
  /// Positions of both points [m].
  V start;
  V end;
  /// Zero where they meet.
  V direction;
  /// [m], [m/s]
  double length;
  double rate;
};

/// The line from a point of body `a` to one of body `b`, each in its body's frame [m].
template<class V>
Line<V> line_between(Table body, Index a, V point_a, Index b, V point_b)
{
  const V start = position(body, a, point_a), end = position(body, b, point_b);
  const V velocity = velocity_at(body, b, end) - velocity_at(body, a, start);
  Line<V> line = {start, end, end - start, 0.0, 0.0};
  line.length = std::sqrt(dot(line.direction, line.direction));
  if (line.length > 0.0) {
    line.direction = line.direction / line.length;
    line.rate = dot(line.direction, velocity);
  }
  return line;
}

/// Store a gap [m, rad], negative where bodies touch, and its rate; return whether there is
/// contact.
bool update_contact(const Contacts &, Index row, double gap, double rate);

/// Store the path of a roller beside a body of finite extent that it may pass: the place of its
/// center, in axes in which the body rests, and its speed relative to the body [m, m/s].
void store_path(const Contacts &, Index row, Vector3 place, double speed);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__FORCES_HPP_
