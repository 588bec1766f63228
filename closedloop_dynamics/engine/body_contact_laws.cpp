// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <cmath>

#include "curve.hpp"
#include "forces.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
// Entries of a contact in space: both places, normal or axis, 1 for a plane, 1 for a cylinder.
constexpr Index PLACE_B = 3, DIRECTION = 6, FLAT = 9, ROUND = 10;

/// Hunt and Crossley's normal force, and friction; written to the row, too.
ContactForces contact_forces(
  const EffectTable & table, Index row, double gap, double rate, double slip)
{
  const Values values = table.values[row], output = table.output[row];
  const double elastic = elastic_force(values[6], values[7], gap);
  const double normal = elastic * std::max(0.0, 1.0 + values[8] * rate);
  const double along =
    -values[9] * normal * slip / std::sqrt(slip * slip + values[10] * values[10]);
  table.rates[table.index(row, effect::STATE)] = (normal - elastic) * rate - along * slip;
  output[effect::STORED] = -elastic * gap / (values[7] + 1.0);
  output[1] = -gap;
  output[2] = normal;
  output[3] = along;
  output[4] = slip;
  return {normal, along};
}

/// Press two bodies apart. `center`: of the roller, `distance`: of that from the line or curve,
/// negative beyond it, in the world [m]; `out`: the normal, towards the roller.
void press(
  const EffectTable & table, Index row, Table body, Vector2 center, Vector2 out, double distance)
{
  const double radius = table.values(row, 4), gap = distance - radius;
  const Vector2 place = center - radius * out;
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  table.output[row].fill(0.0);
  const Vector2 velocity = velocity_at(body, a, place) - velocity_at(body, b, place);
  // Along the free side's boundary: (y, -x).
  const double rate = -dot(out, velocity), slip = out.y * velocity.x - out.x * velocity.y;
  if (update_contact(table.contacts, row, gap, -rate)) {
    const auto [normal, along] = contact_forces(table, row, gap, rate, slip);
    const Vector2 force = {normal * out.x + along * out.y, normal * out.y - along * out.x};
    apply_force_at(body, a, place, force);
    apply_force_at(body, b, place, -force);
  }
}

/// Store the path of a roller beside a circle or a curve. `center`: in the world; `in_body`: as
/// seen from the other body [m].
void store_path_in_plane(
  const EffectTable & table, Index row, Table body, Vector2 center, Vector2 in_body)
{
  const Vector2 velocity = velocity_at(body, table.index(row, effect::FIRST), center) -
    velocity_at(body, table.index(row, effect::SECOND), center);
  store_path(
    table.contacts, row, {in_body.x, in_body.y, 0.0}, std::sqrt(dot(velocity, velocity)));
}

/// Center of the roller in the world [m].
Vector2 roller_center(const EffectTable & table, Index row, Table body)
{
  return position(body, table.index(row, effect::FIRST), vector2(table.values.row(row)));
}

/// The named point of the other body in the world [m].
Vector2 other_point(const EffectTable & table, Index row, Table body)
{
  return position(body, table.index(row, effect::SECOND), vector2(table.values.row(row) + 2));
}
}  // namespace

void apply_line_contact(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const Values values = table.values[row];
  const Vector2 center = roller_center(table, row, body);
  const Vector2 apart = center - other_point(table, row, body);
  const Vector2 line =
    to_world(body, table.index(row, effect::SECOND), Vector2{values[5], values[11]});
  press(table, row, body, center, {-line.y, line.x}, cross(line, apart));
}

void apply_circle_contact(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const Values values = table.values[row];
  const Vector2 center = roller_center(table, row, body);
  const Vector2 apart = center - other_point(table, row, body);
  const double between = std::sqrt(dot(apart, apart)), side = values[11];
  store_path_in_plane(table, row, body, center, apart);
  // Where the centers meet there is no direction, and no force.
  update_contact(table.contacts, row, side * (between - values[5]) - values[4], 0.0);
  if (between > 0.0) {
    press(table, row, body, center, side * (apart / between), side * (between - values[5]));
  }
}

void apply_curve_contact(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const Index b = table.index(row, effect::SECOND);
  const Vector2 center = roller_center(table, row, body);
  const Vector2 apart = center - other_point(table, row, body);
  const double cosine = body(b, plane::COS), sine = body(b, plane::SIN);
  const Vector2 in_body = {
    cosine * apart.x + sine * apart.y, cosine * apart.y - sine * apart.x};
  store_path_in_plane(table, row, body, center, in_body);
  const CurveDistance found = distance_from_curve(
    pieces_of_curve(table, row), in_body, table.values(row, 5) == 1.0,
    table.code.present.row(row));
  press(table, row, body, center, to_world(body, b, found.normal), found.distance);
}

void apply_face_contact(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const Values values = table.values[row];
  const Index b = table.index(row, effect::SECOND);
  // The face is a line of the first body; its normal points away from that.
  const Vector2 line =
    to_world(body, table.index(row, effect::FIRST), Vector2{values[5], values[11]});
  const Vector2 out = {-line.y, line.x};
  const double cosine = body(b, plane::COS), sine = body(b, plane::SIN);
  const Vector2 deepest = furthest_of_curve(
    pieces_of_curve(table, row), {-cosine * out.x - sine * out.y, sine * out.x - cosine * out.y});
  const Vector2 place = other_point(table, row, body) + to_world(body, b, deepest);
  press(
    table, row, body, place, -out, dot(out, place - roller_center(table, row, body)));
}

void apply_spatial_body_contact(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const Values values = table.values[row];
  const double * data = table.data.data + table.index(row, effect::DATA);
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  const double radius = values[4], side = values[11];
  const Vector3 center = position(body, a, vector3(data));
  const Vector3 direction = to_world(body, b, vector3(data + DIRECTION));
  Vector3 out = center - position(body, b, vector3(data + PLACE_B));
  const double height = dot(direction, out);
  // A cylinder: without the component along its axis.
  out = out - (data[ROUND] * height) * direction;
  const double between = std::sqrt(dot(out, out));
  double distance;
  if (data[FLAT] == 1.0) {
    out = direction;
    distance = height;
  } else if (between > 0.0) {
    distance = side * (between - values[5]);
    out = (side * out) / between;
  } else {
    // Where the centers meet there is no direction, and no force.
    distance = -side * values[5];
  }
  const double gap = distance - radius;
  const Vector3 place = center - radius * out;
  table.output[row].fill(0.0);
  const Vector3 approach = velocity_at(body, a, center) - velocity_at(body, b, center);
  store_path(table.contacts, row, between * out, std::sqrt(dot(approach, approach)));
  const Vector3 velocity = velocity_at(body, a, place) - velocity_at(body, b, place);
  const double rate = -dot(out, velocity);
  if (update_contact(table.contacts, row, gap, -rate)) {
    // The tangential part of the velocity.
    const Vector3 sliding = velocity + rate * out;
    const double slip = std::sqrt(dot(sliding, sliding));
    const auto [normal, along] = contact_forces(table, row, gap, rate, slip);
    const double drag = slip > 0.0 ? along / slip : 0.0;
    const Vector3 force = normal * out + drag * sliding;
    apply_force_at(body, a, place, force);
    apply_force_at(body, b, place, -force);
  }
}

}  // namespace closedloop
