// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "library.hpp"

#include "curve.hpp"

namespace closedloop
{

namespace
{
/// `entries`: of the effect, so many numbers; `memory`: its row of SceneCode.present; `flag`, `x`,
/// `y`: arguments of the search; `results`: up to three results after the returned one.
using Function = double (
  const double * entries, double * memory, double length, double flag, double x, double y,
  double * results);

Values as_values(const double * entries, double length)
{
  // Searches only read the entries.
  return {const_cast<double *>(entries), static_cast<Index>(length)};
}

// Numbers of an entry of a force table: stroke at which a piece begins, coefficients, energy there.
constexpr Index COLUMNS = 6;

/// Force [N; N m] at a stroke, x [m; rad], and energy there [J].
double look_up(
  const double * entries, double *, double length, double, double x, double, double * results)
{
  // The piece before the table begins where its first one does.
  Index low = 0, high = x < entries[0] ? 0 : static_cast<Index>(length) / COLUMNS - 1;
  while (high - low > 0) {
    const Index middle = (low + high + 1) / 2;
    if (entries[COLUMNS * middle] <= x) {
      low = middle;
    } else {
      high = middle - 1;
    }
  }
  const double * c = entries + COLUMNS * low;
  const double u = x - c[0];
  results[0] = c[5] + u * (c[1] + u * (c[2] / 2.0 + u * (c[3] / 3.0 + u * c[4] / 4.0)));
  return c[1] + u * (c[2] + u * (c[3] + u * c[4]));
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
  const Function * found = which == library::LOOK_UP ? look_up :
    which == library::NEAREST ? nearest : which == library::FURTHEST ? furthest : nullptr;
  return reinterpret_cast<Index>(found);
}

}  // namespace closedloop
