// Copyright 2026 The closedloop_dynamics authors
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

/// @file
/// Least squares with a matrix of any rank.

#pragma once

#include <Eigen/Core>

namespace closedloop {

/// Rows one after the other, as in Python's arrays.
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Find the shortest `solution` (columns) among those that leave the least of
/// `right` - `matrix` `solution` (rows); return the rank of `matrix` (rows, columns).
///
/// A pivot of at most `tolerance` times the largest one counts as zero. By complete orthogonal
/// decomposition: Golub and Van Loan, Matrix Computations, 4th edition, 5.4.7.
long least_squares(
    Eigen::Map<const Matrix> matrix, Eigen::Map<const Eigen::VectorXd> right, double tolerance,
    Eigen::Map<Eigen::VectorXd> solution);

}  // namespace closedloop
