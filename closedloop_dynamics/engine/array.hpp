// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ARRAY_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ARRAY_HPP_

#include <algorithm>
#include <cassert>
#include <cstdint>

// Views of arrays that somebody else owns: a pointer and the lengths, row by row in memory. Places
// are checked in builds with assertions (scripts/sanitize).

namespace closedloop
{

using Index = std::int64_t;

/// Numbers side by side.
template<class Number>
struct Vector
{
  Number * data = nullptr;
  Index size = 0;

  Number & operator[](Index i) const
  {
    assert(i >= 0 && i < size);
    return data[i];
  }
  Number * begin() const {return data;}
  Number * end() const {return data + size;}
  /// The `count` entries from `first` on.
  Vector part(Index first, Index count) const
  {
    assert(first >= 0 && count >= 0 && first + count <= size);
    return {data + first, count};
  }
  /// The entries from `first` on.
  Vector from(Index first) const {return part(first, size - first);}
  void fill(Number value) const {for (Number & each : *this) {each = value;}}
};

/// Rows of the same length, one after the other.
template<class Number>
struct Matrix
{
  Number * data = nullptr;
  Index rows = 0;
  Index columns = 0;

  Number & operator()(Index i, Index j) const
  {
    assert(i >= 0 && i < rows && j >= 0 && j < columns);
    return data[i * columns + j];
  }
  Vector<Number> operator[](Index i) const {return {row(i), columns};}
  /// Where a row begins.
  Number * row(Index i) const
  {
    assert(i >= 0 && i < rows);
    return data + i * columns;
  }
  /// The rows from `first` on.
  Matrix from(Index first) const {return {data + first * columns, rows - first, columns};}
  Vector<Number> all() const {return {data, rows * columns};}
  void fill(Number value) const {all().fill(value);}
};

/// Matrices of the same shape, one after the other.
template<class Number>
struct Cube
{
  Number * data = nullptr;
  Index pages = 0;
  Index rows = 0;
  Index columns = 0;

  Matrix<Number> operator[](Index i) const
  {
    assert(i >= 0 && i < pages);
    return {data + i * rows * columns, rows, columns};
  }
  Vector<Number> all() const {return {data, pages * rows * columns};}
};

using Values = Vector<double>;
using Table = Matrix<double>;
using Indices = Vector<Index>;
using Indexes = Matrix<Index>;

/// An optional argument: an array of numbers, absent, or of a wrong type.
struct Given
{
  Vector<const double> numbers;
  bool is_array = false;
  bool is_none = false;
};

/// Copy the entries of `from`, as many as `to` has.
template<class Number>
void copy(Vector<Number> from, Vector<Number> to)
{
  assert(from.size >= to.size);
  std::copy_n(from.data, to.size, to.data);
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ARRAY_HPP_
