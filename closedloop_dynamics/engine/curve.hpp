// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__CURVE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__CURVE_HPP_

#include "effect_table.hpp"
#include "forces.hpp"

// Distance of a point from a curve of a body: a chain of cubics (x, y)(u), 0 <= u <= 1, whose free
// side is on the left.

namespace closedloop
{

namespace curve
{
/// Numbers of a piece: x = c0 + u (c1 + u (c2 + u c3)), and y.
constexpr Index COLUMNS = 8;
}

/// The pieces of the curve of an effect.
Values pieces_of_curve(const EffectTable &, Index row);

/// How far a point is from a curve.
struct CurveDistance
{
  /// Normal to the free side, in the frame of the curve's body.
  Vector2 normal;
  /// On the free side; negative in the solid [m].
  double distance;
};

/// Memory of the search for the nearest piece, a row of SceneCode.present: the nearest pieces at the
/// last full search; the distance of all others from the point then [m], NaN before the first
/// search; that point [m]; the latest point, with its normal and distance.
namespace nearby
{
enum : Index {BEYOND, PLACE, PIECES = 3, LAST = 7};
constexpr Index CANDIDATES = LAST - PIECES;
}

/// Distance of a point, in the frame of the curve's body [m], from a curve of some pieces;
/// `closed`: the curve ends where it begins. Memory does not change the result.
CurveDistance distance_from_curve(
  Values pieces, Vector2 point, bool closed, double * memory);

/// The place of a curve of some pieces that lies furthest in a direction, in the frame of the
/// curve's body [m].
Vector2 furthest_of_curve(Values pieces, Vector2 direction);

/// How near a straight path comes to a curve between its ends. Along a straight path the distance
/// from a straight piece has one valley: it counts where its lowest place is between the ends.
struct ChordDistance
{
  /// Least distance in any valley [m]; minus infinity where the path crosses the curve; infinity
  /// where there is no valley.
  double distance;
  /// Share of the path there, not quite 0 or 1; half way between the first two crossings.
  double along;
};

/// The same of the path between two points, in the frame of the body of the pieces [m].
ChordDistance nearest_to_chord(Values pieces, Vector2 start, Vector2 end);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__CURVE_HPP_
