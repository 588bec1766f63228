// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch_places.hpp"

#include <algorithm>
#include <cmath>

#include "scratch.hpp"

namespace closedloop
{

namespace
{
// Places on the branch, in units of the distance between them, side by side; the second ones are
// extrapolated from the first. With slopes along the branch, four places interpolate as well as
// eight.
constexpr Index MOST_PLACES = 2 * PLACES, SLOPED_PLACES = PLACES;
constexpr double NEAREST_PLACES[PLACES] = {1.0, -1.0, 2.0, -2.0};
// Weights of a quantity's values at them, by which a polynomial gives it at the state; and of the
// slopes, which are of opposite sign behind. Errors are of the eighth power of the distance.
constexpr double VALUE[MOST_PLACES] = {
  0.8, 0.8, -0.4, -0.4, 4.0 / 35.0, 4.0 / 35.0, -1.0 / 70.0, -1.0 / 70.0};
constexpr double VALUE_BY_SLOPES[SLOPED_PLACES] = {
  8.0 / 27.0, 8.0 / 27.0, 11.0 / 54.0, 11.0 / 54.0};
constexpr double SLOPE_FOR_VALUE[SLOPED_PLACES] = {
  -4.0 / 9.0, 4.0 / 9.0, -1.0 / 18.0, 1.0 / 18.0};
constexpr double VALUE_FOR_SLOPE[SLOPED_PLACES] = {
  20.0 / 27.0, -20.0 / 27.0, 25.0 / 216.0, -25.0 / 216.0};
constexpr double SLOPE_BY_VALUES[SLOPED_PLACES] = {
  -4.0 / 9.0, -4.0 / 9.0, -1.0 / 36.0, -1.0 / 36.0};
// The same of errors of two powers less, for comparison.
constexpr double FEWER_VALUES[MOST_PLACES] = {0.75, 0.75, -0.3, -0.3, 0.05, 0.05, 0.0, 0.0};
constexpr double FEWER_FOR_SLOPE[SLOPED_PLACES] = {45.0 / 57.0, -45.0 / 57.0, 0.0, 0.0};
constexpr double FEWER_SLOPES[SLOPED_PLACES] = {
  -17.0 / 57.0, -17.0 / 57.0, 0.5 / 57.0, 0.5 / 57.0};
// Distance of the places that are four, against that of eight.
constexpr double SLOPED_ASIDE = 1.5;
// Smallest pivot at the first place, against the largest: below the first value the places are
// moved farther away, by at most the third; below the second the method fails.
constexpr double ENOUGH = 2e-3, LEAST = 1e-4, FARTHEST = 8.0;
// How much smaller a pivot may be at another place: this one is next to a singular position, too.
constexpr double SMALLER = 0.05;
// How far the state may be from the branch, against the distance to the first place; its rates,
// against the largest; and how far both polynomials may disagree, against the largest acceleration.
constexpr double BESIDE = 0.1, OTHER_RATE = 0.01, APART = 1e-6;
// A component is at rest if it needs longer than this to turn by a radian [s].
constexpr double RESTING = 1e6;
// Numbers that fit on the stack.
constexpr Index NUMBERS = 2048;

/// The branch through a state. In each component of the mechanism the independent coordinates are
/// linear functions of the parameter, and the closure equations determine the others. The parameter
/// numbers the places.
class Branch
{
public:
  Branch(BranchEquations & equations, Values q, Values qd, const BranchPoint & point)
  : equations_(equations), system_(equations.system), q_(q), qd_(qd), point_(point),
    scratch_(
      PLACES * (2 * q.size + 5 * qd.size) + qd.size * qd.size + 3 * qd.size),
    change_(take(qd.size)), tangents_of_fewer_(scratch_.take(qd.size, qd.size)),
    moved_(scratch_.take(qd.size)), other_(scratch_.take(qd.size)), slower_(scratch_.take(qd.size))
  {
    for (Places & each : places_) {
      each = {take(q.size), take(qd.size), take(qd.size)};
    }
  }

  /// Interpolate a component's position, rates, accelerations and tangents at the state.
  bool interpolate(Component & part)
  {
    return find_first(part) && find_others(part) &&
           (part.moving == 1 ? interpolate_state<true>(part) : interpolate_state<false>(part)) &&
           finish_tangents(part);
  }

private:
  /// Positions, rates and accelerations at places side by side.
  struct Places {LaneValues q, rates, bends;};

  LaneValues take(Index count)
  {
    return {&Lanes::at(scratch_.take(PLACES * count).data), count};
  }

  /// Put the first places where the rates lead to, with these rates, and evaluate the equations.
  void go_straight(const Component & part)
  {
    const Places & at = places_[0];
    if (part.columns < qd_.size) {
      at.rates.fill(Lanes::of(0.0));
      change_.fill(Lanes::of(0.0));
    }
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = equations_.column(part, k);
      at.rates[j] = Lanes::of(step_ * qd_[j]);
      change_[j] = at.rates[j] * Lanes::at(NEAREST_PLACES);
    }
    for (Index i = 0; i < q_.size; ++i) {
      at.q[i] = Lanes::of(q_[i]);
    }
    equations_.shift(at.q, change_);
    equations_.evaluate(at.q, at.rates);
  }

  /// Find the first places, far enough from the state that the equations are independent there.
  bool find_first(Component & part)
  {
    double fastest = 0.0, longest = 0.0;
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = equations_.column(part, k);
      const double lever = equations_.lever[j];
      fastest = std::max(fastest, std::abs(qd_[j]) * lever);
      longest = std::max(longest, lever);
    }
    // As if the longest lever turned.
    const double aside = system_.settings->aside;
    step_ = SLOPED_ASIDE * aside * longest / fastest;
    if (!(step_ < SLOPED_ASIDE * RESTING * aside)) {
      return false;
    }
    for (int attempt = 0; ; ++attempt) {
      go_straight(part);
      // Pivots that are not rounding are in one order at the state and here.
      const bool chosen = (attempt == 0 && part.pivot > 0.0) ||
        equations_.choose(part, LEAST) > 0.0;
      const double pivot = chosen && settle(part, 0) ? pivots_[0] : 0.0;
      if (pivot >= ENOUGH || (pivot >= LEAST && attempt > 0)) {
        break;
      }
      if (attempt > 0) {
        return false;
      }
      step_ *= pivot > 0.0 ? std::min(FARTHEST, 1.5 * ENOUGH / pivot) : FARTHEST;
    }
    if (!equations_.keeps_quaternions_whole(part)) {
      return false;
    }
    equations_.count_moving(part);
    if (part.moving == 0 ||
      (part.moving == 1 && qd_[equations_.independent(part, 0)] == 0.0))
    {
      return false;
    }
    if (part.moving > 1) {
      step_ /= SLOPED_ASIDE;
      go_straight(part);
      for (Index k = 0; k < part.moving; ++k) {
        tangents_of_fewer_[equations_.independent(part, k)].fill(0.0);
      }
      if (!settle(part, 0)) {
        return false;
      }
    }
    return keep(part, 0) && equations_.is_isolated(part);
  }

  /// Find the other places, each extrapolated from two.
  bool find_others(const Component & part)
  {
    if (part.moving == 1) {
      return true;
    }
    predict(part);
    const Places & at = places_[1];
    equations_.evaluate(at.q, at.rates);
    return settle(part, 1) && keep(part, 1);
  }

  /// Bring places onto the branch, from their evaluation; return whether they are there.
  bool settle(const Component & part, Index n)
  {
    if (!equations_.settle(part, places_[n].q, places_[n].rates)) {
      return false;
    }
    pivots_ = equations_.smallest_pivot(part);
    return true;
  }

  /// Store settled places with rates and accelerations along the branch, and the tangents.
  bool keep(const Component & part, Index n)
  {
    pivot_ = n == 0 ? pivots_[0] : pivot_;
    for (Index lane = 0; lane < PLACES; ++lane) {
      if (!(pivots_[lane] >= SMALLER * pivot_)) {
        return false;
      }
    }
    const Places & at = places_[n];
    if (part.moving > 1) {
      equations_.add_tangents(part, point_.tangent, Lanes::at(VALUE + PLACES * n));
      equations_.add_tangents(part, tangents_of_fewer_, Lanes::at(FEWER_VALUES + PLACES * n));
    }
    equations_.follow(part, at.q, at.rates, at.bends);
    return true;
  }

  /// Extrapolate from the two places on each side by Hermite interpolation of the rates there, to
  /// one and two distances beyond.
  void predict(const Component & part)
  {
    // Integrals of Hermite's polynomials from the farther place on; and the way there.
    constexpr double VALUE_HERE[] = {-0.5, -0.5, -14.0, -14.0};
    constexpr double VALUE_BEFORE[] = {1.5, 1.5, 16.0, 16.0};
    constexpr double SLOPE_HERE[] = {17.0 / 12.0, 17.0 / 12.0, 34.0 / 3.0, 34.0 / 3.0};
    constexpr double SLOPE_BEFORE[] = {7.0 / 12.0, 7.0 / 12.0, 20.0 / 3.0, 20.0 / 3.0};
    constexpr double SIDE[] = {1.0, -1.0, 1.0, -1.0}, WAY[] = {1.0, -1.0, 2.0, -2.0};
    const Places & from = places_[0], & to = places_[1];
    const auto farther = [](Lanes each) {return Lanes{each.high, each.high};};
    const auto nearer = [](Lanes each) {return Lanes{each.low, each.low};};
    for (Index i = 0; i < q_.size; ++i) {
      to.q[i] = farther(from.q[i]);
    }
    change_.fill(Lanes::of(0.0));
    for (Index j = 0; j < qd_.size; ++j) {
      to.rates[j] = farther(from.rates[j]);
    }
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = equations_.column(part, k);
      change_[j] = k >= part.rows ? Lanes::at(WAY) * to.rates[j] : Lanes::at(SIDE) * (
        Lanes::at(VALUE_HERE) * to.rates[j] +
        Lanes::at(VALUE_BEFORE) * nearer(from.rates[j])) +
        Lanes::at(SLOPE_HERE) * farther(from.bends[j]) +
        Lanes::at(SLOPE_BEFORE) * nearer(from.bends[j]);
    }
    equations_.shift(to.q, change_);
  }

  /// Largest of the kinematically determined coordinates, as lengths.
  double most(const Component & part, Values values) const
  {
    double found = 0.0;
    for (Index k = 0; k < part.rows; ++k) {
      const Index j = equations_.column(part, k);
      const double size = std::abs(values[j]) * equations_.lever[j];
      found = size <= found ? found : size;
    }
    return found;
  }

  /// Interpolate position, rates and accelerations at the state; false where the state is not on
  /// the branch, or where the polynomials disagree.
  template<bool SLOPED>
  bool interpolate_state(const Component & part)
  {
    const bool whole = system_.manifold.empty();
    const double frequency = 1.0 / step_;
    double fastest = 0.0, sharpest = 0.0, longest = 0.0;
    for (Index k = 0; k < part.rows; ++k) {
      const Index j = equations_.column(part, k);
      const double lever = equations_.lever[j];
      Lanes place = Lanes::of(0.0), rate = place, second = place, fewer = place;
      Lanes steep = place, sharp = place;
      for (Index n = 0; n < (SLOPED ? 1 : 2); ++n) {
        const Lanes along = places_[n].rates[j], across = places_[n].bends[j];
        const Lanes value = Lanes::at(SLOPED ? VALUE_BY_SLOPES : VALUE + PLACES * n);
        if (whole) {
          place += value * (places_[n].q[j] - Lanes::of(q_[j]));
        }
        rate += value * along;
        if constexpr (SLOPED) {
          const Lanes slope = Lanes::at(SLOPE_FOR_VALUE);
          if (whole) {
            place += slope * along;
          }
          rate += slope * across;
          second += Lanes::at(VALUE_FOR_SLOPE) * along + Lanes::at(SLOPE_BY_VALUES) * across;
          fewer += Lanes::at(FEWER_FOR_SLOPE) * along + Lanes::at(FEWER_SLOPES) * across;
        } else {
          second += value * across;
          fewer += Lanes::at(FEWER_VALUES + PLACES * n) * across;
        }
        steep = larger(size_of(along), steep);
        sharp = larger(size_of(across), sharp);
      }
      fastest = std::max(fastest, lever * largest(steep));
      sharpest = std::max(sharpest, lever * largest(sharp));
      longest = std::max(longest, lever);
      moved_[j] = place.sum();
      other_[j] = (fewer - second).sum();
      slower_[j] = rate.sum() - step_ * qd_[j];
      point_.q[j] += moved_[j];
      point_.rate[j] = frequency * rate.sum();
      point_.path_acceleration[j] = frequency * frequency * second.sum();
    }
    return most(part, moved_) <= BESIDE * fastest && most(part, slower_) <= OTHER_RATE * fastest &&
           most(part, other_) <= APART * std::max(sharpest, fastest * fastest / longest);
  }

  /// Complete the derivatives of the dependent coordinates by the independent ones, at the state.
  bool finish_tangents(const Component & part)
  {
    if (part.moving == 1) {
      const Index j = equations_.independent(part, 0);
      for (Index m = 0; m < part.rows; ++m) {
        const Index dependent = equations_.column(part, m);
        point_.tangent(j, dependent) = point_.rate[dependent] / qd_[j];
      }
      return true;
    }
    for (Index k = 0; k < part.moving; ++k) {
      const Index j = equations_.independent(part, k);
      const Values tangent = point_.tangent[j], fewer = tangents_of_fewer_[j];
      for (Index m = 0; m < part.rows; ++m) {
        fewer[equations_.column(part, m)] -= tangent[equations_.column(part, m)];
      }
      if (!(most(part, fewer) <= APART * (most(part, tangent) + equations_.lever[j]))) {
        return false;
      }
    }
    return true;
  }

  BranchEquations & equations_;
  const System & system_;
  const Values q_, qd_;
  const BranchPoint & point_;
  Scratch<double, NUMBERS> scratch_;
  const LaneValues change_;
  const Table tangents_of_fewer_;
  const Values moved_, other_, slower_;
  Places places_[2];
  double step_ = 0.0, pivot_ = 0.0;
  Lanes pivots_;  // Smallest ones at the places that were settled last
};
}  // namespace

bool interpolate(
  BranchEquations & equations, Component & part, Values q, Values qd, const BranchPoint & point)
{
  return Branch(equations, q, qd, point).interpolate(part);
}

}  // namespace closedloop
