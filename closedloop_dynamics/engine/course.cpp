// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "course.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace closedloop
{

namespace
{
// More pieces than any run passes.
constexpr double MOST_PIECES = 1e15;

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

/// Time since the present piece of a course began [s].
double since(const EffectTable & table, Index row, const PresentPiece & present)
{
  return table.states[table.index(row, effect::STATE)] - present.period_start - present.piece[0];
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

Index piece_number(double state)
{
  // Of a state that has diverged any piece will do: its time has, too.
  return std::fabs(state) < MOST_PIECES ? static_cast<Index>(std::floor(state + 0.5)) : 0;
}

PresentPiece present_piece(const EffectTable & table, Index row, double period)
{
  const Index state = table.index(row, effect::STATE), count = table.index(row, effect::ENTRIES);
  Index number = piece_number(table.states[state + 1]), cycle = 0;
  if (period > 0.0) {
    cycle = floor_divide(number, count);
  } else {
    // A state that has diverged must not read beyond the pieces.
    number = std::max<Index>(0, std::min(number, count - 1));
  }
  const Index at = table.index(row, effect::DATA) + course::COLUMNS * (number - cycle * count);
  return {table.data.data + at, period > 0.0 ? cycle * period : 0.0};
}

double course_value(const EffectTable & table, Index row, double period)
{
  const PresentPiece present = present_piece(table, row, period);
  const double * c = present.piece;
  const double u = since(table, row, present);
  double y = c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * (c[5] + u * c[6]))));
  if (c[7] != 0.0) {
    y += c[7] * std::sin(c[8] * u + c[9]);
  }
  return y;
}

CourseDerivatives course_derivatives(const EffectTable & table, Index row, double period)
{
  const PresentPiece present = present_piece(table, row, period);
  const double * c = present.piece;
  const double u = since(table, row, present);
  const double fourth = c[5], fifth = c[6];
  double rate = c[2] + u * (2.0 * c[3] + 3.0 * u * c[4]);
  double change = 2.0 * c[3] + 6.0 * u * c[4];
  if (fourth != 0.0 || fifth != 0.0) {
    rate += u * u * u * (4.0 * fourth + 5.0 * u * fifth);
    change += u * u * (12.0 * fourth + 20.0 * u * fifth);
  }
  if (c[7] != 0.0) {
    const double turning = c[8], angle = c[8] * u + c[9];
    rate += c[7] * turning * std::cos(angle);
    change -= c[7] * turning * turning * std::sin(angle);
  }
  return {rate, change};
}

double end_of_piece(const EffectTable & table, Index row, double period, Index piece)
{
  const Index count = table.index(row, effect::ENTRIES), following = piece + 1;
  Index cycle = 0;
  if (period > 0.0) {
    cycle = floor_divide(following, count);
  } else if (following >= count) {
    return std::numeric_limits<double>::infinity();
  }
  const Index at = table.index(row, effect::DATA) + course::COLUMNS * (following - cycle * count);
  return table.data[at] + cycle * period;
}

double expression_value(const EffectTable & table, Index at, double time)
{
  const Values & data = table.data;
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
