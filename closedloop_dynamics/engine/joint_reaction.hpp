// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__JOINT_REACTION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__JOINT_REACTION_HPP_

#include "data.hpp"

// Reactions in joints, for effects that depend on them: friction. Each follows its reaction with a
// lag, in a state of its own.

namespace closedloop
{

/// Compute the wrenches in the joints of the tree, into EffectTable.reaction, which is as
/// `bias_forces` leaves it, and update the loads. Of the workspace only poses are read. `qdd`, shape
/// (nv,), `lam`, shape (nc,): accelerations, and multipliers of the equations of the model; those
/// of all equations become those of the least forces, where the elimination leaves some out.
void load_joints(
  const System &, const Model &, const Workspace &, Values qd, Values qdd, Values lam);

/// Write the rates of the loads and the readings; EffectTable.reaction has the wrenches in the
/// joints of the trees.
void update_joint_loads(
  const Model &, const Workspace &, const EffectTable &, Values qd, Values lam);

/// Copy the loads that were found to the states in which effects feel them, among all of these,
/// shape (nz,); return whether none of them changes by more than a share of the largest.
bool feel_loads(const System &, Values states, double share);

/// Have effects feel the loads of a state, shape (ns,), from the start on: a fixed point, as friction
/// changes them a little.
void begin_loads(const System &, Values state);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__JOINT_REACTION_HPP_
