// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <cmath>

#include "arms.hpp"
#include "laws.hpp"
#include "sticking.hpp"

namespace closedloop
{

namespace
{
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
