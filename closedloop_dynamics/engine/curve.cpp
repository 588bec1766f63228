// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "curve.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace closedloop
{

namespace
{
// Steps to the nearest point of a piece; they stop when they are as short as this, those of
// Halley's method earlier: the next one would be of the order of the cube.
constexpr int MOST_STEPS = 30;
constexpr double SHORT = 1e-15, SHORT_OF_HALLEY = 1e-5;
// One less rounding.
constexpr double SURELY = 1.0 - 1e-12;
// A valley of less than this below an end of a path is no other place than that end [m].
constexpr double SHALLOW = 1e-9;

/// A place on a piece, and its first and second derivative by u.
struct CurvePoint
{
  Vector2 place;
  Vector2 tangent;
  Vector2 second;
};

/// To a point from the nearest place on a piece, and the piece's tangent there.
struct Nearest
{
  Vector2 apart;
  Vector2 tangent;
  double u;
  double square;
};

inline CurvePoint evaluate(const double * c, double u)
{
  return {
    {c[0] + u * (c[1] + u * (c[2] + u * c[3])), c[4] + u * (c[5] + u * (c[6] + u * c[7]))},
    {c[1] + u * (2.0 * c[2] + u * 3.0 * c[3]), c[5] + u * (2.0 * c[6] + u * 3.0 * c[7])},
    {2.0 * c[2] + 6.0 * u * c[3], 2.0 * c[6] + 6.0 * u * c[7]}};
}

/// From the start of a piece to its end.
Vector2 chord(const double * c)
{
  return {c[1] + c[2] + c[3], c[5] + c[6] + c[7]};
}

double within_piece(double u)
{
  return std::min(1.0, std::max(0.0, u));
}

/// How far a place of a piece is from the place of its chord with the same u, at most, divided by
/// u (1 - u): the difference is u (u - 1) (c2 + c3 (1 + u)).
double bulge(const double * c)
{
  return std::fabs(c[2]) + std::fabs(c[6]) + 2.0 * (std::fabs(c[3]) + std::fabs(c[7]));
}

/// Whether no place of a piece is nearer to a point than its start, or where `at_start` is false its
/// end.
bool is_nearest_at(bool at_start, const double * piece, Vector2 point)
{
  // At a distance d from that end, (d^2 + 2 u `away` + u^2 L^2)^(1/2) is that from a place of the
  // chord of length L, which is d + u `most` or more where `away` >= d `most` and L >= `most`.
  const Vector2 whole = chord(piece), from_start = point - Vector2{piece[0], piece[4]};
  const Vector2 from_end = at_start ? from_start : from_start - whole;
  const double along = dot(from_end, whole), away = at_start ? -along : along;
  const double most = bulge(piece), square = most * most;
  return away >= 0.0 && away * away >= square * dot(from_end, from_end) &&
         dot(whole, whole) >= square;
}

/// To a point from the nearest place of a straight piece.
Vector2 from_straight(Vector2 point, Vector2 start, Vector2 whole)
{
  const Vector2 apart = point - start;
  const double u = within_piece(dot(apart, whole) / dot(whole, whole));
  return apart - u * whole;
}

Nearest nearest_on_piece(const double * piece, Vector2 point)
{
  // The chord's nearest place to begin with.
  const Vector2 whole = chord(piece), from_start = point - Vector2{piece[0], piece[4]};
  const double along = dot(from_start, whole), length = dot(whole, whole);
  double u = !(along > 0.0) ? 0.0 : along < length ? along / length : 1.0;
  if (bulge(piece) == 0.0) {
    const Vector2 apart = from_start - u * whole;
    return {apart, whole, u, dot(apart, apart)};
  }
  CurvePoint at = evaluate(piece, u);
  for (int step = 0; step < MOST_STEPS; ++step) {
    const Vector2 apart = at.place - point;
    const double slope = dot(apart, at.tangent);
    if (u == (slope > 0.0 ? 0.0 : 1.0)) {
      // Away from the piece.
      break;
    }
    const double square = dot(at.tangent, at.tangent), curvature = square + dot(apart, at.second);
    // Where the distance is no valley, as if the piece were straight.
    const bool is_valley = curvature > 0.25 * square;
    double change;
    if (!is_valley) {
      change = slope / square;
    } else {
      const Vector2 twist = {6.0 * piece[3], 6.0 * piece[7]};
      const double third = 3.0 * dot(at.tangent, at.second) + dot(apart, twist);
      const double divisor = curvature * curvature - 0.5 * slope * third;
      // Halley's method, Newton's far from the place.
      change = divisor > 0.5 * curvature * curvature ? slope * curvature / divisor : slope / curvature;
    }
    const double better = within_piece(u - change);
    const double move = std::fabs(better - u);
    u = better;
    at = evaluate(piece, u);
    if (move <= (is_valley ? SHORT_OF_HALLEY : SHORT)) {
      break;
    }
  }
  const Vector2 apart = point - at.place;
  return {apart, at.tangent, u, dot(apart, apart)};
}

/// Square of the distance of a point from the chord of a piece.
double square_to_chord(const double * piece, Vector2 point)
{
  const Vector2 apart = point - Vector2{piece[0], piece[4]}, whole = chord(piece);
  const double along = dot(apart, whole), square = dot(whole, whole);
  if (!(along > 0.0)) {
    return dot(apart, apart);
  }
  if (along < square) {
    const double across = cross(whole, apart);
    return across * across / square;
  }
  const Vector2 past = apart - whole;
  return dot(past, past);
}

/// Number of a piece of a closed curve, at most one time round away. A division takes longer.
inline Index around(Index piece, Index count)
{
  return piece < 0 ? piece + count : piece >= count ? piece - count : piece;
}

/// A piece of a curve, and the square of the distance of its chord.
struct NearChord
{
  double square;
  Index piece;

  /// The earlier of two equals is nearer: the same wherever the search begins.
  bool operator<(const NearChord & other) const
  {
    return square < other.square || (square == other.square && piece < other.piece);
  }
};

/// Look at all pieces; write the nearest ones and the distance of the others to the memory.
Index search_all(const double * pieces, Index count, Vector2 point, double * memory)
{
  using namespace nearby;  // NOLINT: columns of one array
  constexpr double INFINITE = std::numeric_limits<double>::infinity();
  // The nearest ones in order, and the next one behind them.
  NearChord nearest[CANDIDATES + 1];
  std::fill(nearest, nearest + CANDIDATES + 1, NearChord{INFINITE, 0});
  for (Index k = 0; k < count; ++k) {
    NearChord found = {square_to_chord(pieces + curve::COLUMNS * k, point), k};
    if (found < nearest[CANDIDATES]) {
      for (NearChord & each : nearest) {
        if (found < each) {
          std::swap(found, each);
        }
      }
    }
  }
  for (Index n = 0; n < CANDIDATES; ++n) {
    memory[PIECES + n] = static_cast<double>(nearest[n].piece);
  }
  memory[PLACE] = point.x;
  memory[PLACE + 1] = point.y;
  memory[BEYOND] = std::sqrt(nearest[CANDIDATES].square);
  return nearest[0].piece;
}

/// One of the pieces in the memory, which may be that of another curve or none.
Index known_piece(const double * memory, Index n, Index count)
{
  const double piece = memory[nearby::PIECES + n];
  return 0.0 <= piece && piece < static_cast<double>(count) ? static_cast<Index>(piece) : 0;
}

/// The piece whose chord is nearest; the nearest point is on it or a neighbour.
///
/// Sought among the nearest ones of the last full search. All other chords were at least `BEYOND`
/// away then, and have come nearer by no more than the point has moved since.
Index nearest_chord(const double * pieces, Index count, Vector2 point, double * memory)
{
  using namespace nearby;  // NOLINT: columns of one array
  const Vector2 moved_by = point - vector2(memory + PLACE);
  const double moved = std::sqrt(dot(moved_by, moved_by));
  // A NaN before the first search.
  if (moved < memory[BEYOND]) {
    const auto candidate = [&](Index n) {
        const Index k = known_piece(memory, n, count);
        return NearChord{square_to_chord(pieces + curve::COLUMNS * k, point), k};
      };
    NearChord nearest = candidate(0);
    for (Index n = 1; n < CANDIDATES; ++n) {
      const NearChord found = candidate(n);
      if (found < nearest) {
        nearest = found;
        std::swap(memory[PIECES], memory[PIECES + n]);
      }
    }
    if (std::sqrt(nearest.square) + moved < SURELY * memory[BEYOND]) {
      return nearest.piece;
    }
  }
  return search_all(pieces, count, point, memory);
}

inline Vector2 unit(Vector2 a)
{
  return a / std::sqrt(dot(a, a));
}
}  // namespace

Values pieces_of_curve(const EffectTable & table, Index row)
{
  return table.data.part(
    table.first_number[row], curve::COLUMNS * table.entries[row]);
}

namespace
{
CurveDistance find_distance(Values curve, Vector2 point, bool closed, double * memory)
{
  const double * pieces = curve.data;
  const Index count = curve.size / curve::COLUMNS;
  // The place on the piece that was nearest before, while it is found out which one is nearest now:
  // it seldom is another one.
  const Index guess = known_piece(memory, 0, count);
  Nearest nearest = nearest_on_piece(pieces + curve::COLUMNS * guess, point);
  const Index best = nearest_chord(pieces, count, point, memory);
  if (best != guess) {
    nearest = nearest_on_piece(pieces + curve::COLUMNS * best, point);
  }
  const bool straight = bulge(pieces + curve::COLUMNS * best) == 0.0;
  Index piece = best;
  for (Index neighbour : {best - 1, best + 1}) {
    const Index k = closed ? around(neighbour, count) : neighbour;
    if (k < 0 || k >= count) {
      continue;
    }
    const double * other = pieces + curve::COLUMNS * k;
    // A straight piece is its chord, and no nearer; the end that it shares with the other piece is
    // known.
    if ((straight && bulge(other) == 0.0) || is_nearest_at(neighbour > best, other, point)) {
      continue;
    }
    const Nearest found = nearest_on_piece(other, point);
    if (found.square < nearest.square) {
      nearest = found;
      piece = k;
    }
  }
  Vector2 tangent = nearest.tangent;
  // At a corner, the direction half way round it.
  Index beside = piece;
  if (nearest.u == 0.0) {
    beside = piece - 1;
  } else if (nearest.u == 1.0) {
    beside = piece + 1;
  }
  if (closed) {
    beside = around(beside, count);
  }
  if (beside != piece && 0 <= beside && beside < count) {
    const Vector2 other = evaluate(pieces + curve::COLUMNS * beside, 1.0 - nearest.u).tangent;
    tangent = unit(tangent) + unit(other);
  }
  const double distance = std::sqrt(nearest.square);
  if (distance > 0.0) {
    // An open curve has no solid side past its ends.
    const bool past = beside < 0 || beside >= count;
    const double side = past ? distance : std::copysign(distance, cross(tangent, nearest.apart));
    return {nearest.apart / side, side};
  }
  tangent = unit(tangent);
  return {{-tangent.y, tangent.x}, 0.0};
}
}  // namespace

CurveDistance distance_from_curve(Values curve, Vector2 point, bool closed, double * memory)
{
  double * last = memory + nearby::LAST;
  // Friction at rest has a state evaluated several times.
  if (!(memory[nearby::BEYOND] >= 0.0 && last[0] == point.x && last[1] == point.y)) {
    const CurveDistance found = find_distance(curve, point, closed, memory);
    last[0] = point.x;
    last[1] = point.y;
    last[2] = found.normal.x;
    last[3] = found.normal.y;
    last[4] = found.distance;
  }
  // Number by number: two that were written apart are not read at once without waiting.
  return {{last[2], last[3]}, last[4]};
}

Vector2 furthest_of_curve(Values pieces, Vector2 direction)
{
  double furthest = -std::numeric_limits<double>::infinity(), place = 0.0;
  const double * best = pieces.data;
  for (const double * c = pieces.data; c < pieces.data + pieces.size; c += curve::COLUMNS) {
    // The height of a piece is a cubic, which never leaves the span of its Bezier coefficients.
    double height[4];
    for (int k = 0; k < 4; ++k) {
      height[k] = direction.x * c[k] + direction.y * c[4 + k];
    }
    const double rise = height[1] / 3.0, second = height[0] + 2.0 * rise + height[2] / 3.0;
    const double last = height[0] + height[1] + height[2] + height[3];
    if (!(std::max({height[0], height[0] + rise, second, last}) > furthest)) {
      continue;
    }
    // The ends, and where the slope h1 + 2 h2 u + 3 h3 u^2 falls through zero.
    const double root =
      std::sqrt(std::max(0.0, height[2] * height[2] - 3.0 * height[1] * height[3]));
    const double top = height[2] > 0.0 ?
      -(height[2] + root) / (3.0 * height[3]) : height[1] / (root - height[2]);
    for (double u : {0.0, 1.0, top}) {
      const double found =
        height[0] + u * (height[1] + u * (height[2] + u * height[3]));
      if (0.0 <= u && u <= 1.0 && found > furthest) {
        furthest = found;
        best = c;
        place = u;
      }
    }
  }
  return evaluate(best, place).place;
}

ChordDistance nearest_to_chord(Values pieces, Vector2 start, Vector2 end)
{
  const Index count = pieces.size / curve::COLUMNS;
  const Vector2 path = end - start;
  const double square = dot(path, path);
  double least = std::numeric_limits<double>::infinity(), along = 0.5;
  double entry = 2.0, way_out = 2.0;
  for (Index k = 0; k < (square > 0.0 ? count : 0); ++k) {
    const double * piece = pieces.data + curve::COLUMNS * k;
    const Vector2 first = {piece[0], piece[4]}, whole = chord(piece);
    Vector2 apart = from_straight(start, first, whole);
    if (!(dot(apart, path) < 0.0)) {
      continue;
    }
    double level = std::sqrt(dot(apart, apart));
    apart = from_straight(end, first, whole);
    if (!(dot(apart, path) > 0.0)) {
      continue;
    }
    level = std::min(level, std::sqrt(dot(apart, apart))) - SHALLOW;
    // Sides of the path's line on which both ends of the piece are.
    const double one = cross(path, first - start);
    const double other = one + path.x * whole.y - path.y * whole.x;
    if (one * other < 0.0) {
      const double share = cross(first - start, whole) / cross(path, whole);
      if (0.0 < share && share < 1.0 && level > 0.0) {
        way_out = std::min(way_out, std::max(entry, share));
        entry = std::min(entry, share);
        continue;
      }
    }
    for (double u : {0.0, 1.0}) {
      const double share = within_piece(dot(first + u * whole - start, path) / square);
      // Curved pieces: how far they are from there.
      const double found = nearest_on_piece(piece, start + share * path).square;
      if (found < least * least && found < level * std::abs(level)) {
        least = std::sqrt(found);
        along = share;
      }
    }
  }
  if (entry <= 1.0) {
    least = -std::numeric_limits<double>::infinity();
    along = 0.5 * (entry + std::min(way_out, 1.0));
  }
  return {least, std::min(0.99, std::max(0.01, along))};
}

}  // namespace closedloop
