// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LAWS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LAWS_HPP_

#include "effect_table.hpp"

// The laws of force, each for one row of the table. `body` is Workspace.body after `outward`:
// forces at points reduce its bias forces. `q`, `qd`: coordinates and rates, shape (nv + nk,),
// those of cut joints that anything acts in behind; `tau`: commanded torques, shape (nv + nk,)
// [N m, N]. A law adds to EffectTable.applied, and writes the rates of its states and its row of
// EffectTable.output: stored energy [J], then readings.

namespace closedloop
{

// In joints (joint_laws.cpp).
void apply_joint_damping(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_joint_spring(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_end_stop(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
/// Friction of a joint that slides; one at rest is listed in EffectTable.sticking.
void apply_joint_friction(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
/// A drive with limits and lag, in the place of the command.
void apply_actuator(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values tau);
/// List a rotor at a cut joint in EffectTable.sticking: its force follows from accelerations.
void apply_cut_rotor(const EffectTable &, Index row, Table body, Values q, Values qd, Values);

// At points (point_laws.cpp).
void apply_point_spring(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_spatial_point_spring(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_external_force(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_spatial_external_force(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);

// Springs whose force over the stroke is a table (force_table_laws.cpp).
void apply_joint_force_table(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_point_force_table(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_spatial_force_table(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);

// Bushings (bushing_laws.cpp).
void apply_bushing(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_spatial_bushing(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);

// Contacts of a point with the world (contact_laws.cpp).
void apply_contact(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_spatial_contact(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);

// Contacts of a roller with another body (body_contact_laws.cpp).
void apply_line_contact(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_circle_contact(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_curve_contact(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_spatial_body_contact(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);

// Cables over guides and pulleys (cable_laws.cpp).
void apply_cable(const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_spatial_cable(const EffectTable &, Index row, Table body, Values q, Values qd, Values);

// Given over time (prescribed_laws.cpp).
void apply_prescribed_torque(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_prescribed_force(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_spatial_prescribed_force(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);
void apply_prescribed_motion(
  const EffectTable &, Index row, Table body, Values q, Values qd, Values);

/// Set the right-hand sides of all prescribed motions to the time in their states.
void update_driven_motions(const EffectTable &);

/// Write the driving forces of all prescribed motions, their power and the rate of their work,
/// from the multipliers, shape (nc,), of an evaluation.
void output_driving_forces(const EffectTable &, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LAWS_HPP_
