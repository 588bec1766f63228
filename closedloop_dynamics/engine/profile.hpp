// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__PROFILE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__PROFILE_HPP_

#include "effect_table.hpp"

// Functions of the time: chains of segments, each a polynomial and a sine,
//
//     y(t) = c0 + u (c1 + ... u c5) + a sin(w u + p),     u = t - (start of the segment),
//
// and expressions, as operations on a stack. The first two states of an effect with such a chain
// are the time and the number of the present segment, counted on through all periods.

namespace closedloop
{

/// Times closer than this, relative to their size, are the same.
constexpr double SAME_TIME = 1e-12;

namespace profile
{
/// Numbers of a segment: its start [s], c0 to c5, a, w, p.
constexpr Index COLUMNS = 10;
}

/// The present segment of a profile, and when its period began [s].
struct PresentPiece
{
  const double * segment;
  double period_start;
};

/// The present segment of an effect's profile, by its states; `period` [s]: zero if not periodic.
PresentPiece present_piece(const EffectTable &, Index row, double period);

/// Number of a segment from the state that counts them: whole but for the differences that stiff
/// methods take.
Index segment_number(double state);

/// When a segment of a profile ends [s]; infinity where it is the last one.
double end_of_segment(const EffectTable &, Index row, double period, Index segment);

/// Value at a time of the expression whose entry begins at a place of the data, with the room for its
/// stack.
double expression_value(Values data, Index at, double time);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__PROFILE_HPP_
