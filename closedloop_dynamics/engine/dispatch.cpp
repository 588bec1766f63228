// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "dispatch.hpp"

#include "cut_coordinates.hpp"
#include "scene_code.hpp"

namespace closedloop
{

namespace
{
Law * law_of(Index role)
{
  switch (role) {
    case effect::FRICTION: return apply_friction;
    case effect::INERTIA: return apply_reflected_inertia;
    default: return apply_generated;
  }
}

/// Apply the laws to the joints that the arrays have.
void apply_laws(const EffectTable & table, Table body, Values q, Values qd, Values tau)
{
  for (Index row = 0; row < table.count(); ++row) {
    if (table.enabled[row] == 1) {
      law_of(table.role[row])(table, row, body, q, qd, tau);
    }
  }
}

/// Write coordinates and rates of cut joints behind those of the tree.
void measure_joints(const EffectTable & table, Table body, Values q, Values qd)
{
  const CutCoordinates & cuts = table.cuts;
  for (Index i = 0; i < qd.size; ++i) {
    cuts.q[i] = q[i];
    cuts.qd[i] = qd[i];
  }
  measure_cut_coordinates(table, body, cuts.q, cuts.qd);
}

/// Apply the efforts along the coordinates of cut joints, and follow their angles.
void exert_efforts(const EffectTable & table, Table body, Index nv)
{
  const CutCoordinates & cuts = table.cuts;
  for (Index k = 0; k < cuts.index.rows; ++k) {
    const Index followed = cuts.index(k, cut_coordinate::FOLLOWED);
    if (followed >= 0) {
      table.rates[followed] = cuts.qd[nv + k];
    }
  }
  apply_cut_efforts(cuts.index, cuts.values, body, table.applied, nv);
}
}  // namespace

void apply_effects(const EffectTable & table, Table body, Values q, Values qd, Values tau)
{
  copy(tau, table.applied);
  table.rates.fill(0.0);
  table.static_friction.rows[0] = 0;
  store_sides(table);
  take_pieces(table);
  if (table.cuts.index.rows == 0) {
    apply_laws(table, body, q, qd, tau);
  } else {
    measure_joints(table, body, q, qd);
    apply_laws(table, body, table.cuts.q, table.cuts.qd, tau);
    exert_efforts(table, body, qd.size);
  }
}

}  // namespace closedloop
