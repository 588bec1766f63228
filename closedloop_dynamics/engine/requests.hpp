// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__REQUESTS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__REQUESTS_HPP_

#include "data.hpp"

// Evaluations of single states from Python, outside a run: each is one call.

namespace closedloop
{

/// A state that is evaluated beside the run (simulation/evaluator.py).
struct Request
{
  Values state;
  /// Initial values of the effects' own states.
  Values own;
  /// Torques of the actuated joints, and their places in System.tau, -1 for a joint without torque.
  Values torque;
  Indices actuated;
  /// Multipliers of all equations; empty if not requested.
  Values lam;
  /// Scratch, of the length of System.tau.
  Values held;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "state[>=S], own[Z], torque[n], -1<=actuated<T[n], lam[0|A], held[T]", state, own, torque,
      actuated, lam, held);
  }
};

/// Whether a state that was evaluated closes the loops, in its rates, too, as far as a step has to.
/// Accelerations show it of equations that are left out: they do not fulfil these in open loops.
bool closes_loops(const System &, Values qd);

/// Copy a given array, if it has as many numbers.
bool take(const OptionalVector &, Values to);

/// Copy the torques of actuated joints, zero if absent, to their places in System.tau, -1 for a
/// joint without torque; false where they are not as many finite numbers, or such a joint has one.
bool spread_torques(Indices actuated, Values tau, const OptionalVector &);

/// How a given array compares with numbers: the same, others of at most a size, or neither.
enum class Comparison : Index {EQUAL, USUAL, OTHER};
Comparison compare(Values, double usual, const OptionalVector &);

/// Sum of absolute values.
double sum_of_sizes(Values);

/// Whether coordinates are finite, quaternions among them of norm 1 but for rounding.
bool is_position(const Manifold &, Values q);

/// Evaluate coordinates, rates and torques, zero if absent; false where they are not arrays of
/// finite numbers of these lengths, quaternions of norm 1, or where the equations that the
/// elimination works on do not suffice: the results are undefined then.
bool evaluate_given(
  const System &, const Request &, const OptionalVector & q, const OptionalVector & qd,
  const OptionalVector & torque);

/// Evaluate the state and the torques of a request; `whole` works on all equations, and is used
/// where those of `system` do not suffice. False where the numbers are not a state.
bool evaluate_request(const System & system, const System & whole, const Request &);

/// Multipliers of all equations in an evaluated state, where the elimination omits some: the least
/// forces (least_forces.hpp). Readings of effects are invalid afterwards. False where the
/// accelerations do not fulfil all equations.
bool find_all_multipliers(const System &, Values q, Values qd, Values lam);

/// Whether the accelerations also fulfil the equations that the elimination omits.
bool fulfil_left_out(const System &, Values q, Values qd);

/// Whether accelerations fulfil J qdd = -bias but for rounding.
bool fulfil(Table jac, Values bias, Values qdd);

/// Evaluate a state under the present torques, unless this has been done last.
void evaluate_present(const System &, Values state);

/// Multipliers of all equations in a state, which is evaluated.
void find_multipliers(const System &, Values state, Values lam);

/// Positions in the world of points of bodies, shape (n, 2) or (n, 3); in a state, which is evaluated.
void place_points(Table body, Indices row, Table point, Table out);
void points_in_state(const System &, Values state, Indices row, Table point, Table out);

/// Wrenches in the joints in a state, which is evaluated, as are all multipliers: moments and forces at points of the bodies `row`, NaN where that is 0; `scratch` has the shape of
/// Workspace.force.
void find_joint_forces(
  const System &, Values state, Values lam, Indices row, Table point, Table scratch, Table out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__REQUESTS_HPP_
