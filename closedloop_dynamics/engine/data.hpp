// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__DATA_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__DATA_HPP_

#include <memory>
#include <thread>
#include <vector>

#include "effect_table.hpp"
#include "workspace.hpp"

namespace closedloop
{

/// How a mechanism is evaluated and corrected.
struct Settings
{
  // The following are side by side: generated code reads the first, and the size behind it.
  /// Baumgarte's decay rate of closure errors [1/s]; 0: none.
  double baumgarte_gain = 0.0;
  /// Closure error that projection leaves, and the one at which it gives up [m, rad].
  double closure_tolerance = 0.0;
  double closure_limit = 0.0;
  /// How far beside a state the rank-revealing path asks the branch [rad]. The eighth power of this
  /// is the error of the interpolation between such places.
  double aside = 0.015;
  /// Size of the mechanism [m].
  double size = 1.0;
  /// Closure error of equations that are left out up to which they repeat others.
  double opening = 0.0;

  /// `opening` is in sizes of the mechanism.
  Settings(double baumgarte, double size, double opening)
  : baumgarte_gain(baumgarte),
    // Closure errors of 1e-12 of the size are rounding; one of 1e-5 of it is an open loop.
    closure_tolerance(1e-12 * size), closure_limit(1e-5 * size), size(size),
    opening(opening * size) {}
};

/// All closure equations of a mechanism of which the elimination works on some; empty where it
/// works on all. Which ones repeat others changes with the position: those that are kept may come
/// to depend on one another, and part from those that are left out (left_out.hpp).
struct AllEquations
{
  Model model;
  /// On the bodies of the system.
  Workspace work;
  Array<Values> lam;
  /// Whether the elimination works on each equation, in the user's order.
  Array<Indices> kept;
  /// On bodies of its own.
  Workspace own;
  /// As of left_out.cpp.
  Array<Values> numbers;
  /// Shape (2,): scratch.
  Array<Values> energy;

  AllEquations() = default;
  /// `work` is that of `some`, the model that works on some of the equations of `all`.
  AllEquations(const Model & all, const Model & some, const Workspace & work);

  bool empty() const {return lam.data == nullptr;}

  CLOSEDLOOP_ARRAYS(model, work, lam, kept, own, numbers, energy)
};

/// Where the joints are, fixed ones left out: first those of the tree, then the cut joints in the
/// user's order.
struct JointPlaces
{
  /// The row of the body that each joint of the tree carries.
  Array<Indices> row;
  /// Rows of the two bodies of all joints, shape (n, 2).
  Array<Indexes> body;
  /// Shape (2 n, 2 or 3): the joint's point on the one and on the other body [m].
  Array<Table> point;

  JointPlaces() = default;
  /// Throws std::invalid_argument.
  JointPlaces(const Model &, Indices row, Indexes body, Table point);

  CLOSEDLOOP_ARRAYS(row, body, point)
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
  void fields(Visitor && visit) {visit("table, columns, found, flows", table, columns, found, flows);}
};

/// The state and torques that the host has evaluated last, as long as nothing else is computed in the
/// same memory.
class LatestEvaluation
{
public:
  bool is_of(Values state, Values tau) const;
  void keep(Values state, Values tau);
  void forget() {known_ = false;}

private:
  bool known_ = false;
  std::vector<double> state_;
  std::vector<double> tau_;
};

/// One mechanism with all that an evaluation of its motion reads and writes. A state vector has the
/// coordinates, shape (nq,), the rates, shape (nv,), the effects' own states, and, where there are
/// quaternions, the work of their torques.
///
/// Copies are of the same memory, so that those on other equations share state, torques and effects;
/// `copy` makes one with memory of its own.
struct Data
{
  Model model;
  Workspace work;
  /// Empty where independent coordinates are not used.
  Partition partition;
  std::shared_ptr<Settings> settings;
  /// Shape (nv + nk,): commanded joint torques [N m] and forces [N], behind them those of the nk cut
  /// joints that anything acts in.
  Array<Values> tau;
  /// Results of the latest evaluation.
  Array<Values> qdd;
  Array<Values> lam;
  /// Shape (nv,): joint torques of commands and effects.
  Values applied;
  EffectTable effects;
  /// Addresses of the routines that are generated for this mechanism.
  Array<Indices> table;
  /// Shape (2, nv): of coordinates and rates, as generated routines leave them; of no columns where
  /// there are no such routines.
  Array<Table> corrections;
  /// What routine::ACCELERATION keeps for routine::TORQUE_RESPONSE, if there is one.
  Array<Values> factors;
  Manifold manifold;
  AllEquations whole;
  JointPlaces joints;
  AccelerationDerivatives derivatives;
  /// Evaluations from places around a singular position: the largest closure error of a state
  /// between these [m], and its coordinates, shape (1 + nq,); 0: none since the last reset.
  Array<Values> passage;
  /// What owns the arrays of the derivatives.
  std::shared_ptr<void> owner_of_derivatives;
  /// Returns whether a long computation is to stop; nullptr: never. Set by the host.
  bool (* interrupted)() = nullptr;
  /// The thread of the host that computes with this memory, if any.
  std::shared_ptr<std::thread::id> worker = std::make_shared<std::thread::id>();
  std::shared_ptr<LatestEvaluation> latest = std::make_shared<LatestEvaluation>();

  /// Throws std::invalid_argument. `all`: with the equations, too, that `model` leaves out; `code`:
  /// addresses of routines, by place in the function table, and how many factors they keep; of no
  /// length where there are none.
  Data(
    const Model & model, const Model & all, const Settings &, const JointPlaces &,
    const EffectTable &, Indices code);
  /// On other equations of the same mechanism, with their code.
  Data(const Data & like, const Model & model, const Model & all, Indices code);

  /// Go on with other equations of the same mechanism; throws std::invalid_argument.
  void use_equations(const Model & model, const Model & all, Indices code);
  /// With memory of its own, without derivatives.
  Data copy() const;
  /// Take over the numbers of data of which this is a copy.
  void take(const Data & from);
  /// Use independent coordinates, no set chosen yet, or none.
  void use_independent(bool used) {partition = used ? Partition(model) : Partition();}
  /// Throws std::invalid_argument.
  void use_derivatives(const AccelerationDerivatives &, std::shared_ptr<void> owner);
  /// Forget the motion so far.
  void forget();

  Index nv() const {return qdd.size;}
  Index nq() const {return qdd.size + manifold.balls.rows;}
  /// Place of the first of the effects' own states.
  Index own() const {return nq() + nv();}
  /// Length of a state.
  Index ns() const {return own() + effects.states.size + (manifold.empty() ? 0 : 1);}
  /// Whether evaluations are by routines that were generated for this mechanism.
  bool is_unrolled() const {return corrections.columns > 0;}
  bool is_independent() const {return partition.order.size > 0;}
  bool has_effects() const {return !effects.empty();}
  bool has_cut_coordinates() const {return effects.cuts.index.rows > 0;}
  Values q(Values state) const {return state.part(0, nq());}
  Values qd(Values state) const {return state.part(nq(), nv());}

  CLOSEDLOOP_ARRAYS(
    model, work, partition, settings, tau, qdd, lam, effects, table, corrections, factors, manifold,
    whole, joints, passage)

private:
  /// Give the function table routines, and the addresses of the arrays that they work on.
  void link(Indices code);
  void connect();
};

/// Everything that computations with data write, to be put back, to the last bit.
class Snapshot
{
public:
  explicit Snapshot(const Data &);
  void restore() const;

private:
  Data data_;
  /// Whole numbers are kept by their bits, too.
  std::vector<Values> places_;
  std::vector<double> kept_;
};

/// As kernels call them.
using System = Data;

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__DATA_HPP_
