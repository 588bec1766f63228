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

/// The most coordinates of joints that one law reads.
constexpr Index MOST_COORDINATES = 16;

/// What a row must have for the routine of its law: coordinates of joints, a sum being one; bodies,
/// of the plane or of space; states; numbers; or entries of so many numbers each, one or more.
struct Needs
{
  Index joints;
  Index bodies;
  Index states;
  Index numbers;
  Index listed;
  bool spatial;
};

/// Keep the needs of a generated routine, by its address, for all tables of effects.
void keep_law(
  Index address, Index joints, Index bodies, Index states, Index numbers, Index listed,
  bool spatial);
/// Find them; null where there is no such routine.
const Needs * needs_of(Index address);

/// Generated code, from the laws on symbols (generated_law.cpp).
Law apply_generated;

// Whose force may follow from accelerations (resting_laws.cpp).
/// Friction of a joint or tendon; one at rest is listed in EffectTable.static_friction.
Law apply_friction;
/// List inertia reflected at a cut joint or along a tendon there.
Law apply_reflected_inertia;

// Motions given over time (prescribed_motion.cpp).
/// Position, rate and acceleration that the closure equation of a motion is to have.
double * right_side(const EffectTable &, Index row);

/// Set the right-hand sides of all prescribed motions to the time in their states.
void update_driven_motions(const EffectTable &);

/// Write the driving forces of all prescribed motions, their power and the rate of their work,
/// from the multipliers, shape (nc,), of an evaluation.
void output_driving_forces(const EffectTable &, Values lam);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LAWS_HPP_
