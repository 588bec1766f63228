// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "sticking.hpp"

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
void clear(const EffectTable & table, Index place, Values joints)
{
  const Index row = table.sticking.rows[place + 1];
  if (!has_arms(table, row)) {
    joints[joint_of(table, row)] = 0.0;
  }
}

/// Factor the matrix of the free unknowns, L D L^T, from the first one on that has changed. L^T is
/// stored above D: what follows a number is beside it in memory.
void factor_free(const StaticFriction & sticking, Index count, Index first)
{
  const Table & factor = sticking.factor;
  const Values & row = sticking.move;
  for (Index a = first; a < count; ++a) {
    factor(a, a) = 0.0;
    for (Index b = 0; b < a; ++b) {
      factor(b, a) = 0.0;
    }
    if (sticking.free[a] == 0) {
      continue;
    }
    double pivot = sticking.matrix(a, a);
    copy(sticking.matrix[a].part(0, a), row.part(0, a));
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
    factor(a, a) = pivot > DEPENDENT * sticking.matrix(a, a) ? pivot : 0.0;
  }
}

/// Move to the minimum in the free unknowns, factored before.
void compute_move(const StaticFriction & sticking, Index count, Values out)
{
  const Table & matrix = sticking.matrix, & factor = sticking.factor;
  const Values & move = sticking.move;
  for (Index a = 0; a < count; ++a) {
    move[a] = 0.0;
    for (Index b = 0; b < count && factor(a, a) > 0.0; ++b) {
      move[a] -= matrix(a, b) * out[b];
    }
    move[a] -= factor(a, a) > 0.0 ? sticking.right[a] : 0.0;
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
Index steepest_bound(const StaticFriction & sticking, Index count, Values out)
{
  const Table & matrix = sticking.matrix;
  Index loose = -1;
  double strongest = 0.0;
  for (Index a = 0; a < count; ++a) {
    if (sticking.free[a] == 1 || out[a] == 0.0) {
      continue;
    }
    double slope = sticking.right[a], size = std::fabs(sticking.right[a]);
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
bool stays_at_rest(const EffectTable & table, Index place)
{
  const StaticFriction & sticking = table.sticking;
  return table.role[sticking.rows[place + 1]] != effect::INERTIA &&
         std::fabs(sticking.share[place]) < 1.0 && sticking.matrix(place, place) > 0.0;
}
}  // namespace

void minimise_in_box(const EffectTable & table, Index count, Values out)
{
  const StaticFriction & sticking = table.sticking;
  const Table & matrix = sticking.matrix;
  const Values & bound = sticking.bound, & move = sticking.move;
  const Indices & free = sticking.free;
  for (Index a = 0; a < count; ++a) {
    out[a] = 0.0;
    free[a] = bound[a] > 0.0 && matrix(a, a) > 0.0 ? 1 : 0;
  }
  Index changed = 0;
  for (Index change = 0; change < MOST_CHANGES * (count + 1); ++change) {
    factor_free(sticking, count, changed);
    compute_move(sticking, count, out);
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
      const Index loose = steepest_bound(sticking, count, out);
      if (loose < 0) {
        return;
      }
      free[loose] = 1;
      changed = loose;
    }
  }
}

Values free_response(const StaticFriction & sticking)
{
  return sticking.response[sticking.response.rows - 1];
}

void keep_frictionless(const EffectTable & table, Values qdd, Values lam)
{
  const Values base = free_response(table.sticking);
  for (Index i = 0; i < qdd.size; ++i) {
    base[i] = qdd[i];
  }
  for (Index i = 0; i < lam.size; ++i) {
    base[qdd.size + i] = lam[i];
  }
}

void keep_response(const EffectTable & table, Index place, Values qdd, Values lam)
{
  const StaticFriction & sticking = table.sticking;
  const Values base = free_response(sticking), response = sticking.response[place];
  const Index nv = qdd.size;
  for (Index i = 0; i < nv; ++i) {
    response[i] = qdd[i] - base[i];
  }
  for (Index i = 0; i < lam.size; ++i) {
    response[nv + i] = lam[i] - base[nv + i];
  }
  const Index row = sticking.rows[place + 1];
  exert_along(table, row, -sticking.hold[row]);
  sticking.hold[row] = 0.0;
}

Values response_to_hold(const EffectTable & table, Index place)
{
  return table.sticking.response[place];
}

void keep_responses(const EffectTable & table)
{
  const StaticFriction & sticking = table.sticking;
  if (sticking.kept[0] == 1) {
    for (Index place = 0; place <= sticking.rows[0]; ++place) {
      sticking.kept[place + 1] = sticking.rows[place];
    }
    for (Index place = 0; place < sticking.rows[0]; ++place) {
      sticking.kept_limit[place] = table.output(sticking.rows[place + 1], 3);
    }
  }
}

bool are_responses_kept(const EffectTable & table)
{
  const StaticFriction & sticking = table.sticking;
  for (Index place = 0; place <= sticking.rows[0]; ++place) {
    if (sticking.kept[place + 1] != sticking.rows[place]) {
      return false;
    }
  }
  for (Index place = 0; place < sticking.rows[0]; ++place) {
    if (sticking.kept_limit[place] != table.output(sticking.rows[place + 1], 3)) {
      return false;
    }
  }
  return true;
}

void balance_friction(const EffectTable & table, Values qdd, Values lam)
{
  const StaticFriction & sticking = table.sticking;
  const Index nv = qdd.size, count = sticking.rows[0];
  const Table & response = sticking.response;
  const Values base = free_response(sticking);
  for (Index a = 0; a < count; ++a) {
    const Index row = sticking.rows[a + 1];
    const double limit = table.output(row, 3);
    sticking.right[a] = limit * along(table, row, base);
    sticking.bound[a] = 1.0;
    for (Index b = 0; b < count; ++b) {
      sticking.matrix(a, b) = limit * along(table, row, response[b]);
    }
    if (table.role[row] == effect::INERTIA) {
      // Its limit is its inertia: the force of a unit acceleration.
      sticking.bound[a] = std::numeric_limits<double>::infinity();
      sticking.matrix(a, a) += limit;
    }
  }
  minimise_in_box(table, count, sticking.share);
  for (Index i = 0; i < nv; ++i) {
    qdd[i] = base[i];
  }
  for (Index i = 0; i < lam.size; ++i) {
    lam[i] = base[nv + i];
  }
  for (Index a = 0; a < count; ++a) {
    const Index row = sticking.rows[a + 1];
    const double share = sticking.share[a], friction = share * table.output(row, 3);
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

void hold_by_responses(const EffectTable & table, Values qdd, Values lam)
{
  const StaticFriction & sticking = table.sticking;
  Index & count = sticking.rows[0];
  Index number = 0;
  count = 0;
  for (Index row = 0; row < table.count(); ++row) {
    if (table.role[row] == effect::FRICTION) {
      const double limit = sticking.right[number];
      if (limit > 0.0) {
        if (count < number) {
          copy(sticking.response[number], sticking.response[count]);
        }
        sticking.rows[++count] = row;
        table.output(row, 3) = limit;
      }
      ++number;
    }
  }
  if (count > 0) {
    table.applied.fill(0.0);
    keep_frictionless(table, qdd, lam);
    balance_friction(table, qdd, lam);
  }
}

void stop_sticking_joints(const EffectTable & table, Values qd)
{
  const StaticFriction & sticking = table.sticking;
  const Index count = sticking.rows[0];
  for (Index a = 0; a < count; ++a) {
    const Index row = sticking.rows[a + 1];
    sticking.right[a] = table.output(row, 3) * along(table, row, qd);
    sticking.bound[a] =
      stays_at_rest(table, a) ? std::numeric_limits<double>::infinity() : 0.0;
  }
  minimise_in_box(table, count, sticking.impulse);
  for (Index a = 0; a < count; ++a) {
    for (Index i = 0; i < qd.size; ++i) {
      qd[i] += sticking.impulse[a] * sticking.response(a, i);
    }
  }
  for (Index a = 0; a < count; ++a) {
    if (sticking.bound[a] > 0.0) {
      clear(table, a, qd);
    }
  }
}

}  // namespace closedloop
