// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "null_space.hpp"

namespace closedloop
{

// In a file of its own, as it takes half a minute to compile: as long as all of null_space.cpp.
void LargeSingular::compute(const Eigen::MatrixXd & matrix, unsigned options)
{
  const Eigen::BDCSVD<Eigen::MatrixXd> found(matrix, options);
  left_ = found.matrixU();
  right_ = found.matrixV();
  values_ = found.singularValues();
}

}  // namespace closedloop
