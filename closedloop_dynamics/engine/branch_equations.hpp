// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_EQUATIONS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_EQUATIONS_HPP_

#include <array>

#include "columns.hpp"
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

/// The closure equations, component by component. `jac`, `closure` and `bias` are those of the latest
/// place, in the user's order.
class BranchEquations
{
public:
  explicit BranchEquations(const System &);

  /// Evaluate closure errors, J and constraint bias at a place.
  void evaluate(Values q, Values rates);
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
  /// The smallest pivot of these factors against the largest.
  double smallest_pivot(const Component &) const;
  /// The same by all coordinates, with complete pivoting, down to a share of the first pivot; return
  /// the rank and the factors.
  Index factor_fully(const Component &, double share, Indices rows, Indices columns, Table & out);
  /// Changes of the dependent coordinates that change the equations by `right`.
  void solve(const Component &, Values out);
  /// Multipliers of the equations, shape (nc,), that give the dependent coordinates these forces.
  void solve_transposed(const Component &, Values force, Values out);
  /// Bring a place onto the branch, in place, from its evaluation; return whether it is there, then
  /// with evaluation and factors.
  bool settle(const Component &, Values q, Values rates);
  /// Rates and accelerations of the dependent coordinates at the latest place, factored, from the
  /// rates of the independent ones; evaluates the equations with these rates.
  void follow(const Component &, Values q, Values rates, Values path_acceleration);
  /// Accelerations of the dependent coordinates that keep the loops closed.
  void find_path_acceleration(const Component &, Values out);
  /// Add a share of the derivatives of the dependent coordinates by the independent ones.
  void add_tangents(const Component &, Table out, double share);

  /// An equation, a coordinate and an independent coordinate of a component.
  Index row(const Component & part, Index i) const {return row_[part.row + i];}
  Index column(const Component & part, Index k) const {return order_[part.column + k];}
  Index independent(const Component & part, Index k) const {return column(part, part.rows + k);}

private:
  double entry(Index i, Index j) const {return jac(i, j) * row_scale[i] * column_scale[j];}
  Table square(const Component & part) const {return {factor_.data, part.rows, part.rows};}

  // Numbers, counts and components that fit on the stack.
  static constexpr Index NUMBERS = 1024, COUNTS = 64, MOST_PARTS = 8;
  Scratch<double, NUMBERS> scratch_;
  Scratch<Index, COUNTS> counts_;
  Scratch<Component, MOST_PARTS> parts_;

public:
  const System & system;
  const Index nv, nc;
  const Table jac;
  const Values closure, bias, right, row_scale, column_scale;
  Vector<Component> components;

private:
  const Table factor_;
  const Values local_, pivot_scale_, change_;
  // Equations and coordinates, component by component; scratch.
  const Indices row_, order_, pivot_row_, column_;
  // With the addresses of these arrays.
  std::array<Index, routine::TABLE_COLUMNS> table_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BRANCH_EQUATIONS_HPP_
