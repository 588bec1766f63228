// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "dispatch.hpp"

#include "cut_coordinates.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
/// Apply the law of one row. Without a default, so that the compiler names a kind without a law.
void apply_law(
  const EffectTable & table, Index row, Table body, Values q, Values qd, Values tau)
{
  switch (static_cast<effect::Kind>(table.kind[row])) {
    case effect::JOINT_DAMPING:
      return apply_joint_damping(table, row, body, q, qd, tau);
    case effect::JOINT_SPRING:
      return apply_joint_spring(table, row, body, q, qd, tau);
    case effect::END_STOP:
      return apply_end_stop(table, row, body, q, qd, tau);
    case effect::JOINT_FRICTION:
      return apply_joint_friction(table, row, body, q, qd, tau);
    case effect::POINT_SPRING:
      return apply_point_spring(table, row, body, q, qd, tau);
    case effect::EXTERNAL_FORCE:
      return apply_external_force(table, row, body, q, qd, tau);
    case effect::CONTACT:
      return apply_contact(table, row, body, q, qd, tau);
    case effect::ACTUATOR:
      return apply_actuator(table, row, body, q, qd, tau);
    case effect::SPATIAL_POINT_SPRING:
      return apply_spatial_point_spring(table, row, body, q, qd, tau);
    case effect::SPATIAL_FORCE:
      return apply_spatial_external_force(table, row, body, q, qd, tau);
    case effect::SPATIAL_CONTACT:
      return apply_spatial_contact(table, row, body, q, qd, tau);
    case effect::PRESCRIBED_TORQUE:
      return apply_prescribed_torque(table, row, body, q, qd, tau);
    case effect::PRESCRIBED_FORCE:
      return apply_prescribed_force(table, row, body, q, qd, tau);
    case effect::JOINT_FORCE_TABLE:
      return apply_joint_force_table(table, row, body, q, qd, tau);
    case effect::POINT_FORCE_TABLE:
      return apply_point_force_table(table, row, body, q, qd, tau);
    case effect::BUSHING:
      return apply_bushing(table, row, body, q, qd, tau);
    case effect::CABLE:
      return apply_cable(table, row, body, q, qd, tau);
    case effect::LINE_CONTACT:
      return apply_line_contact(table, row, body, q, qd, tau);
    case effect::CIRCLE_CONTACT:
      return apply_circle_contact(table, row, body, q, qd, tau);
    case effect::CURVE_CONTACT:
      return apply_curve_contact(table, row, body, q, qd, tau);
    case effect::FACE_CONTACT:
      return apply_face_contact(table, row, body, q, qd, tau);
    case effect::SPATIAL_PRESCRIBED_FORCE:
      return apply_spatial_prescribed_force(table, row, body, q, qd, tau);
    case effect::SPATIAL_BUSHING:
      return apply_spatial_bushing(table, row, body, q, qd, tau);
    case effect::SPATIAL_CABLE:
      return apply_spatial_cable(table, row, body, q, qd, tau);
    case effect::PRESCRIBED_MOTION:
      return apply_prescribed_motion(table, row, body, q, qd, tau);
    case effect::SPATIAL_BODY_CONTACT:
      return apply_spatial_body_contact(table, row, body, q, qd, tau);
    case effect::SPATIAL_FORCE_TABLE:
      return apply_spatial_force_table(table, row, body, q, qd, tau);
    case effect::REFLECTED_INERTIA:
      return apply_reflected_inertia(table, row, body, q, qd, tau);
    case effect::TENDON:
      return apply_tendon(table, row, body, q, qd, tau);
    case effect::FLUID_DRAG:
      return apply_fluid_drag(table, row, body, q, qd, tau);
    case effect::SPATIAL_FLUID_DRAG:
      return apply_spatial_fluid_drag(table, row, body, q, qd, tau);
    case effect::ORIENTATION_SPRING:
      return apply_orientation_spring(table, row, body, q, qd, tau);
    case effect::TRACED:
      return apply_traced(table, row, body, q, qd, tau);
    case effect::SPATIAL_TRACED:
      return apply_spatial_traced(table, row, body, q, qd, tau);
  }
}

/// Apply the laws to the joints that the arrays have.
void apply_laws(const EffectTable & table, Table body, Values q, Values qd, Values tau)
{
  for (Index row = 0; row < table.count(); ++row) {
    if (table.enabled[row] == 1) {
      apply_law(table, row, body, q, qd, tau);
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
  measure_cut_coordinates(
    cuts.index, cuts.values, body, table.states, qd.size, cuts.q, cuts.qd);
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
  table.sticking.rows[0] = 0;
  if (table.cuts.index.rows == 0) {
    apply_laws(table, body, q, qd, tau);
  } else {
    measure_joints(table, body, q, qd);
    apply_laws(table, body, table.cuts.q, table.cuts.qd, tau);
    exert_efforts(table, body, qd.size);
  }
}

}  // namespace closedloop
