// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LOOP_SOLVER_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LOOP_SOLVER_HPP_

#include "least_squares.hpp"
#include "null_space.hpp"
#include "workspace.hpp"

// Positions and rates that close the loops, found from approximate ones: set-up work, on dense
// matrices. driven.cpp has residuals and derivatives from here. Other corrections have a reason of
// their own, at their heads: projection.cpp, independent.cpp, chart.cpp.

namespace closedloop
{

/// Which loops are closed, and by what.
struct Loops
{
  Indices places;  ///< Of all closure equations: 1 where one holds a place, 0 where an angle
  Indices rows;  ///< Equations to be met, in the user's order
  Indices free;  ///< Freedoms that may change
  /// Singular values below this, against the largest or 1, belong to dependent equations.
  double tolerance = 0.0;
  /// Inertia that each freedom has at least in the metric, against the largest.
  double least = 0.0;
  /// The most that one correction changes a freedom, in units of `scale`.
  double limit = 0.0;
  Values weight = {};  ///< Of each freedom, a metric in the place of the masses'; none: theirs
  /// Freedoms of a number each, and values to come as near to as the loops and `weight` let them.
  Indices measured = {};
  Values values = {};

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "places[C], rows<C[r], free<V, tolerance, least, limit, weight[0|V], measured<V[m], values[m]",
      places, rows, free, tolerance, least, limit, weight, measured, values);
  }
  /// Throws std::invalid_argument.
  void check(const Manifold &) const;
};

/// What a search from far away asks for beyond closure equations, which are sines of angles:
/// axes that point the same way, and coordinates within limits.
struct Far
{
  Values unit;  ///< Of each closure equation
  Values scale;  ///< Unit of each freedom
  Indices axes;  ///< Of each closure, in the user's order: which of its axes count, of `axis`
  Table limits;  ///< Coordinate, freedom, least and largest value; shape (n, 4)
  Values target;  ///< Residuals to end at; none: zero

  bool empty() const {return unit.data == nullptr;}

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "unit[C], scale[V], axes<4[K], limits[l,4], target[0|C+K+l]", unit, scale, axes, limits, target);
  }
  /// Throws std::invalid_argument.
  void check(const Model &) const;
};

/// Axes of both bodies that a cut joint keeps parallel.
namespace axis
{
enum : Index
{
  NO_AXIS,  ///< None, or they need not be the right way round
  ONE_AXIS,  ///< Z
  ALL_AXES,
  THREAD  ///< Z, and X with where the slide along Z turns it
};
}

/// What had a part in closing the loops, as bits.
namespace part
{
enum : Index
{
  MASSES = 1,  ///< The mass metric decided between solutions
  DEPENDENT = 2,  ///< Equations depended on one another, nearly at least
  NO_METRIC = 4  ///< The metric cannot be computed with: nothing was found
};
}

/// Closes some loops of a mechanism by some of its freedoms.
///
/// The change is the least one in the metric, where there is a choice; where freedoms are measured,
/// the one that ends nearest to their values.
class LoopSolver
{
public:
  LoopSolver(
    const Model &, const Workspace &, const Manifold &, const Loops &, const Far & far = {});

  /// Move to coordinates; the residuals there: closure errors and, of a search from far away, what
  /// axes and limits add, in units.
  const DenseVector & residuals_at(const DenseVector & q);
  /// The same, and their derivatives by all freedoms.
  const DenseMatrix & slopes_at(const DenseVector & q)
  {
    move_to(q);
    return slopes();
  }
  /// Both at the latest coordinates.
  const DenseMatrix & slopes();
  const DenseVector & residuals() const {return residuals_;}
  /// Rates of closure errors at rates, or their accelerations where those of the joints are zero.
  const DenseVector & changes_at(const DenseVector & q, const DenseVector & qd, Level);

  /// Newton's method with rank-revealing corrections, until the largest residual is no more than
  /// `goal` or decreases no longer.
  void correct(DenseVector & q, double goal);
  /// The same to the values of measured freedoms, until corrections are rounding.
  void approach(DenseVector & q);
  /// Levenberg and Marquardt's method: slower, and more robust.
  void search(DenseVector & q, double goal, Index most);
  /// The x with J x = `error` that is least in the metric, or for which -x is nearest to what
  /// `aim_from` found; J of the latest `slopes_at`; false where there is none.
  bool least_change(const DenseVector & error, DenseVector & x);
  /// Correct rates by the least change with which residuals change at the rates `wanted`, at the
  /// latest `slopes_at`. False as above. Where some are held, free ones are zero before; of those
  /// measured the `values` are rates.
  bool correct_rates(DenseVector & rates, const DenseVector & wanted);
  /// Begin at coordinates, with the metric there: nothing had a part yet.
  void begin(const DenseVector & q)
  {
    parts_ = 0;
    take_metric_at(q);
  }
  /// Where the metric is taken, from now on.
  void take_metric_at(const DenseVector & q);

  /// Bits of `part`, of all that was found so far.
  Index parts() const {return parts_;}
  bool is_dependent() const {return (parts_ & part::DEPENDENT) != 0;}
  /// The sign of the determinant of independent equations, as many as free coordinates, where
  /// `least_change` found one.
  double sign() const {return sign_;}

private:
  void move_to(const DenseVector & q) {move_to(q, still_);}
  void move_to(const DenseVector & q, const DenseVector & qd);
  const DenseVector & gather(Values ordered);
  double astray(Index a, Index axes);
  bool is_aimed() const {return loops_.measured.size > 0;}
  void aim_from(const DenseVector & present, bool rates);
  bool find_metric();
  bool shorten(const Eigen::MatrixXd & open, DenseVector & x);
  DenseVector moved(const DenseVector & q, const DenseVector & x);

  const Model & model_;
  const Workspace & work_;
  const Manifold & manifold_;
  Loops loops_;
  Far far_;
  DenseVector here_, rates_, still_, all_, residuals_, change_, metric_place_, ahead_;
  DenseMatrix all_slopes_, slopes_;
  Eigen::MatrixXd jac_, root_;
  bool has_metric_ = false;
  double sign_ = 1.0;
  Index parts_ = 0;
};

/// Close loops from coordinates `q`, by Newton's method, and where this leaves an error above
/// `enough` by Levenberg and Marquardt's. Corrections end at a hundredth of `closed`; closed loops
/// stay as they are, unless freedoms are measured. Bits of `part`.
Index close_loops(
  const Model &, const Workspace &, const Manifold &, Values q, const Loops &, double closed,
  double enough);

/// The nearest rates at a position with which residuals change at the rates `wanted`, where these
/// are independent.
Index close_rates(
  const Model &, const Workspace &, const Manifold &, Values q, Values qd, const Loops &,
  Values wanted);

/// Close loops from far away, as well as possible; `goal` is in units.
Index search_loops(
  const Model &, const Workspace &, const Manifold &, Values q, const Loops &, const Far &,
  double goal, Index most);

/// Residuals of a search, and their derivatives by all freedoms.
void loop_residuals(
  const Model &, const Workspace &, const Manifold &, Values q, const Loops &, const Far &,
  Values residuals, Table slopes);

/// How one state of many was closed.
namespace closing
{
enum : Index
{
  BY_ITSELF,  ///< Not at all: there is more to it than `close_states` looks at
  PLAIN,
  TURNED  ///< The determinant of the equations, as many as free coordinates, has changed its sign
};
}

/// Close the loops of many states, shapes (n, nq) and (n, nv), in place, where this is plain:
/// where equations are certainly independent, at first and in the end.
///
/// `closed` is as above; `status`, shape (n,): values of `closing`. False where `interrupted`.
bool close_states(
  const Model &, const Workspace &, const Manifold &, Table q, Table qd, const Loops &,
  double closed, Indices status, bool (* interrupted)());

/// The first of many states, shapes (n, nq) and (n, nv), with a closure error above a limit, or
/// with rates of it above that times the fastest rate, 1 at least; n where there is none.
Index first_open(
  const Model &, const Workspace &, const Manifold &, Table q, Table qd, double limit);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LOOP_SOLVER_HPP_
