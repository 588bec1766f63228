// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ARMS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ARMS_HPP_

#include "effect_table.hpp"

// Effects along a weighted sum of joint coordinates, as of a tendon: l = sum_j r_j q_j. Data of
// such an effect begin with the moment arms r_j. One that is not summed acts in its first joint.

namespace closedloop
{

/// Whether an effect has moment arms.
inline bool has_arms(const EffectTable & table, Index row)
{
  return table.summed[row] == 1;
}

/// The first joint of an effect.
inline Index joint_of(const EffectTable & table, Index row) {return *table.places_of(row);}

/// An effect's weighted sum of quantities of all joints, shape (nv + nk,).
inline double along(const EffectTable & table, Index row, Values joints)
{
  if (!has_arms(table, row)) {
    return joints[joint_of(table, row)];
  }
  const Index * places = table.places_of(row);
  const double * arms = table.data.data + table.first_number[row];
  double sum = 0.0;
  for (Index k = 0; k < table.joints[row]; ++k) {
    sum += arms[k] * joints[places[k]];
  }
  return sum;
}

/// Add a force along that sum to the joints.
inline void exert_along(const EffectTable & table, Index row, double force)
{
  if (!has_arms(table, row)) {
    table.applied[joint_of(table, row)] += force;
    return;
  }
  const Index * places = table.places_of(row);
  const double * arms = table.data.data + table.first_number[row];
  for (Index k = 0; k < table.joints[row]; ++k) {
    table.applied[places[k]] += arms[k] * force;
  }
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ARMS_HPP_
