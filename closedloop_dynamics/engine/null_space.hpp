// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__NULL_SPACE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__NULL_SPACE_HPP_

#include <Eigen/Core>

#include "model.hpp"

// Solution with dependent closure equations, by singular values.

namespace closedloop
{

using DenseMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using DenseVector = Eigen::VectorXd;

inline Table view(DenseMatrix & matrix) {return {matrix.data(), matrix.rows(), matrix.cols()};}
inline Values view(DenseVector & vector) {return {vector.data(), vector.size()};}
inline Eigen::Map<DenseVector> dense(Values values) {return {values.data, values.size};}
inline Eigen::Map<DenseMatrix> dense(Table table) {return {table.data, table.rows, table.columns};}

/// Singular values below this belong to a singular configuration nearby: whether such an
/// equation is taken depends on whether its right-hand side can be told from its error.
constexpr double WEAK = 0.1;
/// Rounding of scaled places and terms.
constexpr double ROUNDING = 2e-15;

/// What a rank-revealing solution found of the closure equations.
struct Rank
{
  Index taken = 0;  ///< Number of equations taken
  double weakest = 1.0;  ///< Smallest scaled singular value of one that repeats no other
  Index distinct = 0;  ///< Number of equations that repeat no other
};

/// The dense equations J x = right, I x = force + J^T lambda.
struct DenseEquations
{
  DenseMatrix jac, gim;
  DenseVector right, force;
  DenseVector psi, rate;  ///< Closure errors of positions and rates
};

/// Scales of the rows and columns of J that make its entries comparable lengths.
void scales(const Model &, const DenseMatrix & jac, DenseVector & row, DenseVector & column);

/// Solve with the equations that can be told apart; motion is NaN where one without inertia is
/// pushed; of all multipliers that give the same motion the least ones.
Rank solve(
  const Model &, const DenseEquations &, double speed, Level, Values motion, Values lam);

/// Least-squares multipliers of the kept equations with the joint forces of all of them.
void multipliers_of_kept(Table jac, Values lam, Indices kept, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__NULL_SPACE_HPP_
