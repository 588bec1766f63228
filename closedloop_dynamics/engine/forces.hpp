// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__FORCES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__FORCES_HPP_

#include "array.hpp"
#include "columns.hpp"

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

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__FORCES_HPP_
