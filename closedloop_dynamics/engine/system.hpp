// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SYSTEM_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SYSTEM_HPP_

#include "array.hpp"
#include "effect_table.hpp"
#include "model.hpp"

namespace closedloop
{

/// All closure equations of a mechanism of which the elimination works on some; empty where it
/// works on all.
struct AllEquations
{
  Model model;
  Workspace work;
  Values lam;
  /// Of each equation, in the user's order: whether the elimination works on it.
  Indices kept;
  /// On bodies of its own.
  Workspace own;
  /// As of left_out.cpp.
  Values numbers;
  /// Shape (2,): scratch.
  Values energy;

  bool empty() const {return lam.data == nullptr;}

  template<class Visitor>
  void fields(Visitor && visit) {visit(model, work, lam, kept, own, numbers, energy);}
};

/// Where the joints are, fixed ones left out: first those of the tree, then the cut joints in the
/// user's order.
struct JointPlaces
{
  /// Of the joints of the tree: the row of the body that each carries.
  Indices row;
  /// Of all, shape (n, 2): rows of the two bodies.
  Indexes body;
  /// Shape (2 n, 2 or 3): the joint's point on the one and on the other body [m].
  Table point;

  template<class Visitor>
  void fields(Visitor && visit) {visit(row, body, point);}
};

/// Generated derivatives of the accelerations (simulation/derivative_code.py); empty where there are
/// none.
struct AccelerationDerivatives
{
  /// As for call_for_columns; its first place is 0 while the code is not that of the effects.
  Indices table;
  /// Shape (blocks, LANES (nv + nc)): of LANES columns each, lane by lane, by coordinates, rates and
  /// torques.
  Table columns;
  Table found;
  /// Shape (2 nv, nz): changes of the rates of the effects' states.
  Table flows;

  bool empty() const {return table.size == 0 || table[0] == 0;}

  template<class Visitor>
  void fields(Visitor && visit) {visit(table, columns, found, flows);}
};

/// One mechanism with all that an evaluation of its motion reads and writes
/// (integration/system.py). A state vector has the coordinates, shape (nq,), the rates, shape
/// (nv,), the effects' own states, and, where there are quaternions, the work of their torques.
struct System
{
  Model model;
  Workspace work;
  DenseWorkspace dense;
  Partition partition;
  Values settings;
  Values tau;
  Values qdd;
  Values lam;
  Values applied;
  EffectTable effects;
  Indices table;
  Table corrections;
  Manifold manifold;
  AllEquations whole;
  JointPlaces joints;
  AccelerationDerivatives derivatives;
  /// Of evaluations from places around a singular position: the largest closure error of a state
  /// between these [m], and its coordinates, shape (1 + nq,); 0: none since the last reset.
  Values passage;
  /// Returns whether a long computation is to stop; nullptr: never. Set by the host.
  bool (* interrupted)() = nullptr;

  Index nv() const {return qdd.size;}
  Index nq() const {return qdd.size + manifold.balls.rows;}
  /// Place of the first of the effects' own states.
  Index own() const {return nq() + nv();}
  /// Length of a state.
  Index ns() const {return own() + effects.states.size + (manifold.empty() ? 0 : 1);}
  /// Whether evaluations are by routines that were generated for this mechanism.
  bool is_unrolled() const {return corrections.columns > 0;}
  bool is_independent() const {return partition.order.size > 0;}
  bool has_effects() const {return effects.loaded.size > 0;}
  bool has_cut_coordinates() const {return effects.cuts.index.rows > 0;}
  Values q(Values state) const {return state.part(0, nq());}
  Values qd(Values state) const {return state.part(nq(), nv());}

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(model, work, dense, partition, settings, tau, qdd, lam, applied, effects, table,
      corrections, manifold, whole, joints, derivatives, passage);
  }
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SYSTEM_HPP_
