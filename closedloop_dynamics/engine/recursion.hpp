// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__RECURSION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__RECURSION_HPP_

#include "workspace.hpp"

// Recursions over the bodies of the spanning tree, by the code generated for each joint type.

namespace closedloop
{

/// Poses, velocities, velocity-product accelerations and rigid-body inertias of all bodies.
void outward(const Model &, Values q, Values qd, const Workspace &);

/// Articulated-body inertias and bias forces; `massless`: joints may carry no inertia.
void inward(const Model &, Values tau, const Workspace &, bool massless);

/// Joint accelerations, outward; shape (nv,).
void outward_acceleration(const Model &, const Workspace &, Values qdd);

/// Turn the entries of spherical joints from the body's frame into the world's, or back.
void turn_spherical(Indexes tree, Table body, double * values, bool outward);

/// Kinetic energy and potential energy in gravity [J], of a state whose motion is in `work`.
void energies(const Model &, const Workspace &, Values qd, Values out);

/// Copy the bodies' bias forces into the first columns of `out`, shape (nb + 1, 3 or more).
void bias_forces(const Workspace &, Table out);

/// Add forces on the bodies, shape (bodies, components), to theirs; none where there are no rows.
void add_forces(const Workspace &, Table forces);

/// Add inertial forces to the wrenches: Newton's and Euler's equations, outward.
void newton(const Model &, const Workspace &, Values qdd, Table wrench);

/// Wrenches in the joints of the tree from bias forces, accelerations and multipliers.
void joint_wrenches(
  const Model &, const Workspace &, Values qdd, Values lam, Table wrench);

/// Wrenches in the joints of the tree from multipliers alone, without motion and other forces.
void wrenches_of_multipliers(const Model &, const Workspace &, Values lam, Table wrench);

/// Whether a multiplier of a cut joint is not zero.
bool carries(Indexes cut, Values lam, Index a);

/// Wrenches of a cut joint, side by side in `share`: at its point, at the origins of bodies A and
/// B.
void wrenches_of_cut(
  const Model &, Table body, Values lam, Values share, Index a);

/// Wrenches at the cut joints, shape (number of cuts, 3 or 6), in the user's order; of `body`, as
/// Workspace.body, only poses are read.
void cut_wrenches(
  const Model &, const Workspace &, Table body, Values lam, Table out);

/// Joint torques of the tree alone for given accelerations, shape (nv,).
void tree_torque(const Model &, const Workspace &, Values qdd, Values out);

/// Constraint Jacobian in the user's order, shape (nc, nv), and what `update` finds.
void constraint_jacobian(const Model &, const Workspace &, Table jac);

/// Generalized inertia matrix of the tree, shape (nv, nv); uses up the bodies' inertias.
void generalized_inertia_matrix(const Model &, const Workspace &, Table gim);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__RECURSION_HPP_
