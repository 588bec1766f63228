// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SMALL_FACTORS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SMALL_FACTORS_HPP_

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>

#include "array.hpp"
#include "places.hpp"

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
  double first = 0.0, most = -1.0, next = -1.0;
  Index at = 0;
  // The row with the largest entry is noted while entries are written.
  const auto note = [&](Index i, double largest) {
      if (largest > next) {
        next = largest;
        at = i;
      }
    };
  for (Index i = 0; i < rows; ++i) {
    double largest = 0.0;
    for (Index j = 0; j < columns; ++j) {
      largest = std::max(largest, std::abs(matrix(i, j)));
    }
    note(i, largest);
  }
  for (Index k = 0; k < rows; ++k) {
    most = next;
    next = -1.0;
    first = k == 0 ? most : first;
    if (!(most > share * first)) {
      return k;
    }
    double * pivot = matrix.row(k);
    if (at != k) {
      std::swap_ranges(pivot, pivot + columns, matrix.row(at));
      std::swap(row[k], row[at]);
    }
    Index to = k;
    while (to + 1 < columns && std::abs(pivot[to]) != most) {
      ++to;
    }
    if (to != k) {
      for (Index i = 0; i < rows; ++i) {
        std::swap(matrix(i, k), matrix(i, to));
      }
      std::swap(column[k], column[to]);
    }
    const double inverse = 1.0 / pivot[k];
    for (Index i = k + 1; i < rows; ++i) {
      double * other = matrix.row(i);
      const double scale = other[k] *= inverse;
      double largest = 0.0;
      for (Index j = k + 1; j < columns; ++j) {
        other[j] -= scale * pivot[j];
        largest = std::max(largest, std::abs(other[j]));
      }
      note(i, largest);
    }
  }
  return rows;
}

/// Call a function with a number of rows: a constant where there are few, so that the compiler sees
/// all their loops unrolled.
template<class Function>
inline void with_rows(Index rows, Function && function)
{
  switch (rows) {
    case 2:
      return function(std::integral_constant<Index, 2>());
    case 3:
      return function(std::integral_constant<Index, 3>());
    case 4:
      return function(std::integral_constant<Index, 4>());
    case 5:
      return function(std::integral_constant<Index, 5>());
    case 6:
      return function(std::integral_constant<Index, 6>());
    default:
      return function(rows);
  }
}

/// Call a function with such numbers of rows.
template<class Function, Index... ROWS>
inline void for_each_of(std::integer_sequence<Index, ROWS...>, Function && function)
{
  (function(std::integral_constant<Index, ROWS>()), ...);
}

/// Call a function with the rows of a number of them, in turn, with those after one, or with those
/// before one.
template<class Rows, class Function>
inline void for_each_row(Rows rows, Function && function)
{
  if constexpr (std::is_same_v<Rows, Index>) {
    for (Index i = 0; i < rows; ++i) {
      function(i);
    }
  } else {
    for_each_of(std::make_integer_sequence<Index, Rows::value>(), function);
  }
}

template<class Rows, class Row, class Function>
inline void for_each_row_after(Row row, Rows rows, Function && function)
{
  if constexpr (std::is_same_v<Rows, Index>) {
    for (Index i = row + 1; i < rows; ++i) {
      function(i);
    }
  } else {
    for_each_row(rows, [&](auto i) {
        if (i > row) {
          function(i);
        }
      });
  }
}

template<class Rows, class Row, class Function>
inline void for_each_row_before(Row row, Rows rows, Function && function)
{
  if constexpr (std::is_same_v<Rows, Index>) {
    for_each_row(row, function);
  } else {
    for_each_row(rows, [&](auto i) {
        if (i < row) {
          function(i);
        }
      });
  }
}

/// Call a function with all rows, the last one first.
template<class Rows, class Function>
inline void for_each_row_back(Rows rows, Function && function)
{
  if constexpr (std::is_same_v<Rows, Index>) {
    for (Index i = rows - 1; i >= 0; --i) {
      function(i);
    }
  } else {
    for_each_row(rows, [&](auto i) {
        function(std::integral_constant<Index, Rows::value - 1 - decltype(i)::value>());
      });
  }
}

/// Factor a square matrix in place, its pivots in their places, replaced by their inverses.
inline void factorize_in_place(LaneTable matrix)
{
  with_rows(matrix.rows, [a = matrix.data](auto n) {
      for_each_row(n, [&](auto k) {
        const Lanes inverse = 1.0 / a[k * n + k];
        a[k * n + k] = inverse;
        for_each_row_after(k, n, [&](auto i) {
          a[i * n + k] *= inverse;
          const Lanes scale = a[i * n + k];
          for_each_row_after(k, n, [&](auto j) {a[i * n + j] -= scale * a[k * n + j];});
        });
      });
    });
}

/// Solve with these factors in place.
inline void solve_in_place(LaneTable factor, LaneValues right)
{
  with_rows(factor.rows, [a = factor.data, x = right.data](auto n) {
      for_each_row(n, [&](auto k) {
        const Lanes value = x[k];
        for_each_row_after(k, n, [&](auto i) {x[i] -= a[i * n + k] * value;});
      });
      for_each_row_back(n, [&](auto k) {
        x[k] *= a[k * n + k];
        const Lanes value = x[k];
        for_each_row_before(k, n, [&](auto i) {x[i] -= a[i * n + k] * value;});
      });
    });
}

/// The same with the transpose of the matrix.
inline void solve_transposed(LaneTable factor, LaneValues right)
{
  with_rows(factor.rows, [a = factor.data, x = right.data](auto n) {
      for_each_row(n, [&](auto i) {
        x[i] *= a[i * n + i];
        const Lanes value = x[i];
        for_each_row_after(i, n, [&](auto k) {x[k] -= a[i * n + k] * value;});
      });
      for_each_row_back(n, [&](auto i) {
        const Lanes value = x[i];
        for_each_row_before(i, n, [&](auto k) {x[k] -= a[i * n + k] * value;});
      });
    });
}

/// Sum of products, in four parts that do not wait for one another.
inline double dot(Values a, Values b)
{
  double one = 0.0, two = 0.0, three = 0.0, four = 0.0;
  Index n = 0;
  for (; n + 4 <= a.size; n += 4) {
    one += a[n] * b[n];
    two += a[n + 1] * b[n + 1];
    three += a[n + 2] * b[n + 2];
    four += a[n + 3] * b[n + 3];
  }
  for (; n < a.size; ++n) {
    one += a[n] * b[n];
  }
  return (one + two) + (three + four);
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
