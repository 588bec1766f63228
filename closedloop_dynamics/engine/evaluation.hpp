// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__EVALUATION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__EVALUATION_HPP_

#include "data.hpp"

// One evaluation of a system: its accelerations, multipliers, and the rates of effects' states.

namespace closedloop
{

/// The results of an evaluation that are read, each with those before: accelerations; multipliers;
/// poses and closure errors.
enum class Outputs {MOTION, FORCES, POSES};

/// Accelerations and multipliers of a state into System.qdd and System.lam; System.work then has
/// poses, velocities and closure errors. Effects' states are read from System.effects.
void evaluate(const System &, Values q, Values qd);

/// What an evaluation leaves in the workspace to solve with other torques: factors of the loops over
/// bodies, or what generated code reads.
enum class Factors {NONE, PLAIN, REFINED, CODE};

/// The same without friction at rest, driving forces and joint loads; with effects, all outputs.
Factors evaluate_in_parts(const System &, Values q, Values qd, Outputs = Outputs::POSES);

/// The same of a state vector, shape (ns,), with the effects' states in it.
void evaluate_with_poses(const System &, Values state);

/// Poses, velocities, stored energies and readings of effects, without accelerations.
void measure(const System &, Values state);

/// Whether an elimination alone gives the accelerations of a state.
bool is_regular(const System &, Values q, Values qd);

/// Accelerations and rates of effects' states of a state vector, shape (ns,), and what of the other
/// outputs is asked for.
void evaluate_for(const System &, Values state, Outputs);

/// The same with multipliers.
void evaluate_state(const System &, Values state);

/// Evaluate a state repeatedly, to time it without the calls; each evaluation waits for the one
/// before, as in a simulation, which reads no forces.
void evaluate_again(const System &, Values state, Index count);

/// Time derivative of a state, both of shape (ns,). With independent coordinates, the dependent
/// ones are first guesses, corrected in `state`.
void derivative(const System &, Values state, Values out);

/// The same with multipliers, which `derivative` leaves undefined next to singular positions.
void derivative_with_multipliers(const System &, Values state, Values out);

/// Copy the effects' own states from a state vector to EffectTable.states.
void load_effect_states(const System &, Values state);

/// Poses, velocities and inertial forces of all bodies, as `outward` of a model finds them.
void place_bodies(const System &, Values q, Values qd);

/// Forces of the listed effects on the bodies, and joint torques, after `outward`.
void apply_listed(const System &, Values q, Values qd);

/// The same on other bodies than System.work.
void apply_listed_to(const System &, Table body, Values q, Values qd);

/// Rates of all joints of a state, those of cut joints behind, shape (nv + nk,).
void rates_with_cuts(const System &, Values state, Values out);

/// Update the closure equations of driven motions to the time of a state.
void update_motions(const System &, Values state);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__EVALUATION_HPP_
