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
  double first = 0.0, most = 0.0;
  Index at = 0, to = 0;
  // The largest entry is noted while entries are written.
  const auto note = [&](Index i, Index j, double value) {
      if (std::abs(value) > most) {
        most = std::abs(value);
        at = i;
        to = j;
      }
    };
  for (Index i = 0; i < rows; ++i) {
    for (Index j = 0; j < columns; ++j) {
      note(i, j, matrix(i, j));
    }
  }
  for (Index k = 0; k < rows; ++k) {
    first = k == 0 ? most : first;
    if (!(most > share * first)) {
      return k;
    }
    double * pivot = matrix.row(k);
    if (at != k) {
      std::swap_ranges(pivot, pivot + columns, matrix.row(at));
      std::swap(row[k], row[at]);
    }
    if (to != k) {
      for (Index i = 0; i < rows; ++i) {
        std::swap(matrix(i, k), matrix(i, to));
      }
      std::swap(column[k], column[to]);
    }
    most = 0.0;
    const double inverse = 1.0 / pivot[k];
    for (Index i = k + 1; i < rows; ++i) {
      double * other = matrix.row(i);
      const double scale = other[k] *= inverse;
      for (Index j = k + 1; j < columns; ++j) {
        other[j] -= scale * pivot[j];
        note(i, j, other[j]);
      }
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
    case 7:
      return function(std::integral_constant<Index, 7>());
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

/// Factor a square matrix of so many rows in place, its pivots in their places, replaced by their
/// inverses.
template<class Rows>
inline void factorize_in_place(Rows n, Lanes * a)
{
  for_each_row(n, [&](auto k) {
      const Lanes inverse = 1.0 / a[k * n + k];
      a[k * n + k] = inverse;
      for_each_row_after(k, n, [&](auto i) {
        a[i * n + k] *= inverse;
        const Lanes scale = a[i * n + k];
        for_each_row_after(k, n, [&](auto j) {a[i * n + j] -= scale * a[k * n + j];});
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

/// The same of so many numbers.
template<class Count>
inline double dot(Count count, Values a, Values b)
{
  if constexpr (std::is_same_v<Count, Index>) {
    return dot(a, b);
  }
  double total = 0.0;
  for_each_row(count, [&](auto n) {total += a.data[n] * b.data[n];});
  return total;
}

/// Factor a symmetric positive definite matrix in place, lower triangle, its pivots replaced by their
/// inverses; false where it is not positive definite.
inline bool factorize_positive(Table matrix)
{
  for (Index k = 0; k < matrix.rows; ++k) {
    if (!(matrix(k, k) > 0.0)) {
      return false;
    }
    matrix(k, k) = 1.0 / matrix(k, k);
    for (Index i = k + 1; i < matrix.rows; ++i) {
      const double scale = matrix(i, k) * matrix(k, k);
      for (Index j = k + 1; j <= i; ++j) {
        matrix(i, j) -= scale * matrix(j, k);
      }
    }
  }
  return true;
}

/// Solve with these factors in place.
inline void solve_positive(Table factor, Values right)
{
  for (Index k = 0; k < factor.rows; ++k) {
    right[k] *= factor(k, k);
    for (Index i = k + 1; i < factor.rows; ++i) {
      right[i] -= factor(i, k) * right[k];
    }
  }
  for (Index i = factor.rows - 1; i > 0; --i) {
    for (Index k = 0; k < i; ++k) {
      right[k] -= factor(k, k) * factor(i, k) * right[i];
    }
  }
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SMALL_FACTORS_HPP_
