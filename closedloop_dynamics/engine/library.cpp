// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "library.hpp"

#include <algorithm>

#include "columns.hpp"
#include "curve.hpp"

namespace closedloop
{

namespace
{
/// `entries`: of the effect, so many numbers; `memory`: its row of SceneCode.present; `flag`, `x`,
/// `y`: arguments of the search; `results`: up to five results after the returned one.
using Function = double (
  const double * entries, double * memory, double length, double flag, double x, double y,
  double * results);

Values as_values(const double * entries, double length)
{
  // Searches only read the entries.
  return {const_cast<double *>(entries), static_cast<Index>(length)};
}

/// The last entry that begins before x, `flag` numbers each: where it begins, and its others.
double piece(
  const double * entries, double *, double length, double flag, double x, double,
  double * results)
{
  // Before the table its first entry is the one.
  const Index columns = static_cast<Index>(flag);
  Index low = 0, high = x < entries[0] ? 0 : static_cast<Index>(length) / columns - 1;
  while (high - low > 0) {
    const Index middle = (low + high + 1) / 2;
    if (entries[columns * middle] <= x) {
      low = middle;
    } else {
      high = middle - 1;
    }
  }
  const double * found = entries + columns * low;
  std::copy(found + 1, found + columns, results);
  return found[0];
}

/// Distance of a point (x, y) from a curve, closed where the flag is one, and the normal.
double nearest(
  const double * entries, double * memory, double length, double flag, double x, double y,
  double * results)
{
  const CurveDistance found =
    distance_from_curve(as_values(entries, length), {x, y}, flag == 1.0, memory);
  results[0] = found.normal.x;
  results[1] = found.normal.y;
  return found.distance;
}

/// The place of a curve that lies furthest in a direction (x, y).
double furthest(
  const double * entries, double *, double length, double, double x, double y, double * results)
{
  const Vector2 found = furthest_of_curve(as_values(entries, length), {x, y});
  results[0] = found.y;
  return found.x;
}
}  // namespace

Index library_function(Index which)
{
  Function * found = which == routine::PIECE ? piece :
    which == routine::NEAREST ? nearest : which == routine::FURTHEST ? furthest : nullptr;
  return reinterpret_cast<Index>(found);
}

}  // namespace closedloop
