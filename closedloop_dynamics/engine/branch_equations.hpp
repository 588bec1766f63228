// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_EQUATIONS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_EQUATIONS_HPP_

#include <array>

#include "columns.hpp"
#include "places.hpp"
#include "scratch.hpp"
#include "data.hpp"

// The closure equations at places on a branch of positions, solved for the coordinates that they
// determine best.

namespace closedloop
{

/// Equations that share coordinates, as ranges of the lists of BranchEquations. The coordinates:
/// first the dependent ones, as many as there are equations, then the independent ones that occur in
/// the equations, then the others.
struct Component
{
  Index row = 0, rows = 0, column = 0, columns = 0;
  Index moving = 0;  ///< Number of independent coordinates in the equations
  double pivot = 0.0;  ///< Smallest pivot at the state itself, against the largest; 0: rounding
};

/// A place on the branch, and how it goes on from there.
struct BranchPoint
{
  Values q, rate;
  Values path_acceleration;  ///< While independent coordinates go on evenly, shape (nv,)
  /// Derivatives of all coordinates by each independent one, shape (nv, nv): a row each.
  Table tangent;
};

/// The closure equations, component by component, at several places at once: at the latest ones, in
/// the user's order. Where a single state is evaluated it is at all places; what is of one place is
/// of the first.
class BranchEquations
{
public:
  explicit BranchEquations(const System &);

  /// Evaluate closure errors, J and constraint bias at places, or at the first one for all.
  void evaluate(LaneValues q, LaneValues rates, Index count = PLACES);
  /// The same at a state, which is kept in `place` and `rate`.
  void evaluate(Values q, Values rates);
  /// Move places by changes of the coordinates.
  void shift(LaneValues q, LaneValues change) const;
  /// Evaluate the inertia matrix of the trees, and what of the forces in joints accelerates them;
  /// `added`, shape (bodies, components): forces on the bodies beside those of their motion.
  void evaluate_motion(Values q, Values rates, Table added, Table gim, Values force);
  /// Scale the equations as they are at the latest place, and group them; false where an equation
  /// has no coordinate.
  bool find_components();
  /// Choose the coordinates that the equations determine best at the latest place; return their
  /// smallest pivot against the largest, 0 where it is less than a share.
  double choose(Component &, double share);
  /// Whether the rates of each quaternion are all dependent, or all independent.
  bool keeps_quaternions_whole(const Component &);
  /// Count the independent coordinates that occur in the equations at the latest place.
  void count_moving(Component &);
  /// Whether no coordinate of another component occurs in the equations.
  bool is_isolated(const Component &);
  /// Factor the equations' derivatives by the dependent coordinates at the latest place.
  void factor(const Component &);
  /// The smallest pivots of these factors against the largest.
  Lanes smallest_pivot(const Component &) const;
  /// The same by all coordinates, with complete pivoting, down to a share of the first pivot; return
  /// the rank and the factors.
  Index factor_fully(const Component &, double share, Indices rows, Indices columns, Table & out);
  /// Changes of the dependent coordinates that change the component's equations by `right_`, which
  /// is overwritten.
  void solve(const Component &, LaneValues out);
  /// Multipliers of the equations, shape (nc,), that give the dependent coordinates these forces.
  void solve_transposed(const Component &, Values force, Values out);
  /// Bring places onto the branch, in place, from their evaluation; return whether they are there,
  /// then with evaluation and factors.
  bool settle(const Component &, LaneValues q, LaneValues rates);
  /// Rates and accelerations of the dependent coordinates at the latest places, factored, from the
  /// rates of the independent ones; evaluates the equations with these rates.
  void follow(const Component &, LaneValues q, LaneValues rates, LaneValues path_acceleration);
  /// Accelerations of the dependent coordinates that keep the loops closed.
  void find_path_acceleration(const Component &, LaneValues out);
  /// Add the derivatives of the dependent coordinates by the independent ones, a share of each
  /// place's.
  void add_tangents(const Component &, Table out, Lanes share);
  /// Closure error of an equation.
  double gap(Index i) const {return closure_[i][0];}

  /// An equation, a coordinate and an independent coordinate of a component.
  Index row(const Component & part, Index i) const {return row_[part.row + i];}
  Index column(const Component & part, Index k) const {return order_[part.column + k];}
  Index independent(const Component & part, Index k) const {return column(part, part.rows + k);}

private:
  double entry(Index i, Index j) const
  {
    return jac_(i, j)[0] * row_scale[i] * column_scale[j];
  }
  LaneTable square(const Component & part) const {return {factor_.data, part.rows, part.rows};}
  LaneValues take(Index count) {return {&Lanes::at(scratch_.take(PLACES * count).data), count};}
  LaneTable take(Index rows, Index columns) {return {take(rows * columns).data, rows, columns};}

  // Numbers, counts and components that fit on the stack.
  static constexpr Index NUMBERS = 2048, COUNTS = 64, MOST_PARTS = 8;
  Scratch<double, NUMBERS> scratch_;
  Scratch<Index, COUNTS> counts_;
  Scratch<Component, MOST_PARTS> parts_;

public:
  const System & system;
  const Index nv, nc;
  const Values row_scale, column_scale, lever;  ///< The last is one over the second
  const LaneValues place, rate;
  Vector<Component> components;

private:
  const LaneTable jac_, factor_;
  const LaneValues closure_, bias_, right_, change_;
  const Table first_;
  const Values pivot_scale_;
  // Equations and coordinates, component by component; scratch.
  const Indices row_, order_, pivot_row_, column_;
  // With the addresses of these arrays.
  std::array<Index, routine::TABLE_COLUMNS> table_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_EQUATIONS_HPP_
