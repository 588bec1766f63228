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

using Law = void(const EffectTable &, Index row, Table body, Values q, Values qd, Values tau);

// In joints (joint_laws.cpp).
Law apply_joint_damping;
Law apply_joint_spring;
/// Spring of a joint with an orientation, about the axis that it is turned by.
Law apply_orientation_spring;
/// Spring and damper along a weighted sum of coordinates.
Law apply_tendon;
Law apply_end_stop;
/// Friction of a joint or tendon that slides; one at rest is listed in EffectTable.sticking.
Law apply_joint_friction;
/// A drive with limits and lag, in the place of the command.
Law apply_actuator;
/// List inertia reflected at a cut joint or along a tendon in EffectTable.sticking: its force
/// follows from accelerations.
Law apply_reflected_inertia;

// At points (point_laws.cpp).
Law apply_point_spring;
Law apply_spatial_point_spring;
Law apply_external_force;
Law apply_spatial_external_force;

// Springs whose force over the stroke is a table (force_table_laws.cpp).
Law apply_joint_force_table;
Law apply_point_force_table;
Law apply_spatial_force_table;

// Drag of fluids (drag_laws.cpp).
Law apply_fluid_drag;
Law apply_spatial_fluid_drag;

// Laws that were traced on symbols, as generated code (traced_laws.cpp).
Law apply_traced;
Law apply_spatial_traced;

// Bushings (bushing_laws.cpp).
Law apply_bushing;
Law apply_spatial_bushing;

// Contacts of a point with the world (contact_laws.cpp).
Law apply_contact;
Law apply_spatial_contact;

// Contacts of a roller with another body (body_contact_laws.cpp).
Law apply_line_contact;
Law apply_circle_contact;
Law apply_curve_contact;
Law apply_face_contact;
Law apply_spatial_body_contact;

// Cables over guides and pulleys (cable_laws.cpp).
Law apply_cable;
Law apply_spatial_cable;

// Given over time (prescribed_laws.cpp).
Law apply_prescribed_torque;
Law apply_prescribed_force;
Law apply_spatial_prescribed_force;
Law apply_prescribed_motion;

/// Set the right-hand sides of all prescribed motions to the time in their states.
void update_driven_motions(const EffectTable &);

/// Write the driving forces of all prescribed motions, their power and the rate of their work,
/// from the multipliers, shape (nc,), of an evaluation.
void output_driving_forces(const EffectTable &, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LAWS_HPP_
