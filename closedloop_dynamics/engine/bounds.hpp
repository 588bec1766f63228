// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__BOUNDS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__BOUNDS_HPP_

#include <algorithm>

#include "array.hpp"

// Whether places and shapes of arrays are within bounds: kernels index blindly.

namespace closedloop
{

inline bool is_place(Index place, Index size) {return place >= 0 && place < size;}

/// Whether rows `first` to `last` are among so many.
inline bool is_range(Index first, Index last, Index size)
{
  return first >= 0 && first <= last && last <= size;
}

inline bool within(Indices values, Index low, Index high)
{
  return std::all_of(
    values.begin(), values.end(), [=](Index each) {return each >= low && each <= high;});
}

/// Whether all are places in an array, or from `low` on stand for none.
inline bool are_places(Indices values, Index low, Index size)
{
  return within(values, low, size - 1);
}

/// Whether all entries of a column are within bounds.
inline bool within(Indexes table, Index column, Index first, Index low, Index high)
{
  for (Index i = first; i < table.rows; ++i) {
    if (table(i, column) < low || table(i, column) > high) {
      return false;
    }
  }
  return true;
}

inline bool has_shape(Table table, Index rows, Index columns)
{
  return table.rows == rows && table.columns == columns;
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__BOUNDS_HPP_
