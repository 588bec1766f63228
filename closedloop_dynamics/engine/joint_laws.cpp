// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <cmath>

#include "arms.hpp"
#include "forces.hpp"
#include "laws.hpp"
#include "manifold.hpp"
#include "sticking.hpp"

namespace closedloop
{

namespace
{
// The driving torque of an actuator fades over this part of its speed range.
constexpr double FADING = 0.1;

/// The largest friction at a rate [N m; N].
double friction_limit(const EffectTable & table, Index row, double rate)
{
  const Values values = table.values[row];
  double level = values[0] + values[3] * table.states[table.index(row, effect::STATE) + 1];
  const double excess = values[1] - 1.0;
  if (excess > 0.0) {
    const double ratio = rate / values[2];
    level *= 1.0 + excess * std::exp(-(ratio * ratio));
  }
  return level;
}

/// List an effect among those whose force follows from accelerations.
void list_sticking(const Sticking & sticking, Index row)
{
  sticking.rows[0] += 1;
  sticking.rows[sticking.rows[0]] = row;
}
}  // namespace

void apply_joint_damping(
  const EffectTable & table, Index row, Table, Values, Values qd, Values)
{
  const Index joint = table.index(row, effect::FIRST), state = table.index(row, effect::STATE);
  const double torque = -table.values(row, 0) * qd[joint];
  table.applied[joint] += torque;
  table.rates[state] = -torque * qd[joint];
  table.output(row, 1) = torque;
}

void apply_joint_spring(
  const EffectTable & table, Index row, Table, Values q, Values, Values)
{
  const Index joint = table.index(row, effect::FIRST);
  const double stiffness = table.values(row, 0);
  const double stretch = q[joint] - table.values(row, 1);
  table.applied[joint] -= stiffness * stretch;
  table.output(row, effect::STORED) = 0.5 * stiffness * stretch * stretch;
  table.output(row, 1) = -stiffness * stretch;
}

void apply_orientation_spring(
  const EffectTable & table, Index row, Table body, Values, Values, Values)
{
  const double * data = table.data.data + table.index(row, effect::DATA);
  const Index a = table.index(row, effect::FIRST), b = table.index(row, effect::SECOND);
  const double stiffness = table.values(row, 0);
  Vector3 axes[3], others[3];
  for (Index k = 0; k < 3; ++k) {
    axes[k] = to_world(body, a, vector3(data + 3 * k));
    others[k] = to_world(body, b, vector3(data + 9 + 3 * k));
  }
  // The child's axes in those of the joint.
  double turned[9], found[4];
  for (Index k = 0; k < 9; ++k) {
    turned[k] = dot(axes[k / 3], others[k % 3]);
  }
  fill_quaternions({turned, 1, 3, 3}, {found, 1, 4});
  const double sine = std::sqrt(
    found[0] * found[0] + found[1] * found[1] + found[2] * found[2]);
  const double angle = 2.0 * std::atan2(sine, found[3]);
  // Beyond the last digit the sine is half the angle.
  const double torque = -stiffness * (sine > 1e-9 ? angle / sine : 2.0);
  const Vector3 moment =
    torque * (found[0] * axes[0] + found[1] * axes[1] + found[2] * axes[2]);
  apply_torque(body, b, moment);
  apply_torque(body, a, -moment);
  table.output(row, effect::STORED) = 0.5 * stiffness * angle * angle;
  table.output(row, 1) = stiffness * angle;
}

void apply_tendon(
  const EffectTable & table, Index row, Table, Values q, Values qd, Values)
{
  const Values values = table.values[row];
  const double * data = table.data.data + table.index(row, effect::DATA);
  const Index springs = static_cast<Index>(values[0]), dampers = static_cast<Index>(values[1]);
  const double * stiffness = data + 2 * arm_count(table, row);
  const double * damping = stiffness + springs;
  const double length = along(table, row, q), rate = along(table, row, qd);
  const double stretch = length - std::max(values[2], std::min(values[3], length));
  const double speed = std::fabs(rate);
  double elastic = 0.0, stored = 0.0, viscous = 0.0, power = stretch;
  for (Index i = 0; i < springs; ++i) {
    elastic += stiffness[i] * power;
    power *= stretch;
    stored += stiffness[i] * power / static_cast<double>(i + 2);
  }
  power = rate;
  for (Index i = 0; i < dampers; ++i) {
    viscous += damping[i] * power;
    power *= speed;
  }
  const double tension = elastic + viscous;
  exert_along(table, row, -tension);
  table.rates[table.index(row, effect::STATE)] = viscous * rate;
  table.output(row, effect::STORED) = stored;
  table.output(row, 1) = tension;
  table.output(row, 2) = length;
}

void apply_end_stop(
  const EffectTable & table, Index row, Table, Values q, Values qd, Values)
{
  const Values values = table.values[row];
  const Index joint = table.index(row, effect::FIRST), state = table.index(row, effect::STATE);
  // Beyond the nearer stop; as a rule less than zero.
  double sign = 1.0, depth = q[joint] - values[2];
  if (values[1] - q[joint] > depth) {
    sign = -1.0;
    depth = values[1] - q[joint];
  }
  const double rate = sign * qd[joint];
  if (!update_contact(table.contacts, row, -depth, -rate)) {
    depth = 0.0;
  }
  const double elastic = values[0] * depth;
  const double push = elastic * std::max(0.0, 1.0 + values[3] * rate);
  table.applied[joint] -= sign * push;
  table.rates[state] = (push - elastic) * rate;
  table.output(row, effect::STORED) = 0.5 * elastic * depth;
  table.output(row, 1) = -sign * push;
  table.output(row, 2) = depth;
}

void apply_joint_friction(
  const EffectTable & table, Index row, Table, Values, Values qd, Values)
{
  const Index state = table.index(row, effect::STATE);
  const double rate = along(table, row, qd);
  const double most = friction_limit(table, row, rate);
  double direction = table.states[state], torque;
  // A joint that breaks away within a step slides from then on.
  if (std::fabs(direction) < 0.5 && std::fabs(rate) > REST) {
    direction = rate;
  }
  if (std::fabs(direction) < 0.5 && std::fabs(rate) <= REST) {
    torque = 0.0;
    // Where loops and motions hold the joint, any friction would do: no response decides it.
    if (table.values(row, 4) == 0.0) {
      list_sticking(table.sticking, row);
      torque = table.sticking.hold[row];
    }
  } else {
    torque = -std::copysign(most, direction);
  }
  exert_along(table, row, torque);
  table.rates[state] = 0.0;
  table.rates[state + 2] = 0.0 - torque * rate;
  table.output(row, 1) = torque;
  table.output(row, 3) = most;
}

void apply_actuator(
  const EffectTable & table, Index row, Table, Values, Values qd, Values tau)
{
  const Values values = table.values[row];
  const Index joint = table.index(row, effect::FIRST), state = table.index(row, effect::STATE);
  const double limit = values[0], rate = qd[joint];
  const double command = std::max(-limit, std::min(limit, tau[joint]));
  double torque = command;
  if (values[2] > 0.0) {
    torque = table.states[state];
    table.rates[state] = (command - torque) / values[2];
    // A limit may have been lowered since.
    torque = std::max(-limit, std::min(limit, torque));
  }
  const double speed = std::fabs(rate);
  if (torque * rate > 0.0 && speed > (1.0 - FADING) * values[1]) {
    torque *= std::max(0.0, 1.0 - speed / values[1]) / FADING;
  }
  table.applied[joint] += torque - tau[joint];
  table.rates[state + 1] = torque * rate;
  table.output(row, 1) = torque;
}

void apply_reflected_inertia(
  const EffectTable & table, Index row, Table, Values, Values qd, Values)
{
  const double inertia = table.values(row, 0), torque = table.sticking.hold[row];
  const double rate = along(table, row, qd);
  if (inertia > 0.0) {
    list_sticking(table.sticking, row);
  }
  exert_along(table, row, torque);
  table.output(row, effect::STORED) = 0.5 * inertia * rate * rate;
  table.output(row, 1) = torque;
  table.output(row, 3) = inertia;
}

}  // namespace closedloop
