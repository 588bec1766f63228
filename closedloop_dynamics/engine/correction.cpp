// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "correction.hpp"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <stdexcept>

namespace closedloop
{

namespace
{
/// Factor a block on the diagonal in place, into a lower triangle: whether it is positive definite.
bool factorize_block(Table matrix, Index first, Index end)
{
  for (Index i = first; i < end; ++i) {
    for (Index j = first; j <= i; ++j) {
      double sum = matrix(i, j);
      for (Index k = first; k < j; ++k) {
        sum -= matrix(i, k) * matrix(j, k);
      }
      if (i > j) {
        matrix(i, j) = sum / matrix(j, j);
      } else if (sum > 0.0) {
        matrix(i, i) = std::sqrt(sum);
      } else {
        return false;
      }
    }
  }
  return true;
}

/// Multiply rows by the inverse of the lower triangle of a block.
void whiten(Table factors, Index first, Index end, Table rows)
{
  for (Index i = first; i < end; ++i) {
    for (Index column = 0; column < rows.columns; ++column) {
      double sum = rows(i, column);
      for (Index k = first; k < i; ++k) {
        sum -= factors(i, k) * rows(k, column);
      }
      rows(i, column) = sum / factors(i, i);
    }
  }
}

/// Leave out a number: its error is 1, and shows in nothing else.
void leave_out(Index number, Table factors, std::initializer_list<Table> all)
{
  for (Index other = 0; other < factors.rows; ++other) {
    factors(number, other) = factors(other, number) = number == other ? 1.0 : 0.0;
  }
  for (Table each : all) {
    each[number].fill(0.0);
  }
}
}  // namespace

bool correct_errors(
  Table covariance, Table slope, Values residual, Values noise, Indices first, Values gate,
  Table spread, Table factors, Values squares, Table whitened, Values white, Table others,
  Values change, Table after)
{
  const Index m = slope.rows, n = slope.columns;
  if (!(first[0] == 0 && first[gate.size] == m && std::is_sorted(first.begin(), first.end()))) {
    throw std::invalid_argument("correct_errors: expected the numbers of the sensors in turn");
  }
  const auto all = {whitened, Table{white.data, m, 1}, others};
  whitened.fill(0.0);
  for (Index i = 0; i < m; ++i) {
    white[i] = residual[i];
    for (Index k = 0; k < n; ++k) {
      for (Index j = 0; slope(i, k) != 0.0 && j < n; ++j) {
        whitened(i, j) += slope(i, k) * covariance(k, j);
      }
    }
    for (Index j = 0; j < m; ++j) {
      spread(i, j) = i == j ? noise[i] : 0.0;
      for (Index k = 0; k < n; ++k) {
        spread(i, j) += whitened(i, k) * slope(j, k);
      }
    }
  }
  // Each sensor by itself.
  std::copy_n(spread.data, m * m, factors.data);
  for (Index sensor = 0; sensor < gate.size; ++sensor) {
    const Index begin = first[sensor], end = first[sensor + 1];
    if (!factorize_block(factors, begin, end)) {
      return false;
    }
    whiten(factors, begin, end, {white.data, m, 1});
    squares[sensor] = 0.0;
    for (Index i = begin; i < end; ++i) {
      squares[sensor] += white[i] * white[i];
      white[i] = residual[i];
    }
  }
  // All that are used together.
  std::copy_n(spread.data, m * m, factors.data);
  for (Index sensor = 0; sensor < gate.size; ++sensor) {
    for (Index i = first[sensor]; !(squares[sensor] <= gate[sensor]) && i < first[sensor + 1]; ++i) {
      leave_out(i, factors, all);
    }
  }
  if (!factorize_block(factors, 0, m)) {
    return false;
  }
  for (Table each : all) {
    whiten(factors, 0, m, each);
  }
  for (Index i = 0; i < n; ++i) {
    change[i] = 0.0;
    for (Index k = 0; k < m; ++k) {
      change[i] += whitened(k, i) * white[k];
    }
    for (Index j = 0; j <= i; ++j) {
      double sum = 0.5 * (covariance(i, j) + covariance(j, i));
      for (Index k = 0; k < m; ++k) {
        sum -= whitened(k, i) * whitened(k, j);
      }
      after(i, j) = after(j, i) = sum;
    }
  }
  return true;
}

}  // namespace closedloop
