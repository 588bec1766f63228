// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch_places.hpp"

#include <algorithm>
#include <cmath>

#include "manifold.hpp"
#include "scratch.hpp"

namespace closedloop
{

namespace
{
// Places on the branch, in units of the distance between them, in the order of evaluation. With
// slopes along the branch, four places interpolate as well as eight.
constexpr Index MOST_PLACES = 8, SLOPED_PLACES = 4;
constexpr double PLACES[MOST_PLACES] = {1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 4.0, -4.0};
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
constexpr Index NUMBERS = 1024;

/// The branch through a state. In each component of the mechanism the independent coordinates are
/// linear functions of the parameter, and the closure equations determine the others. The parameter
/// numbers the places.
class Branch
{
public:
  Branch(BranchEquations & equations, Values q, Values qd, const BranchPoint & point)
  : equations_(equations), system_(equations.system), q_(q), qd_(qd), point_(point),
    scratch_(
      MOST_PLACES * (q.size + 2 * qd.size) + qd.size * qd.size + 3 * qd.size),
    places_(scratch_.take(MOST_PLACES, q.size)), rates_(scratch_.take(MOST_PLACES, qd.size)),
    bends_(scratch_.take(MOST_PLACES, qd.size)),
    tangents_of_fewer_(scratch_.take(qd.size, qd.size)), change_(scratch_.take(qd.size)),
    other_(scratch_.take(qd.size)), slower_(scratch_.take(qd.size))
  {
  }

  /// Interpolate a component's position, rates, accelerations and tangents at the state.
  bool interpolate(Component & part)
  {
    return find_first(part) && find_others(part) && interpolate_state(part) &&
           finish_tangents(part);
  }

private:
  /// Put a place where the rates lead to, with these rates.
  void go_straight(const Component & part, Index n)
  {
    const Values rates = rates_[n];
    rates.fill(0.0);
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = equations_.column(part, k);
      rates[j] = step_ * qd_[j];
    }
    copy(q_, places_[n]);
    move(system_.manifold, places_[n], rates, n == 0 ? 1.0 : -1.0);
  }

  /// Find the first place, far enough from the state that the equations are independent there.
  bool find_first(Component & part)
  {
    double fastest = 0.0, longest = 0.0;
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = equations_.column(part, k);
      fastest = std::max(fastest, std::abs(qd_[j]) / equations_.column_scale[j]);
      longest = std::max(longest, 1.0 / equations_.column_scale[j]);
    }
    // As if the longest lever turned.
    const double aside = system_.settings->aside;
    step_ = SLOPED_ASIDE * aside * longest / fastest;
    if (!(step_ < SLOPED_ASIDE * RESTING * aside)) {
      return false;
    }
    for (int attempt = 0; ; ++attempt) {
      go_straight(part, 0);
      equations_.evaluate(places_[0], rates_[0]);
      // Pivots that are not rounding are in one order at the state and here.
      const bool chosen = (attempt == 0 && part.pivot > 0.0) ||
        equations_.choose(part, LEAST) > 0.0;
      const double pivot = chosen && equations_.settle(part, places_[0], rates_[0]) ?
        equations_.smallest_pivot(part) : 0.0;
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
      go_straight(part, 0);
      equations_.evaluate(places_[0], rates_[0]);
      for (Index k = 0; k < part.moving; ++k) {
        tangents_of_fewer_[equations_.independent(part, k)].fill(0.0);
      }
      if (!equations_.settle(part, places_[0], rates_[0])) {
        return false;
      }
    }
    return keep(part, 0) && equations_.is_isolated(part);
  }

  /// Find the other places, each extrapolated from two.
  bool find_others(const Component & part)
  {
    count_ = part.moving == 1 ? SLOPED_PLACES : MOST_PLACES;
    for (Index n = 1; n < count_; ++n) {
      if (n == 1) {
        go_straight(part, n);
        // The cubic curve with the rates at the state and the first place, and its bends.
        change_.fill(0.0);
        for (Index k = 0; k < part.rows; ++k) {
          const Index j = equations_.column(part, k);
          change_[j] =
            4.0 / 3.0 * (rates_(0, j) - step_ * qd_[j]) - 5.0 / 6.0 * bends_(0, j);
        }
      } else {
        predict(part, n, n < 4 ? 3 - n : n - 4, n - 2);
      }
      move(system_.manifold, places_[n], change_, 1.0);
      equations_.evaluate(places_[n], rates_[n]);
      if (!(equations_.settle(part, places_[n], rates_[n]) && keep(part, n))) {
        return false;
      }
    }
    return true;
  }

  /// Store a settled place with rates and accelerations along the branch, and the tangents.
  bool keep(const Component & part, Index n)
  {
    const double pivot = equations_.smallest_pivot(part);
    if (n == 0) {
      pivot_ = pivot;
    }
    if (!(pivot >= SMALLER * pivot_)) {
      return false;
    }
    bends_[n].fill(0.0);
    if (part.moving > 1) {
      equations_.add_tangents(part, point_.tangent, VALUE[n]);
      equations_.add_tangents(part, tangents_of_fewer_, FEWER_VALUES[n]);
    }
    equations_.follow(part, places_[n], rates_[n], bends_[n]);
    return true;
  }

  /// Extrapolate from a place by Hermite interpolation of the rates there and at another one.
  void predict(const Component & part, Index n, Index other, Index from)
  {
    const double width = PLACES[from] - PLACES[other], s = (PLACES[n] - PLACES[from]) / width;
    const double s2 = s * s, s3 = s2 * s, s4 = s2 * s2;
    // Integrals of Hermite's polynomials in s, from 0 at `from` to s; -1 is the other place.
    const double value = s - s3 - 0.5 * s4, slope = 0.5 * s2 + 2.0 / 3.0 * s3 + 0.25 * s4;
    const double other_value = s3 + 0.5 * s4, other_slope = s3 / 3.0 + 0.25 * s4;
    copy(places_[from], places_[n]);
    copy(rates_[from], rates_[n]);
    change_.fill(0.0);
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = equations_.column(part, k);
      change_[j] = width * (
        value * rates_(from, j) + other_value * rates_(other, j) +
        width * (slope * bends_(from, j) + other_slope * bends_(other, j)));
    }
    for (Index k = 0; k < part.columns - part.rows; ++k) {
      const Index j = equations_.independent(part, k);
      change_[j] = (PLACES[n] - PLACES[from]) * rates_(from, j);
    }
  }

  /// Largest of the kinematically determined coordinates, as lengths.
  double most(const Component & part, Values values) const
  {
    double found = 0.0;
    for (Index k = 0; k < part.rows; ++k) {
      const double size = std::abs(values[equations_.column(part, k)]) / equations_.column_scale[equations_.column(part, k)];
      found = size <= found ? found : size;
    }
    return found;
  }

  /// Interpolate position, rates and accelerations at the state; false where the state is not on
  /// the branch, or where the polynomials disagree.
  bool interpolate_state(const Component & part)
  {
    const bool sloped = count_ == SLOPED_PLACES, whole = system_.manifold.empty();
    double fastest = 0.0, sharpest = 0.0, longest = 0.0;
    for (Index k = 0; k < part.rows; ++k) {
      const Index j = equations_.column(part, k);
      const double lever = 1.0 / equations_.column_scale[j];
      double place = 0.0, rate = 0.0, second = 0.0, fewer = 0.0, steep = 0.0, sharp = 0.0;
      for (Index n = 0; n < count_; ++n) {
        const double along = rates_(n, j), across = bends_(n, j);
        const double value = sloped ? VALUE_BY_SLOPES[n] : VALUE[n];
        const double slope = sloped ? SLOPE_FOR_VALUE[n] : 0.0;
        place += whole ? value * (places_(n, j) - q_[j]) + slope * along : 0.0;
        rate += value * along + slope * across;
        second += sloped ? VALUE_FOR_SLOPE[n] * along + SLOPE_BY_VALUES[n] * across :
          value * across;
        fewer += sloped ? FEWER_FOR_SLOPE[n] * along + FEWER_SLOPES[n] * across :
          FEWER_VALUES[n] * across;
        steep = std::max(steep, std::abs(along));
        sharp = std::max(sharp, std::abs(across));
      }
      fastest = std::max(fastest, lever * steep);
      sharpest = std::max(sharpest, lever * sharp);
      longest = std::max(longest, lever);
      point_.q[j] += place;
      point_.rate[j] = rate / step_;
      point_.path_acceleration[j] = second / (step_ * step_);
      change_[j] = place;
      other_[j] = fewer - second;
      slower_[j] = rate - step_ * qd_[j];
    }
    return most(part, change_) <= BESIDE * fastest && most(part, slower_) <= OTHER_RATE * fastest &&
           most(part, other_) <= APART * std::max(sharpest, fastest * fastest / longest);
  }

  /// Complete the derivatives of the dependent coordinates by the independent ones, at the state.
  bool finish_tangents(const Component & part)
  {
    if (part.moving == 1) {
      const Index j = equations_.independent(part, 0);
      for (Index m = 0; m < part.rows; ++m) {
        point_.tangent(j, equations_.column(part, m)) = point_.rate[equations_.column(part, m)] / qd_[j];
      }
      return true;
    }
    for (Index k = 0; k < part.moving; ++k) {
      const Index j = equations_.independent(part, k);
      const Values tangent = point_.tangent[j], fewer = tangents_of_fewer_[j];
      for (Index m = 0; m < part.rows; ++m) {
        fewer[equations_.column(part, m)] -= tangent[equations_.column(part, m)];
      }
      if (!(most(part, fewer) <= APART * (most(part, tangent) + 1.0 / equations_.column_scale[j]))) {
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
  const Table places_, rates_, bends_, tangents_of_fewer_;
  const Values change_, other_, slower_;
  double step_ = 0.0, pivot_ = 0.0;
  Index count_ = 0;
};
}  // namespace

bool interpolate(
  BranchEquations & equations, Component & part, Values q, Values qd, const BranchPoint & point)
{
  return Branch(equations, q, qd, point).interpolate(part);
}

}  // namespace closedloop
