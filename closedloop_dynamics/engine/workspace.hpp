// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__WORKSPACE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__WORKSPACE_HPP_

#include "model.hpp"

namespace closedloop
{

/// Results and scratch of one evaluation of a model.
struct Workspace
{
  /// Shape (nb + 1, 31, in the plane with couplings 33, in space 81).
  Array<Table> body;
  /// Shape (path entries, 3 or more): reduced force u = S^T w of each row of a cut at each path
  /// entry; the same times 1/D.
  Array<Table> response;
  Array<Table> response_scaled;
  /// Entries of the constraint matrix, then of its factor L; what its pivots are compared with.
  Array<Values> factor;
  Array<Values> scale;
  /// Levers of each row of a cut on the bodies' angles, and on the slides.
  Array<Table> lever;
  /// What refinement.cpp keeps of every joint.
  Array<Table> joint;
  /// The latest change of the accelerations.
  Array<Values> change;
  Array<Values> pivot_inverse;
  /// Right-hand side, then solution, in elimination order.
  Array<Values> right;
  Array<Values> scatter;
  /// psi, J qd and Jdot qd, in elimination order.
  Array<Values> closure;
  Array<Values> closure_rate;
  Array<Values> bias;
  /// Equations of one cut joint, as loop_closure.cpp leaves them.
  Array<Values> equation;
  /// On their way inward; shape (2, 3 or 6).
  Array<Table> wrench;
  /// Output of a joint kernel.
  Array<Values> share;
  /// In the world's axes; shape (nv,).
  Array<Values> torque;
  /// Wrenches, and accelerations, of inverse dynamics.
  Array<Table> force;
  /// Columns are those of engine/types.py.
  Array<Values> health;

  Workspace() = default;
  explicit Workspace(const Model &);

  /// Whether it was made for such a model.
  bool fits(const Model &) const;
  bool planar() const {return wrench.columns == 3;}
  /// Components of a wrench: 3 in the plane, 6 in space.
  Index size() const {return wrench.columns;}
  /// First column of the bodies' bias forces.
  Index first_force() const
  {
    return planar() ? static_cast<Index>(plane::FZ) : static_cast<Index>(space::FORCE);
  }

  CLOSEDLOOP_ARRAYS(
    body, response, response_scaled, factor, scale, lever, joint, change, pivot_inverse, right,
    scatter, closure, closure_rate, bias, equation, wrench, share, torque, force, health)
};

/// Which coordinates are independent, and the scratch to solve for the others by Newton's method;
/// no set is chosen at first.
struct Partition
{
  /// The nc dependent coordinates, then the independent ones.
  Array<Indices> order;
  Array<Table> jac;
  Array<Table> scaled;
  /// Factors of the dependent columns.
  Array<Table> matrix;
  Array<Indices> pivots;
  Array<Values> right;
  /// Change of the coordinates; zero for the independent ones.
  Array<Values> change;
  /// As of independent.cpp.
  Array<Values> record;

  Partition() = default;
  explicit Partition(const Model &);

  /// Make it one that has not been chosen yet.
  void forget();

  CLOSEDLOOP_ARRAYS(order, jac, scaled, matrix, pivots, right, change, record)
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__WORKSPACE_HPP_
