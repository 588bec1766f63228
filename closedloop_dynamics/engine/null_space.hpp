// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__NULL_SPACE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__NULL_SPACE_HPP_

#include <Eigen/SVD>

#include <type_traits>

#include "least_squares.hpp"
#include "workspace.hpp"

// Solution with dependent closure equations, by singular values.

namespace closedloop
{

using DenseMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using DenseVector = Eigen::VectorXd;

inline Table view(DenseMatrix & matrix) {return {matrix.data(), matrix.rows(), matrix.cols()};}
inline Values view(DenseVector & vector) {return {vector.data(), vector.size()};}
inline Eigen::Map<DenseVector> dense(Values values) {return {values.data, values.size};}
inline Eigen::Map<DenseMatrix> dense(Table table) {return {table.data, table.rows, table.columns};}

/// Singular values below this belong to a singular configuration nearby: such an equation is used
/// only if its right-hand side exceeds its error.
constexpr double WEAK = 0.1;
/// Rounding of scaled places and terms.
constexpr double ROUNDING = 2e-15;

/// Rank of the closure equations, by a rank-revealing solution.
struct Rank
{
  Index taken = 0;  ///< Number of equations used
  double weakest = 1.0;  ///< Smallest scaled singular value of an independent one
  Index distinct = 0;  ///< Number of independent equations
};

/// Singular values and all singular vectors of a large matrix, by divide and conquer.
class LargeSingular
{
public:
  void compute(const Eigen::MatrixXd & matrix, unsigned options);
  const Eigen::MatrixXd & matrixU() const {return left_;}
  const Eigen::MatrixXd & matrixV() const {return right_;}
  const Eigen::VectorXd & singularValues() const {return values_;}

private:
  Eigen::MatrixXd left_, right_;
  Eigen::VectorXd values_;
};

/// Most rows and columns of matrices that are kept on the stack: those of most mechanisms.
constexpr int FEW = 24;

/// Matrices and vectors of at most so many rows and columns; Eigen::Dynamic: of any number.
template<int Most>
struct Sized
{
  using Matrix = Eigen::Matrix<
    double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, Most, Most>;
  using ByColumn = Eigen::Matrix<
    double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, Most, Most>;
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, Most, 1>;
  // Small matrices: accurate, and without memory of its own; large ones: many times as fast.
  using Singular = std::conditional_t<
    Most == Eigen::Dynamic, LargeSingular, Eigen::JacobiSVD<ByColumn>>;
  using Pivoted = std::conditional_t<
    Most == Eigen::Dynamic, PivotedQr, Eigen::ColPivHouseholderQR<ByColumn>>;
};

/// The dense equations J x = right, I x = force + J^T lambda.
template<int Most>
struct DenseEquations
{
  typename Sized<Most>::Vector right, force;
  typename Sized<Most>::Vector psi, rate;  ///< Closure errors of positions and rates
};

/// The closure equations and the inertias at one position, for any rates.
template<int Most>
struct Decomposition
{
  typename Sized<Most>::Matrix gim;
  typename Sized<Most>::Vector row_scale, column_scale;
  typename Sized<Most>::Singular singular;  ///< Of the scaled J
  double largest = 0.0;  ///< Entry of J
  bool finite = false;

  /// Decompose J; store I.
  void decompose(const Model &, Table jac, Table gim);
};

/// What closure errors, shape (nc,), and coordinates, (nv,), are counted in: angles in radians,
/// places and slides in sizes of the loops that they belong to [m], couplings, which have factors of
/// any size, in what they change by. `places`, shape (nc,): 1 for equations that hold places, else 0.
void loop_units(const Model &, Indices places, Table jac, Values rows, Values columns);

/// Scales of the rows and columns of J that make its entries comparable lengths.
void scales(const Model &, Table jac, Values row, Values column);

/// Solve with the distinct equations, at most so many, with the least multipliers for that motion,
/// which are computed for accelerations only. NaN where a force acts on a motion without inertia.
template<int Most>
Rank solve(
  const Decomposition<Most> &, const DenseEquations<Most> &, Index most, double speed, Level,
  Values motion, Values lam);

/// Least-squares multipliers of the kept equations with the joint forces of all of them.
void multipliers_of_kept(Table jac, Values lam, Indices kept, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__NULL_SPACE_HPP_
