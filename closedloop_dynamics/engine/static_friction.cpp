// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "static_friction.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "arms.hpp"

namespace closedloop
{

namespace
{
// Joints whose responses agree to this share one freedom: the first of them bears its load.
constexpr double DEPENDENT = 1e-8;
// Accelerations below this share of their largest term are rounding.
constexpr double ROUNDING = 1e-10;
// Changes of the active set, for each joint; more are a circle among equals.
constexpr Index MOST_CHANGES = 5;

/// Zero the entry of an effect's joint; entries of joints of a tendon remain.
void clear(const EffectTable & table, Index index, Values joints)
{
  const Index row = table.static_friction.rows[index + 1];
  if (!has_arms(table, row)) {
    joints[joint_of(table, row)] = 0.0;
  }
}

/// Factor the matrix of the free unknowns, L D L^T, from the first one on that has changed. L^T is
/// stored above D: what follows a number is beside it in memory.
void factor_free(const StaticFriction & static_friction, Index count, Index first)
{
  const Table & factor = static_friction.factor;
  const Values & row = static_friction.move;
  for (Index a = first; a < count; ++a) {
    factor(a, a) = 0.0;
    for (Index b = 0; b < a; ++b) {
      factor(b, a) = 0.0;
    }
    if (static_friction.free[a] == 0) {
      continue;
    }
    double pivot = static_friction.matrix(a, a);
    copy(static_friction.matrix[a].part(0, a), row.part(0, a));
    for (Index b = 0; b < a; ++b) {
      if (factor(b, b) > 0.0) {
        const double before = row[b], share = before / factor(b, b);
        const double * beside = &factor(b, 0);
        for (Index c = b + 1; c < a; ++c) {
          row[c] -= before * beside[c];
        }
        pivot -= before * share;
        factor(b, a) = share;
      }
    }
    factor(a, a) = pivot > DEPENDENT * static_friction.matrix(a, a) ? pivot : 0.0;
  }
}

/// Move to the minimum in the free unknowns, factored before.
void compute_move(const StaticFriction & static_friction, Index count, Values out)
{
  const Table & matrix = static_friction.matrix, & factor = static_friction.factor;
  const Values & move = static_friction.move;
  for (Index a = 0; a < count; ++a) {
    move[a] = 0.0;
    for (Index b = 0; b < count && factor(a, a) > 0.0; ++b) {
      move[a] -= matrix(a, b) * out[b];
    }
    move[a] -= factor(a, a) > 0.0 ? static_friction.right[a] : 0.0;
  }
  for (Index a = 0; a < count; ++a) {
    for (Index b = a + 1; b < count; ++b) {
      move[b] -= factor(a, b) * move[a];
    }
  }
  for (Index a = count - 1; a >= 0; --a) {
    move[a] = factor(a, a) > 0.0 ? move[a] / factor(a, a) : 0.0;
    for (Index b = a + 1; b < count; ++b) {
      move[a] -= factor(a, b) * move[b];
    }
  }
}

/// Index of the bounded unknown with the steepest descent into the box; negative if none.
Index steepest_bound(const StaticFriction & static_friction, Index count, Values out)
{
  const Table & matrix = static_friction.matrix;
  Index loose = -1;
  double strongest = 0.0;
  for (Index a = 0; a < count; ++a) {
    if (static_friction.free[a] == 1 || out[a] == 0.0) {
      continue;
    }
    double slope = static_friction.right[a], size = std::fabs(static_friction.right[a]);
    for (Index b = 0; b < count; ++b) {
      slope += matrix(a, b) * out[b];
      size += std::fabs(matrix(a, b) * out[b]);
    }
    const double pull = std::copysign(slope, slope * out[a]);
    if (pull > ROUNDING * size && pull * pull > strongest * matrix(a, a)) {
      loose = a;
      strongest = pull * pull / matrix(a, a);
    }
  }
  return loose;
}

/// Whether a joint at rest stays there.
bool stays_at_rest(const EffectTable & table, Index index)
{
  const StaticFriction & static_friction = table.static_friction;
  return table.role[static_friction.rows[index + 1]] != effect::INERTIA &&
         std::fabs(static_friction.share[index]) < static_friction.bound[index] &&
         static_friction.matrix(index, index) > 0.0;
}
}  // namespace

void minimise_in_box(const EffectTable & table, Index count, Values out)
{
  const StaticFriction & static_friction = table.static_friction;
  const Table & matrix = static_friction.matrix;
  const Values & bound = static_friction.bound, & move = static_friction.move;
  const Indices & free = static_friction.free;
  for (Index a = 0; a < count; ++a) {
    out[a] = 0.0;
    free[a] = bound[a] > 0.0 && matrix(a, a) > 0.0 ? 1 : 0;
  }
  Index changed = 0;
  for (Index change = 0; change < MOST_CHANGES * (count + 1); ++change) {
    factor_free(static_friction, count, changed);
    compute_move(static_friction, count, out);
    double share = 1.0;
    Index blocking = -1;
    for (Index a = 0; a < count; ++a) {
      if (std::fabs(out[a] + move[a]) > bound[a] && free[a] == 1) {
        const double most = (std::copysign(bound[a], move[a]) - out[a]) / move[a];
        if (most < share) {
          share = most;
          blocking = a;
        }
      }
    }
    for (Index a = 0; a < count; ++a) {
      out[a] += share * move[a];
    }
    changed = blocking;
    if (blocking >= 0) {
      free[blocking] = 0;
      out[blocking] = std::copysign(bound[blocking], move[blocking]);
    } else {
      const Index loose = steepest_bound(static_friction, count, out);
      if (loose < 0) {
        return;
      }
      free[loose] = 1;
      changed = loose;
    }
  }
}

Values free_response(const StaticFriction & static_friction)
{
  return static_friction.response[static_friction.response.rows - 1];
}

void keep_frictionless(const EffectTable & table, Values qdd, Values lam)
{
  const Values base = free_response(table.static_friction);
  for (Index i = 0; i < qdd.size; ++i) {
    base[i] = qdd[i];
  }
  for (Index i = 0; i < lam.size; ++i) {
    base[qdd.size + i] = lam[i];
  }
}

void keep_response(const EffectTable & table, Index index, Values qdd, Values lam)
{
  const StaticFriction & static_friction = table.static_friction;
  const Values base = free_response(static_friction), response = static_friction.response[index];
  const Index nv = qdd.size;
  for (Index i = 0; i < nv; ++i) {
    response[i] = qdd[i] - base[i];
  }
  for (Index i = 0; i < lam.size; ++i) {
    response[nv + i] = lam[i] - base[nv + i];
  }
  const Index row = static_friction.rows[index + 1];
  exert_along(table, row, -static_friction.hold[row]);
  static_friction.hold[row] = 0.0;
}

Values response_to_hold(const EffectTable & table, Index index)
{
  return table.static_friction.response[index];
}

void keep_responses(const EffectTable & table)
{
  const StaticFriction & static_friction = table.static_friction;
  if (static_friction.kept[0] == 1) {
    for (Index index = 0; index <= static_friction.rows[0]; ++index) {
      static_friction.kept[index + 1] = static_friction.rows[index];
    }
    for (Index index = 0; index < static_friction.rows[0]; ++index) {
      static_friction.kept_limit[index] = table.output(static_friction.rows[index + 1], 3);
    }
  }
}

bool are_responses_kept(const EffectTable & table)
{
  const StaticFriction & static_friction = table.static_friction;
  for (Index index = 0; index <= static_friction.rows[0]; ++index) {
    if (static_friction.kept[index + 1] != static_friction.rows[index]) {
      return false;
    }
  }
  for (Index index = 0; index < static_friction.rows[0]; ++index) {
    if (static_friction.kept_limit[index] != table.output(static_friction.rows[index + 1], 3)) {
      return false;
    }
  }
  return true;
}

void balance_friction(const EffectTable & table, Values qdd, Values lam)
{
  const StaticFriction & static_friction = table.static_friction;
  const Index nv = qdd.size, count = static_friction.rows[0];
  const Table & response = static_friction.response;
  const Values base = free_response(static_friction);
  for (Index a = 0; a < count; ++a) {
    const Index row = static_friction.rows[a + 1];
    const double limit = table.output(row, 3);
    static_friction.right[a] = limit * along(table, row, base);
    static_friction.bound[a] =
      static_friction.holds[row] == 1 ? std::numeric_limits<double>::infinity() : 1.0;
    for (Index b = 0; b < count; ++b) {
      static_friction.matrix(a, b) = limit * along(table, row, response[b]);
    }
    if (table.role[row] == effect::INERTIA) {
      // Its limit is its inertia: the force of a unit acceleration.
      static_friction.bound[a] = std::numeric_limits<double>::infinity();
      static_friction.matrix(a, a) += limit;
    }
  }
  minimise_in_box(table, count, static_friction.share);
  for (Index i = 0; i < nv; ++i) {
    qdd[i] = base[i];
  }
  for (Index i = 0; i < lam.size; ++i) {
    lam[i] = base[nv + i];
  }
  for (Index a = 0; a < count; ++a) {
    const Index row = static_friction.rows[a + 1];
    const double share = static_friction.share[a], friction = share * table.output(row, 3);
    exert_along(table, row, friction);
    table.output(row, 1) = friction;
    for (Index i = 0; i < nv; ++i) {
      qdd[i] += share * response(a, i);
    }
    for (Index i = 0; i < lam.size; ++i) {
      lam[i] += share * response(a, nv + i);
    }
  }
  for (Index a = 0; a < count; ++a) {
    if (stays_at_rest(table, a)) {
      clear(table, a, qdd);
    }
  }
}

HeldJoints::HeldJoints(const EffectTable & effects)
: effects_(effects)
{
  const StaticFriction & static_friction = effects.static_friction;
  for (Index a = 0; static_friction.rows.size > 0 && a < static_friction.rows[0]; ++a) {
    if (stays_at_rest(effects, a)) {
      static_friction.holds[static_friction.rows[a + 1]] = 1;
      any_ = true;
      start_ = std::max(start_, std::fabs(static_friction.share[a]));
    }
  }
}

double HeldJoints::release(double size)
{
  if (any_) {
    effects_.static_friction.holds.fill(0);
    any_ = false;
  }
  return size;
}

void HeldJoints::begin_step() const
{
  if (any_) {
    effects_.static_friction.load.fill(0.0);
  }
}

bool HeldJoints::is_overloaded() const
{
  return any_ && effects_.static_friction.load[1] > BREAKAWAY + NEAR_BREAKAWAY;
}

double HeldJoints::load() const {return effects_.static_friction.load[0];}

void store_load(const EffectTable & effects)
{
  const StaticFriction & static_friction = effects.static_friction;
  double most = 0.0;
  for (Index a = 0; a < static_friction.rows[0]; ++a) {
    if (static_friction.holds[static_friction.rows[a + 1]] == 1) {
      most = std::max(most, std::fabs(static_friction.share[a]));
    }
  }
  static_friction.load[0] = most;
  static_friction.load[1] = std::max(static_friction.load[1], most);
}

void hold_by_responses(const EffectTable & table, Values qdd, Values lam)
{
  const StaticFriction & static_friction = table.static_friction;
  Index & count = static_friction.rows[0];
  Index number = 0;
  count = 0;
  for (Index row = 0; row < table.count(); ++row) {
    if (table.role[row] == effect::FRICTION) {
      const double limit = static_friction.right[number];
      if (limit > 0.0) {
        if (count < number) {
          copy(static_friction.response[number], static_friction.response[count]);
        }
        static_friction.rows[++count] = row;
        table.output(row, 3) = limit;
      }
      ++number;
    }
  }
  if (count > 0) {
    table.applied.fill(0.0);
    keep_frictionless(table, qdd, lam);
    balance_friction(table, qdd, lam);
    store_load(table);
  }
}

void stop_sticking_joints(const EffectTable & table, Values qd)
{
  const StaticFriction & static_friction = table.static_friction;
  const Index count = static_friction.rows[0];
  for (Index a = 0; a < count; ++a) {
    const Index row = static_friction.rows[a + 1];
    static_friction.right[a] = table.output(row, 3) * along(table, row, qd);
    static_friction.bound[a] =
      stays_at_rest(table, a) ? std::numeric_limits<double>::infinity() : 0.0;
  }
  minimise_in_box(table, count, static_friction.impulse);
  for (Index a = 0; a < count; ++a) {
    for (Index i = 0; i < qd.size; ++i) {
      qd[i] += static_friction.impulse[a] * static_friction.response(a, i);
    }
  }
  for (Index a = 0; a < count; ++a) {
    if (static_friction.bound[a] > 0.0) {
      clear(table, a, qd);
    }
  }
}

}  // namespace closedloop
