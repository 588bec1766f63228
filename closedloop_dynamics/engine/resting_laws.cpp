// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <cmath>

#include "arms.hpp"
#include "laws.hpp"
#include "static_friction.hpp"

namespace closedloop
{

namespace
{
/// List an effect among those whose force follows from accelerations, and apply its part of it.
void hold(const EffectTable & table, Index row)
{
  const StaticFriction & static_friction = table.static_friction;
  static_friction.rows[0] += 1;
  static_friction.rows[static_friction.rows[0]] = row;
  exert_along(table, row, static_friction.hold[row]);
  table.output(row, 1) = static_friction.hold[row];
}
}  // namespace

void apply_friction(
  const EffectTable & table, Index row, Table body, Values q, Values qd, Values tau)
{
  apply_generated(table, row, body, q, qd, tau);
  const Index state = table.first_state[row];
  const double rate = along(table, row, qd);
  // Where loops and motions hold the joint, any friction would do: no response determines it.
  if (std::fabs(table.states[state]) < 0.5 && std::fabs(rate) <= REST &&
    table.values(row, 4) == 0.0)
  {
    hold(table, row);
    table.rates[state + 2] = 0.0 - table.static_friction.hold[row] * rate;
  }
}

void apply_reflected_inertia(
  const EffectTable & table, Index row, Table, Values, Values qd, Values)
{
  const double inertia = table.values(row, 0), rate = along(table, row, qd);
  table.output(row, 1) = 0.0;
  if (inertia > 0.0) {
    hold(table, row);
  }
  table.output(row, effect::STORED) = 0.5 * inertia * rate * rate;
  table.output(row, 3) = inertia;
}

}  // namespace closedloop
