// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "lu.hpp"

#include <algorithm>
#include <cmath>

#include "null_space.hpp"

namespace closedloop
{

double factorize(Table matrix, Indices pivots)
{
  const Index rows = matrix.rows, n = matrix.columns;
  double smallest = 0.0, most = 0.0;
  for (Index k = 0; k < n; ++k) {
    Index pivot = k;
    double size = std::abs(matrix(k, k));
    const double * entry = &matrix(k, k);
    for (Index i = k + 1; i < rows; ++i) {
      entry += n;
      if (std::abs(*entry) > size) {
        size = std::abs(*entry);
        pivot = i;
      }
    }
    pivots[k] = pivot;
    if (pivot != k) {
      std::swap_ranges(matrix.row(k), matrix.row(k) + n, matrix.row(pivot));
    }
    if (k == 0 || !(size >= smallest)) {
      smallest = size;
    }
    most = std::max(most, size);
    const double inverse = 1.0 / matrix(k, k);
    const double * from = matrix.row(k);
    for (Index i = k + 1; i < rows; ++i) {
      double * to = matrix.row(i);
      const double scale = to[k] * inverse;
      to[k] = scale;
      if (scale != 0.0) {
        for (Index j = k + 1; j < n; ++j) {
          to[j] -= scale * from[j];
        }
      }
    }
  }
  return n > 0 ? smallest / most : 1.0;
}

void solve(Table matrix, Indices pivots, Values right)
{
  const Index n = matrix.columns;
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

void solve(Table matrix, Indices pivots, Table right)
{
  const Index n = matrix.columns;
  const auto subtract = [&](Index from, Index to) {
      if (matrix(to, from) != 0.0) {
        dense(right[to]) -= matrix(to, from) * dense(right[from]);
      }
    };
  for (Index k = 0; k < n; ++k) {
    if (pivots[k] != k) {
      dense(right[k]).swap(dense(right[pivots[k]]));
    }
  }
  for (Index i = 1; i < n; ++i) {
    for (Index k = 0; k < i; ++k) {
      subtract(k, i);
    }
  }
  for (Index i = n - 1; i >= 0; --i) {
    for (Index j = i + 1; j < n; ++j) {
      subtract(j, i);
    }
    dense(right[i]) /= matrix(i, i);
  }
}

}  // namespace closedloop
