// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "profile.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace closedloop
{

namespace
{
// More segments than any run passes.
constexpr double MOST_SEGMENTS = 1e15;

// Operations of an expression: a number, the time, of one number, of two numbers; those of
// effects/expression.py.
enum Operation : Index
{
  NUMBER, TIME, NEG, ABS, SIN, COS, TAN, ASIN, ACOS, ATAN, SQRT, EXP, LOG, RADIANS, DEGREES,
  ADD, SUB, MUL, DIV, POW, ATAN2, HYPOT, MIN, MAX
};

/// Quotient of whole numbers, the divisor positive, rounded down.
Index floor_divide(Index number, Index divisor)
{
  const Index quotient = number / divisor;
  return number % divisor < 0 ? quotient - 1 : quotient;
}

double of_one(Index operation, double x)
{
  switch (operation) {
    case NEG: return -x;
    case ABS: return std::fabs(x);
    case SIN: return std::sin(x);
    case COS: return std::cos(x);
    case TAN: return std::tan(x);
    case ASIN: return std::asin(x);
    case ACOS: return std::acos(x);
    case ATAN: return std::atan(x);
    case SQRT: return std::sqrt(x);
    case EXP: return std::exp(x);
    case LOG: return std::log(x);
    case RADIANS: return x * (M_PI / 180.0);
    case DEGREES: return x * (180.0 / M_PI);
    default: return x;
  }
}

double of_two(Index operation, double x, double y)
{
  switch (operation) {
    case ADD: return x + y;
    case SUB: return x - y;
    case MUL: return x * y;
    case DIV: return x / y;
    case POW: return std::pow(x, y);
    case ATAN2: return std::atan2(x, y);
    case HYPOT: return std::hypot(x, y);
    case MIN: return std::min(x, y);
    case MAX: return std::max(x, y);
    default: return x;
  }
}
}  // namespace

Index segment_number(double state)
{
  // Any segment will do for a state that has diverged: its time has, too.
  return std::fabs(state) < MOST_SEGMENTS ? static_cast<Index>(std::floor(state + 0.5)) : 0;
}

PresentPiece present_piece(const EffectTable & table, Index row, double period)
{
  const Index state = table.first_state[row], count = table.entries[row];
  Index number = segment_number(table.states[state + 1]), cycle = 0;
  if (period > 0.0) {
    cycle = floor_divide(number, count);
  } else {
    // A state that has diverged must not read beyond the segments.
    number = std::max<Index>(0, std::min(number, count - 1));
  }
  const Index at = table.first_number[row] + profile::COLUMNS * (number - cycle * count);
  return {table.data.data + at, period > 0.0 ? cycle * period : 0.0};
}

double end_of_segment(const EffectTable & table, Index row, double period, Index segment)
{
  const Index count = table.entries[row], following = segment + 1;
  Index cycle = 0;
  if (period > 0.0) {
    cycle = floor_divide(following, count);
  } else if (following >= count) {
    return std::numeric_limits<double>::infinity();
  }
  const Index at = table.first_number[row] + profile::COLUMNS * (following - cycle * count);
  return table.data[at] + cycle * period;
}

double expression_value(Values data, Index at, double time)
{
  const Index count = static_cast<Index>(data[at]);
  Index top = at + 2 * count;
  for (Index k = 0; k < count; ++k) {
    const Index operation = static_cast<Index>(data[at + 1 + 2 * k]);
    if (operation <= TIME) {
      top += 1;
      data[top] = operation == TIME ? time : data[at + 2 + 2 * k];
    } else if (operation >= ADD) {
      top -= 1;
      data[top] = of_two(operation, data[top], data[top + 1]);
    } else {
      data[top] = of_one(operation, data[top]);
    }
  }
  return data[top];
}

}  // namespace closedloop
