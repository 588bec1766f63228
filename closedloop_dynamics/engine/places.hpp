// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__PLACES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__PLACES_HPP_

#include "array.hpp"

// A number at each of several places, in the lanes of vector registers.

namespace closedloop
{

/// How many; as of the generated code for these.
constexpr Index PLACES = 4;

/// Numbers at all places, side by side in memory.
struct Lanes
{
  // Arrays begin at any number.
  typedef double Pair __attribute__((vector_size(16), aligned(8), may_alias));

  Pair low, high;

  static Lanes of(double value) {return {Pair{value, value}, Pair{value, value}};}
  static Lanes & at(const double * numbers)
  {
    return *reinterpret_cast<Lanes *>(const_cast<double *>(numbers));
  }
  double operator[](Index n) const {return n < 2 ? low[n] : high[n - 2];}
  double sum() const {return (low[0] + low[1]) + (high[0] + high[1]);}
  void operator+=(Lanes other) {low += other.low; high += other.high;}
  void operator-=(Lanes other) {low -= other.low; high -= other.high;}
  void operator*=(Lanes other) {low *= other.low; high *= other.high;}
};

inline Lanes operator+(Lanes a, Lanes b) {return {a.low + b.low, a.high + b.high};}
inline Lanes operator-(Lanes a, Lanes b) {return {a.low - b.low, a.high - b.high};}
inline Lanes operator-(Lanes a) {return {-a.low, -a.high};}
inline Lanes operator*(Lanes a, Lanes b) {return {a.low * b.low, a.high * b.high};}
inline Lanes operator*(double a, Lanes b) {return {a * b.low, a * b.high};}
inline Lanes operator/(double a, Lanes b) {return {a / b.low, a / b.high};}
inline Lanes size_of(Lanes a)
{
  // Without the bits of the signs.
  typedef long long Bits __attribute__((vector_size(16)));
  const Bits rest = ~Bits(Lanes::Pair{-0.0, -0.0});
  return {Lanes::Pair(Bits(a.low) & rest), Lanes::Pair(Bits(a.high) & rest)};
}
/// The larger ones; where the first one is not a number, that.
inline Lanes larger(Lanes a, Lanes b)
{
  return {a.low < b.low ? b.low : a.low, a.high < b.high ? b.high : a.high};
}
inline Lanes smaller(Lanes a, Lanes b)
{
  return {a.low < b.low ? a.low : b.low, a.high < b.high ? a.high : b.high};
}
inline double largest(Lanes a)
{
  const double low = a.low[0] > a.low[1] ? a.low[0] : a.low[1];
  const double high = a.high[0] > a.high[1] ? a.high[0] : a.high[1];
  return low > high ? low : high;
}

using LaneValues = Vector<Lanes>;
using LaneTable = Matrix<Lanes>;

/// The numbers of all places, place by place within each.
inline Values numbers(LaneValues lanes)
{
  return {reinterpret_cast<double *>(lanes.data), PLACES * lanes.size};
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__PLACES_HPP_
