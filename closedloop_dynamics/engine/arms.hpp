// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ARMS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ARMS_HPP_

#include "effect_table.hpp"

// Effects along a weighted sum of joint coordinates, as of a tendon: l = sum_j r_j q_j. Entries of
// such an effect begin with the joints and their moment arms r_j, two numbers each; without any,
// the effect acts in the joint of EffectTable.index.

namespace closedloop
{

/// How many joints an effect has with moment arms.
inline Index arm_count(const EffectTable & table, Index row)
{
  const Index entries = table.index(row, effect::ENTRIES);
  // Behind those of a spring and damper are two entries, their coefficients.
  return table.kind[row] == effect::TENDON ? entries - 2 : entries;
}

/// An effect's weighted sum of quantities of all joints, shape (nv + nk,).
inline double along(const EffectTable & table, Index row, Values joints)
{
  const Index count = arm_count(table, row);
  if (count == 0) {
    return joints[table.index(row, effect::FIRST)];
  }
  const double * arms = table.data.data + table.index(row, effect::DATA);
  double sum = 0.0;
  for (Index k = 0; k < count; ++k) {
    sum += arms[2 * k + 1] * joints[static_cast<Index>(arms[2 * k])];
  }
  return sum;
}

/// Add a force along that sum to the joints.
inline void exert_along(const EffectTable & table, Index row, double force)
{
  const Index count = arm_count(table, row);
  if (count == 0) {
    table.applied[table.index(row, effect::FIRST)] += force;
    return;
  }
  const double * arms = table.data.data + table.index(row, effect::DATA);
  for (Index k = 0; k < count; ++k) {
    table.applied[static_cast<Index>(arms[2 * k])] += arms[2 * k + 1] * force;
  }
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ARMS_HPP_
