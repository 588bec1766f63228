// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SMALL_FACTORS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SMALL_FACTORS_HPP_

#include <algorithm>
#include <cmath>

#include "array.hpp"

// Factors of matrices of a few rows, in place, to be inlined where they are used.

namespace closedloop
{

/// Factor a matrix in place, with complete pivoting; `row` and `column` are the permutations.
/// Return the number of pivots above a share of the first one; the others are not eliminated.
inline Index factorize_fully(Table matrix, Indices row, Indices column, double share)
{
  const Index rows = matrix.rows, columns = matrix.columns;
  for (Index i = 0; i < rows; ++i) {
    row[i] = i;
  }
  for (Index j = 0; j < columns; ++j) {
    column[j] = j;
  }
  double first = 0.0;
  for (Index k = 0; k < rows; ++k) {
    Index at = k, to = k;
    double most = -1.0;
    for (Index i = k; i < rows; ++i) {
      for (Index j = k; j < columns; ++j) {
        if (std::abs(matrix(i, j)) > most) {
          most = std::abs(matrix(i, j));
          at = i;
          to = j;
        }
      }
    }
    first = k == 0 ? most : first;
    if (!(most > share * first)) {
      return k;
    }
    if (at != k) {
      std::swap_ranges(matrix.row(k), matrix.row(k) + columns, matrix.row(at));
      std::swap(row[k], row[at]);
    }
    if (to != k) {
      for (Index i = 0; i < rows; ++i) {
        std::swap(matrix(i, k), matrix(i, to));
      }
      std::swap(column[k], column[to]);
    }
    const double inverse = 1.0 / matrix(k, k);
    for (Index i = k + 1; i < rows; ++i) {
      const double scale = matrix(i, k) * inverse;
      matrix(i, k) = scale;
      for (Index j = k + 1; j < columns; ++j) {
        matrix(i, j) -= scale * matrix(k, j);
      }
    }
  }
  return rows;
}

/// Factor a square matrix in place, its pivots in their places, replaced by their inverses; return
/// the smallest against the largest.
inline double factorize_in_place(Table matrix)
{
  const Index n = matrix.rows;
  double least = std::numeric_limits<double>::infinity(), most = 0.0;
  for (Index k = 0; k < n; ++k) {
    const double pivot = matrix(k, k), inverse = 1.0 / pivot;
    // Not a number: all comparisons fail.
    least = std::abs(pivot) >= least ? least : std::abs(pivot);
    most = std::max(most, std::abs(pivot));
    matrix(k, k) = inverse;
    for (Index i = k + 1; i < n; ++i) {
      if (matrix(i, k) != 0.0) {
        const double scale = matrix(i, k) *= inverse;
        for (Index j = k + 1; j < n; ++j) {
          matrix(i, j) -= scale * matrix(k, j);
        }
      }
    }
  }
  return least / most;
}

/// Solve with these factors in place.
inline void solve_in_place(Table factor, Values right)
{
  const Index n = factor.rows;
  for (Index i = 1; i < n; ++i) {
    for (Index k = 0; k < i; ++k) {
      right[i] -= factor(i, k) * right[k];
    }
  }
  for (Index i = n - 1; i >= 0; --i) {
    for (Index k = i + 1; k < n; ++k) {
      right[i] -= factor(i, k) * right[k];
    }
    right[i] *= factor(i, i);
  }
}

/// The same with the transpose of the matrix.
inline void solve_transposed(Table factor, Values right)
{
  const Index n = factor.rows;
  for (Index i = 0; i < n; ++i) {
    right[i] *= factor(i, i);
    for (Index k = i + 1; k < n; ++k) {
      right[k] -= factor(i, k) * right[i];
    }
  }
  for (Index i = n - 1; i > 0; --i) {
    for (Index k = 0; k < i; ++k) {
      right[k] -= factor(i, k) * right[i];
    }
  }
}

/// Lower triangle of the products of rows, of so many columns, with one another.
template<class Entry>
inline void fill_products(Table out, Entry && entry, Index columns)
{
  for (Index k = 0; k < out.rows; ++k) {
    for (Index m = 0; m <= k; ++m) {
      out(k, m) = 0.0;
      for (Index j = 0; j < columns; ++j) {
        out(k, m) += entry(k, j) * entry(m, j);
      }
    }
  }
}

/// Factor a symmetric positive definite matrix in place, lower triangle; false where it is not.
inline bool factorize_positive(Table matrix)
{
  for (Index i = 0; i < matrix.rows; ++i) {
    for (Index j = 0; j <= i; ++j) {
      double total = matrix(i, j);
      for (Index k = 0; k < j; ++k) {
        total -= matrix(i, k) * matrix(j, k);
      }
      if (i == j && !(total > 0.0)) {
        return false;
      }
      matrix(i, j) = i == j ? std::sqrt(total) : total / matrix(j, j);
    }
  }
  return true;
}

/// Solve with these factors in place.
inline void solve_positive(Table factor, Values right)
{
  const Index n = factor.rows;
  for (Index i = 0; i < n; ++i) {
    for (Index k = 0; k < i; ++k) {
      right[i] -= factor(i, k) * right[k];
    }
    right[i] /= factor(i, i);
  }
  for (Index i = n - 1; i >= 0; --i) {
    right[i] /= factor(i, i);
    for (Index k = 0; k < i; ++k) {
      right[k] -= factor(i, k) * right[i];
    }
  }
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SMALL_FACTORS_HPP_
