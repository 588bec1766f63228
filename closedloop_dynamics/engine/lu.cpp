// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "lu.hpp"

#include <algorithm>
#include <cmath>

namespace closedloop
{

double factorize(Table matrix, Indices pivots)
{
  const Index n = matrix.rows;
  double smallest = 0.0, most = 0.0;
  for (Index k = 0; k < n; ++k) {
    Index pivot = k;
    for (Index i = k + 1; i < n; ++i) {
      if (std::abs(matrix(i, k)) > std::abs(matrix(pivot, k))) {
        pivot = i;
      }
    }
    pivots[k] = pivot;
    if (pivot != k) {
      std::swap_ranges(matrix.row(k), matrix.row(k) + n, matrix.row(pivot));
    }
    const double size = std::abs(matrix(k, k));
    if (k == 0 || !(size >= smallest)) {
      smallest = size;
    }
    most = std::max(most, size);
    const double inverse = 1.0 / matrix(k, k);
    for (Index i = k + 1; i < n; ++i) {
      const double scale = matrix(i, k) * inverse;
      matrix(i, k) = scale;
      if (scale != 0.0) {
        for (Index j = k + 1; j < n; ++j) {
          matrix(i, j) -= scale * matrix(k, j);
        }
      }
    }
  }
  return n > 0 ? smallest / most : 1.0;
}

void solve(Table matrix, Indices pivots, Values right)
{
  const Index n = matrix.rows;
  for (Index k = 0; k < n; ++k) {
    std::swap(right[pivots[k]], right[k]);
  }
  for (Index k = 0; k < n; ++k) {
    const double value = right[k];
    if (value != 0.0) {
      for (Index i = k + 1; i < n; ++i) {
        right[i] -= matrix(i, k) * value;
      }
    }
  }
  for (Index i = n - 1; i >= 0; --i) {
    double total = right[i];
    for (Index j = i + 1; j < n; ++j) {
      total -= matrix(i, j) * right[j];
    }
    right[i] = total / matrix(i, i);
  }
}

}  // namespace closedloop
