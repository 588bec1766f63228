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

// Generated code, from the laws on symbols (generated_law.cpp).
Law apply_generated;
/// Keep the address of the routine of a kind, for all tables of effects.
void keep_law(Index kind, Index address);
bool has_generated_law(Index kind);

// In joints (joint_laws.cpp).
/// Spring and damper along a weighted sum of coordinates.
Law apply_tendon;
/// Friction of a joint or tendon that slides; one at rest is listed in EffectTable.sticking.
Law apply_joint_friction;
/// List inertia reflected at a cut joint or along a tendon in EffectTable.sticking: its force
/// follows from accelerations.
Law apply_reflected_inertia;

// Laws that were traced on symbols, as generated code (traced_laws.cpp).
Law apply_traced;
Law apply_spatial_traced;

// Cables over guides and pulleys (cable_laws.cpp).
Law apply_cable;
Law apply_spatial_cable;

// Given over time (prescribed_motion.cpp).
Law apply_prescribed_motion;

/// Set the right-hand sides of all prescribed motions to the time in their states.
void update_driven_motions(const EffectTable &);

/// Write the driving forces of all prescribed motions, their power and the rate of their work,
/// from the multipliers, shape (nc,), of an evaluation.
void output_driving_forces(const EffectTable &, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LAWS_HPP_
