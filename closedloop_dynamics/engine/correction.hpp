// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__CORRECTION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__CORRECTION_HPP_

#include "array.hpp"

// The update of a Kalman filter: n errors, which readings show.

namespace closedloop
{

/// Correct n errors by m numbers that sensors have read, with white noise. With the factors of the
/// covariance of the innovations, S = H P H^T + R = L L^T, and W = L^-1 H P, the errors change by
/// W^T L^-1 r, and their covariance becomes P - W^T W.
///
/// `covariance`: P, shape (n, n); `slope`: H, shape (m, n); `residual`, `noise`: r and the diagonal of
/// R, shape (m,). Numbers of sensor s are those from first[s] to first[s + 1]; where r^T S^-1 r of them
/// exceeds gate[s], it is left out. Written: `spread`: S, shape (m, m); `squares`: r^T S^-1 r of each
/// sensor; `whitened`: W, shape (m, n); `white`: L^-1 r; `others`, shape (m, any), multiplied by L^-1,
/// all of them 0 where a sensor is left out; `change`, shape (n,); `after`, shape (n, n). `factors` is
/// scratch, shape (m, m). Returns whether S is positive definite.
bool correct_errors(
  Table covariance, Table slope, Values residual, Values noise, Indices first, Values gate,
  Table spread, Table factors, Values squares, Table whitened, Values white, Table others,
  Values change, Table after);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__CORRECTION_HPP_
