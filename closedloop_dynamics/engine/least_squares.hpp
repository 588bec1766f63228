// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LEAST_SQUARES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LEAST_SQUARES_HPP_

#include <Eigen/QR>

namespace closedloop
{

/// QR factors of a matrix with its columns in the order of their pivots; compiled once, as it costs
/// seconds.
class PivotedQr
{
public:
  void compute(const Eigen::MatrixXd & matrix);
  /// R in the upper triangle.
  const Eigen::MatrixXd & packed() const {return factors_.matrixQR();}
  const auto & order() const {return factors_.colsPermutation();}
  /// Multiply by Q from the left.
  void turn(Eigen::MatrixXd & matrix) const;
  void turn(Eigen::VectorXd & vector) const;
  /// An x that minimises |matrix x - wanted|.
  Eigen::VectorXd solve(const Eigen::VectorXd & wanted) const;

private:
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> factors_;
};

/// Least squares of any rank, minimum-norm solution; compiled once, as it costs seconds.
class LeastSquares
{
public:
  /// Factorise; pivots below threshold times the largest belong to dependent columns.
  void compute(const Eigen::MatrixXd & matrix, double threshold);
  /// The minimum-norm x that minimises |matrix x - wanted|.
  Eigen::VectorXd solve(const Eigen::VectorXd & wanted) const;
  Eigen::Index rank() const {return decomposition_.rank();}
  /// Columns that span all x with matrix x = 0, orthonormal.
  Eigen::MatrixXd null_space() const;

private:
  Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd> decomposition_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LEAST_SQUARES_HPP_
