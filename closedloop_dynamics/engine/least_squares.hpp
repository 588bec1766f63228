// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LEAST_SQUARES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LEAST_SQUARES_HPP_

#include <Eigen/QR>

namespace closedloop
{

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
