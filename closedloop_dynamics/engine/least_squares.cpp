// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "least_squares.hpp"

namespace closedloop
{

void PivotedQr::compute(const Eigen::MatrixXd & matrix)
{
  factors_.compute(matrix);
}

void PivotedQr::turn(Eigen::MatrixXd & matrix) const
{
  matrix.applyOnTheLeft(factors_.householderQ());
}

void PivotedQr::turn(Eigen::VectorXd & vector) const
{
  vector.applyOnTheLeft(factors_.householderQ());
}

Eigen::VectorXd PivotedQr::solve(const Eigen::VectorXd & wanted) const
{
  return factors_.solve(wanted);
}

void LeastSquares::compute(const Eigen::MatrixXd & matrix, double threshold)
{
  decomposition_.setThreshold(threshold);
  decomposition_.compute(matrix);
}

Eigen::VectorXd LeastSquares::solve(const Eigen::VectorXd & wanted) const
{
  return decomposition_.solve(wanted);
}

Eigen::MatrixXd LeastSquares::null_space() const
{
  return decomposition_.colsPermutation() * decomposition_.matrixZ().transpose().rightCols(
    decomposition_.cols() - decomposition_.rank());
}

}  // namespace closedloop
