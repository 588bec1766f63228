// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "cut_coordinates.hpp"

#include <cmath>

#include "recursion.hpp"

namespace closedloop
{

namespace
{
/// Angular velocity and velocity of a body's origin, or accelerations.
struct Twist
{
  Vector3 angular;
  Vector3 linear;
};

/// Position of a point of a body in the world [m].
Vector3 point_in_world(
  Table body, Index row, bool planar, Table values, Index k, Index first)
{
  const Vector3 offset = cut_direction(body, row, planar, values, k, first);
  if (planar) {
    return {body(row, plane::PX) + offset.x, body(row, plane::PY) + offset.y, offset.z};
  }
  return origin_in_space(body, row) + offset;
}

/// A position in the world from the origin of a body [m].
Vector3 lever(Table body, Index row, bool planar, Vector3 place)
{
  if (planar) {
    return {place.x - body(row, plane::PX), place.y - body(row, plane::PY), place.z};
  }
  return place - origin_in_space(body, row);
}

Twist velocity_of(Table body, Index row, bool planar)
{
  if (planar) {
    return {
      {0.0, 0.0, body(row, plane::OMEGA)}, {body(row, plane::VX), body(row, plane::VY), 0.0}};
  }
  return {spin_in_space(body, row), vector3(body.row(row) + space::VELOCITY)};
}

/// Accelerations of a row beyond the velocity-product ones.
Twist acceleration_of(Table scratch, Index row, bool planar)
{
  const double * values = scratch.row(row);
  if (planar) {
    return {{0.0, 0.0, values[3]}, {values[4], values[5], 0.0}};
  }
  return {vector3(values + 6), vector3(values + 9)};
}

Twist velocity_product_of(Table body, Index row, bool planar)
{
  if (planar) {
    return {{0.0, 0.0, 0.0}, {body(row, plane::AX), body(row, plane::AY), 0.0}};
  }
  return {
    vector3(body.row(row) + space::SPIN_RATE), vector3(body.row(row) + space::ACCELERATION)};
}

/// Velocity, or acceleration, of a body's point at a lever from its origin.
Vector3 at_lever(Twist motion, Vector3 lever)
{
  return motion.linear + cross(motion.angular, lever);
}

/// Rate of a coordinate; of accelerations the part that they make up.
double rate_along(
  bool slides, Vector3 axis, Vector3 lever_a, Vector3 lever_b, Twist motion_a, Twist motion_b)
{
  if (slides) {
    return dot(axis, at_lever(motion_a, lever_a) - at_lever(motion_b, lever_b));
  }
  return dot(axis, motion_a.angular - motion_b.angular);
}

/// Velocity-product term of the acceleration of a coordinate.
double velocity_product_along(
  bool slides, Vector3 axis, Vector3 lever_a, Vector3 lever_b, Twist motion_a, Twist motion_b)
{
  const Vector3 spin_a = motion_a.angular, spin_b = motion_b.angular;
  if (slides) {
    const Vector3 apart = at_lever(motion_a, lever_a) - at_lever(motion_b, lever_b);
    const Vector3 centripetal =
      cross(spin_a, cross(spin_a, lever_a)) - cross(spin_b, cross(spin_b, lever_b));
    return dot(axis, centripetal - 2.0 * cross(spin_b, apart));
  }
  return dot(cross(spin_b, axis), spin_a - spin_b);
}
}  // namespace

Vector3 cut_direction(
  Table body, Index row, bool planar, Table values, Index k, Index first)
{
  const Vector3 own = vector3(values.row(k) + first);
  if (planar) {
    const Vector2 turned = to_world(body, row, Vector2{own.x, own.y});
    return {turned.x, turned.y, own.z};
  }
  return to_world(body, row, own);
}

void measure_cut_coordinates(
  const EffectTable & effects, Table body, Values position, Values velocity)
{
  const Indexes & index = effects.cuts.index;
  const Table & values = effects.cuts.values;
  const Values & states = effects.states;
  const Index first = position.size - index.rows;
  for (Index k = 0; k < index.rows; ++k) {
    const bool planar = index(k, cut_coordinate::IN_PLANE) == 1;
    const bool slides = index(k, cut_coordinate::SLIDES) == 1;
    const Index a = index(k, cut_coordinate::ROW_A), b = index(k, cut_coordinate::ROW_B);
    const Index followed = index(k, cut_coordinate::FOLLOWED);
    const Vector3 axis = cut_direction(body, b, planar, values, k, cut_coordinate::AXIS);
    const Vector3 place = point_in_world(body, a, planar, values, k, cut_coordinate::POINT_A);
    double found;
    if (slides) {
      found = values(k, cut_coordinate::SCALE) * dot(
        axis, place - point_in_world(body, b, planar, values, k, cut_coordinate::POINT_B));
    } else if (planar) {
      found = body(a, plane::ALPHA) - body(b, plane::ALPHA) - values(k, cut_coordinate::ZERO);
    } else if (index(k, cut_coordinate::RATE_ONLY) == 1) {
      found = followed >= 0 ? states[followed] : 0.0;
    } else {
      const Vector3 side = cut_direction(body, a, planar, values, k, cut_coordinate::SIDE_A);
      found = std::atan2(
        dot(side, cut_direction(body, b, planar, values, k, cut_coordinate::ACROSS_B)),
        dot(side, cut_direction(body, b, planar, values, k, cut_coordinate::SIDE_B)));
      if (followed >= 0) {
        const double turns = (states[followed] - found) / (2.0 * M_PI);
        found += 2.0 * M_PI * std::floor(turns + 0.5);
      }
    }
    position[first + k] = found;
    velocity[first + k] = values(k, cut_coordinate::SCALE) * rate_along(
      slides, axis, lever(body, a, planar, place), lever(body, b, planar, place),
      velocity_of(body, a, planar), velocity_of(body, b, planar));
  }
}

void apply_cut_efforts(
  Indexes index, Table values, Table body, Values efforts, Index first)
{
  for (Index k = 0; k < index.rows; ++k) {
    const bool planar = index(k, cut_coordinate::IN_PLANE) == 1;
    const bool slides = index(k, cut_coordinate::SLIDES) == 1;
    const double effort = values(k, cut_coordinate::SCALE) * efforts[first + k];
    const Vector3 axis = cut_direction(
      body, index(k, cut_coordinate::ROW_B), planar, values, k, cut_coordinate::AXIS);
    const Vector3 place = point_in_world(
      body, index(k, cut_coordinate::ROW_A), planar, values, k, cut_coordinate::POINT_A);
    double sign = 1.0;
    for (Index n = 0; n < 2; ++n) {
      const Index row = index(k, cut_coordinate::ROW_A + n);
      const Vector3 along = (sign * effort) * axis;
      if (slides) {
        const Vector3 arm = lever(body, row, planar, place);
        if (planar) {
          apply_force(body, row, Vector2{arm.x, arm.y}, Vector2{along.x, along.y});
        } else {
          apply_force(body, row, arm, along);
        }
      } else if (planar) {
        apply_torque(body, row, sign * effort);
      } else {
        apply_torque(body, row, along);
      }
      sign = -1.0;
    }
  }
}

void accelerations(
  const EffectTable & effects, const Model & model, const Workspace & work, Values qdd,
  bool whole, Values out)
{
  const CutCoordinates & cuts = effects.cuts;
  const Indexes & index = cuts.index;
  const Table & values = cuts.values, & body = work.body, & scratch = cuts.scratch;
  scratch.fill(0.0);
  newton(model, work, qdd, scratch);
  const Index first = out.size - index.rows;
  for (Index k = 0; k < index.rows; ++k) {
    const bool planar = index(k, cut_coordinate::IN_PLANE) == 1;
    const bool slides = index(k, cut_coordinate::SLIDES) == 1;
    const Index a = index(k, cut_coordinate::ROW_A), b = index(k, cut_coordinate::ROW_B);
    const Vector3 axis = cut_direction(body, b, planar, values, k, cut_coordinate::AXIS);
    const Vector3 place = point_in_world(body, a, planar, values, k, cut_coordinate::POINT_A);
    const Vector3 lever_a = lever(body, a, planar, place);
    const Vector3 lever_b = lever(body, b, planar, place);
    double found = rate_along(
      slides, axis, lever_a, lever_b, acceleration_of(scratch, a, planar),
      acceleration_of(scratch, b, planar));
    if (whole) {
      found += rate_along(
        slides, axis, lever_a, lever_b, velocity_product_of(body, a, planar),
        velocity_product_of(body, b, planar));
      found += velocity_product_along(
        slides, axis, lever_a, lever_b, velocity_of(body, a, planar),
        velocity_of(body, b, planar));
    }
    out[first + k] = values(k, cut_coordinate::SCALE) * found;
  }
}

}  // namespace closedloop
