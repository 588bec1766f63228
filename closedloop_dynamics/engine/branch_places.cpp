// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch_places.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "loop_closure.hpp"
#include "lu.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
// Places on the branch, in units of the distance between them, in the order in which they are
// looked for. Of a quantity whose slope along the branch is known there, too, four places are worth
// eight.
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
// Corrections that bring a place onto the branch: the first one from a line takes the most.
constexpr Index MOST_CORRECTIONS = 6;
// Closure error, against the size of the mechanism, that counts as on the branch.
constexpr double SETTLED = 1e-11;
// Smallest pivot at the first place, against the largest: below the first value the places are
// taken farther away, at most so many times as far, below the second none serves.
constexpr double ENOUGH = 2e-3, LEAST = 1e-4, FARTHEST = 8.0;
// How much smaller a pivot may be at another place: this one is next to a singular position, too.
constexpr double SMALLER = 0.05;
// How far the state may be from the branch, against the distance to the first place; its rates,
// against the largest; and how far both polynomials may disagree, against the largest acceleration.
constexpr double BESIDE = 0.1, OTHER_RATE = 0.01, APART = 1e-6;
// Pivots at the state, against the largest, below which an equation is not worth its multiplier:
// the rounding of positions on the branch is as large.
constexpr double VANISHED = 1e-7;
// Numbers and counts that find room on the stack.
constexpr Index NUMBERS = 2048, COUNTS = 64;

/// Arrays that live as long as an evaluation, out of one block.
template<class Number, Index ROOM>
class Scratch
{
public:
  explicit Scratch(Index count)
  {
    if (count > ROOM) {
      large_ = std::make_unique<Number[]>(static_cast<std::size_t>(count));
      next_ = large_.get();
    }
  }
  Vector<Number> take(Index count)
  {
    next_ += count;
    return {next_ - count, count};
  }
  Matrix<Number> take(Index rows, Index columns)
  {
    return {take(rows * columns).data, rows, columns};
  }

private:
  std::array<Number, ROOM> numbers_;
  std::unique_ptr<Number[]> large_;
  Number * next_ = numbers_.data();
};

/// Factor a matrix in place, rows and columns exchanged so that each pivot is the largest number
/// that is left; `row` and `column` tell where each came from. Return how many pivots exceed a
/// share of the first one; the others are left.
Index factorize_fully(Table matrix, Indices row, Indices column, double share)
{
  const Index rows = matrix.rows, columns = matrix.columns;
  for (Index i = 0; i < rows; ++i) {
    row[i] = i;
  }
  for (Index j = 0; j < columns; ++j) {
    column[j] = j;
  }
  double first = 0.0;
  for (Index k = 0; k < rows; ++k) {
    Index at = k, to = k;
    double most = -1.0;
    for (Index i = k; i < rows; ++i) {
      for (Index j = k; j < columns; ++j) {
        if (std::abs(matrix(i, j)) > most) {
          most = std::abs(matrix(i, j));
          at = i;
          to = j;
        }
      }
    }
    first = k == 0 ? most : first;
    if (!(most > share * first)) {
      return k;
    }
    if (at != k) {
      std::swap_ranges(matrix.row(k), matrix.row(k) + columns, matrix.row(at));
      std::swap(row[k], row[at]);
    }
    if (to != k) {
      for (Index i = 0; i < rows; ++i) {
        std::swap(matrix(i, k), matrix(i, to));
      }
      std::swap(column[k], column[to]);
    }
    const double inverse = 1.0 / matrix(k, k);
    for (Index i = k + 1; i < rows; ++i) {
      const double scale = matrix(i, k) * inverse;
      matrix(i, k) = scale;
      for (Index j = k + 1; j < columns; ++j) {
        matrix(i, j) -= scale * matrix(k, j);
      }
    }
  }
  return rows;
}

/// Lower triangle of the products of rows, of so many columns, with one another.
template<class Entry>
void fill_products(Table out, Entry && entry, Index columns)
{
  for (Index k = 0; k < out.rows; ++k) {
    for (Index m = 0; m <= k; ++m) {
      out(k, m) = 0.0;
      for (Index j = 0; j < columns; ++j) {
        out(k, m) += entry(k, j) * entry(m, j);
      }
    }
  }
}

/// Factor a symmetric positive definite matrix in place, lower triangle; false where it is not.
bool factorize_positive(Table matrix)
{
  for (Index i = 0; i < matrix.rows; ++i) {
    for (Index j = 0; j <= i; ++j) {
      double total = matrix(i, j);
      for (Index k = 0; k < j; ++k) {
        total -= matrix(i, k) * matrix(j, k);
      }
      if (i == j && !(total > 0.0)) {
        return false;
      }
      matrix(i, j) = i == j ? std::sqrt(total) : total / matrix(j, j);
    }
  }
  return true;
}

/// Solve with these factors in place.
void solve_positive(Table factor, Values right)
{
  const Index n = factor.rows;
  for (Index i = 0; i < n; ++i) {
    for (Index k = 0; k < i; ++k) {
      right[i] -= factor(i, k) * right[k];
    }
    right[i] /= factor(i, i);
  }
  for (Index i = n - 1; i >= 0; --i) {
    right[i] /= factor(i, i);
    for (Index k = 0; k < i; ++k) {
      right[k] -= factor(i, k) * right[i];
    }
  }
}

/// The branch through a state on which some coordinates, the independent ones, go on evenly, and
/// the closure equations decide the others. Its parameter counts places.
class Branch
{
public:
  Branch(const System & system, Values q, Values qd, Table added)
  : system_(system), model_(system.model), work_(system.work), q_(q), qd_(qd), added_(added),
    nv_(qd.size), nc_(system.lam.size), free_(nv_ - nc_),
    scratch_(room(q.size)), jac_(scratch_.take(nc_, nv_)), factor_(scratch_.take(nc_, nv_)),
    row_scale_(scratch_.take(nc_)), column_scale_(scratch_.take(nv_)),
    right_(scratch_.take(nc_)), change_(scratch_.take(nv_)),
    places_(scratch_.take(MOST_PLACES, q.size)), rates_(scratch_.take(MOST_PLACES, nv_)),
    bends_(scratch_.take(MOST_PLACES, nv_)), tangents_(scratch_.take(free_, nv_)),
    tangents_of_fewer_(scratch_.take(free_, nv_)), near_(scratch_.take(q.size)),
    rate_(scratch_.take(nv_)), bend_(scratch_.take(nv_)), other_(scratch_.take(nv_)),
    gim_(scratch_.take(nv_, nv_)), carried_(scratch_.take(free_, nv_)),
    inertia_(scratch_.take(free_, free_)), push_(scratch_.take(free_)),
    counts_(2 * nv_ + nc_), order_(counts_.take(nv_)), column_(counts_.take(nv_)),
    row_(counts_.take(nc_))
  {
  }

  /// As `accelerate_by_places`.
  bool accelerate(double speed)
  {
    return find_first(speed) && find_others() && meet_state() && move_there();
  }

private:
  Index room(Index nq) const
  {
    return nc_ * nv_ * 2 + 2 * nc_ + 2 * nv_ + MOST_PLACES * (nq + 2 * nv_) + 3 * free_ * nv_ +
           nq + 3 * nv_ + nv_ * nv_ + free_ * (free_ + 1);
  }

  Index dependent(Index k) const {return order_[k];}
  Index independent(Index k) const {return order_[nc_ + k];}
  Table square() const {return {factor_.data, nc_, nc_};}

  /// Closure errors, J and what the rates add to accelerations of closure, at a place.
  void look(Values q, Values rates)
  {
    outward(model_, q, rates, work_);
    update(model_, work_, Responses::NONE);
    constraint_jacobian(model_, work_, jac_);
  }

  /// Factor the columns of J of the dependent coordinates; return the ratio of its pivots.
  double factor()
  {
    const Table matrix = square();
    for (Index i = 0; i < nc_; ++i) {
      for (Index k = 0; k < nc_; ++k) {
        matrix(i, k) = jac_(i, dependent(k)) * row_scale_[i] * column_scale_[dependent(k)];
      }
    }
    return factorize(matrix, row_);
  }

  /// Changes of the dependent coordinates that change the closure equations by `right_`.
  void solve_dependent(Values out)
  {
    for (Index i = 0; i < nc_; ++i) {
      right_[i] *= row_scale_[i];
    }
    solve(square(), row_, right_);
    for (Index k = 0; k < nc_; ++k) {
      out[dependent(k)] = right_[k] * column_scale_[dependent(k)];
    }
  }

  /// Choose the coordinates that the closure equations decide best at a place; return their
  /// smallest pivot against the largest, 0 where there are too few.
  double choose()
  {
    scales(model_, jac_, row_scale_, column_scale_);
    for (Index i = 0; i < nc_; ++i) {
      for (Index j = 0; j < nv_; ++j) {
        factor_(i, j) = jac_(i, j) * row_scale_[i] * column_scale_[j];
      }
    }
    if (factorize_fully(factor_, row_, order_, LEAST) < nc_) {
      return 0.0;
    }
    const double ratio = nc_ > 0 ? std::abs(factor_(nc_ - 1, nc_ - 1) / factor_(0, 0)) : 1.0;
    // A quaternion goes on evenly as a whole, or not at all.
    for (Index k = 0; k < nv_; ++k) {
      column_[order_[k]] = k < nc_ ? 1 : 0;
    }
    for (Index i = 1; i < model_.tree.rows; ++i) {
      const Index first = model_.tree(i, tree::DOF) - 2;
      if (model_.tree(i, tree::TYPE) == tree::BALL && model_.tree(i, tree::AXIS) == 2 &&
        (column_[first] != column_[first + 1] || column_[first] != column_[first + 2]))
      {
        return 0.0;
      }
    }
    // Independent coordinates that no equation knows need no looking after.
    moving_ = 0;
    for (Index k = 0; k < free_; ++k) {
      const Index j = independent(k);
      double most = 0.0;
      for (Index i = 0; i < nc_; ++i) {
        most = std::max(most, std::abs(jac_(i, j)) * row_scale_[i] * column_scale_[j]);
      }
      if (most > ROUNDING) {
        std::swap(order_[nc_ + k], order_[nc_ + moving_]);
        ++moving_;
      }
    }
    return ratio;
  }

  /// Bring a place onto the branch, in place; return whether it is there, with J.
  bool settle(Values q)
  {
    const double size = system_.settings[setting::SIZE];
    double before = 0.0;
    for (Index count = 0; ; ++count) {
      look(q, rate_);
      const double error = largest(work_.closure);
      const bool settled = error <= SETTLED * size, shrinks = count == 0 || error < 0.5 * before;
      if (error <= ROUNDING * size || !shrinks || count == MOST_CORRECTIONS) {
        return settled;
      }
      before = error;
      factor();
      to_user_order(model_, work_.closure, right_);
      for (double & each : right_) {
        each = -each;
      }
      change_.fill(0.0);
      solve_dependent(change_);
      move(system_.manifold, q, change_, 1.0);
    }
  }

  /// Settle a place; keep it, the rates along the branch, how they change, and the tangents.
  bool keep(Index n)
  {
    const Values q = places_[n], rates = rates_[n], bends = bends_[n];
    for (Index k = 0; k < free_; ++k) {
      rate_[independent(k)] = rates[independent(k)] = step_ * qd_[independent(k)];
      bends[independent(k)] = 0.0;
    }
    if (!settle(q)) {
      return false;
    }
    const double pivot = factor();
    if (n == 0) {
      pivot_ = pivot;
    } else if (!(pivot >= SMALLER * pivot_)) {
      return false;
    }
    for (Index i = 0; i < nc_; ++i) {
      right_[i] = 0.0;
      for (Index k = 0; k < moving_; ++k) {
        right_[i] -= jac_(i, independent(k)) * rates[independent(k)];
      }
    }
    solve_dependent(rates);
    if (moving_ > 1) {
      add_tangents(n);
    }
    outward(model_, q, rates, work_);
    update(model_, work_, Responses::NONE);
    to_user_order(model_, work_.bias, right_);
    for (double & each : right_) {
      each = -each;
    }
    solve_dependent(bends);
    return true;
  }

  /// Add what a place tells of the changes of all coordinates with each independent one.
  void add_tangents(Index n)
  {
    for (Index k = 0; k < moving_; ++k) {
      for (Index i = 0; i < nc_; ++i) {
        right_[i] = -jac_(i, independent(k));
      }
      solve_dependent(change_);
      for (Index m = 0; m < nc_; ++m) {
        const Index j = dependent(m);
        tangents_(k, j) += VALUE[n] * change_[j];
        tangents_of_fewer_(k, j) += FEWER_VALUES[n] * change_[j];
      }
    }
  }

  /// Find the first place, far enough from the state that the equations are independent there.
  bool find_first(double speed)
  {
    const double aside = system_.settings[setting::ASIDE] / speed;
    double farther = 1.0;
    for (int attempt = 0; ; ++attempt) {
      step_ = farther * aside;
      copy(q_, places_[0]);
      move(system_.manifold, places_[0], qd_, step_);
      copy(qd_, rate_);
      look(places_[0], rate_);
      const double pivot = choose();
      if (pivot == 0.0 || (attempt > 0 && pivot < LEAST)) {
        return false;
      }
      if (pivot >= ENOUGH || attempt > 0) {
        break;
      }
      farther = std::min(FARTHEST, 1.5 * ENOUGH / pivot);
    }
    if (moving_ == 0 || (moving_ == 1 && qd_[independent(0)] == 0.0)) {
      return false;
    }
    if (moving_ == 1) {
      step_ *= SLOPED_ASIDE;
      copy(q_, places_[0]);
      move(system_.manifold, places_[0], qd_, step_);
    }
    for (Index j = 0; j < nv_; ++j) {
      rate_[j] = step_ * qd_[j];
    }
    tangents_.fill(0.0);
    tangents_of_fewer_.fill(0.0);
    return keep(0);
  }

  /// Find the other places, each from two that are known.
  bool find_others()
  {
    count_ = moving_ == 1 ? SLOPED_PLACES : MOST_PLACES;
    for (Index n = 1; n < count_; ++n) {
      const Values q = places_[n];
      if (n == 1) {
        copy(q_, q);
        for (Index j = 0; j < nv_; ++j) {
          change_[j] = 0.5 * bends_(0, j) - step_ * qd_[j];
        }
        for (Index k = 0; k < nc_; ++k) {
          rate_[dependent(k)] = rates_(0, dependent(k)) - 2.0 * bends_(0, dependent(k));
        }
      } else {
        predict(n, n < 4 ? 3 - n : n - 4, n - 2);
      }
      move(system_.manifold, q, change_, 1.0);
      if (!keep(n)) {
        return false;
      }
    }
    return true;
  }

  /// Go on from a place by the cubic that has the rates of this and of another one.
  void predict(Index n, Index other, Index from)
  {
    const double width = PLACES[from] - PLACES[other], s = (PLACES[n] - PLACES[from]) / width;
    copy(places_[from], places_[n]);
    const double s2 = s * s, s3 = s2 * s, s4 = s2 * s2;
    // Integrals of Hermite's polynomials in s, from 0 at `from` to s; -1 is the other place.
    const double value = s - s3 - 0.5 * s4, slope = 0.5 * s2 + 2.0 / 3.0 * s3 + 0.25 * s4;
    const double other_value = s3 + 0.5 * s4, other_slope = s3 / 3.0 + 0.25 * s4;
    for (Index j = 0; j < nv_; ++j) {
      change_[j] = width * (
        value * rates_(from, j) + other_value * rates_(other, j) +
        width * (slope * bends_(from, j) + other_slope * bends_(other, j)));
      rate_[j] = rates_(from, j);
    }
    for (Index k = 0; k < free_; ++k) {
      const Index j = independent(k);
      change_[j] = (PLACES[n] - PLACES[from]) * step_ * qd_[j];
    }
  }

  /// Largest of the dependent coordinates, as lengths.
  double most(Values values) const
  {
    double found = 0.0;
    for (Index k = 0; k < nc_; ++k) {
      found = std::max(found, std::abs(values[dependent(k)]) / column_scale_[dependent(k)]);
    }
    return found;
  }

  /// Position, rates and what they change by on the branch at the state; false where that is not
  /// on the branch, or where what the places say does not agree.
  bool meet_state()
  {
    const bool sloped = count_ == SLOPED_PLACES;
    const bool whole = system_.manifold.empty();
    double fastest = 0.0, sharpest = 0.0;
    copy(q_, near_);
    copy(qd_, rate_);
    bend_.fill(0.0);
    for (Index k = 0; k < nc_; ++k) {
      const Index j = dependent(k);
      double place = 0.0, rate = 0.0, bend = 0.0, fewer = 0.0;
      for (Index n = 0; n < count_; ++n) {
        const double along = rates_(n, j), across = bends_(n, j);
        if (sloped) {
          place += SLOPE_FOR_VALUE[n] * along;
          rate += VALUE_BY_SLOPES[n] * along + SLOPE_FOR_VALUE[n] * across;
          bend += VALUE_FOR_SLOPE[n] * along + SLOPE_BY_VALUES[n] * across;
          fewer += FEWER_FOR_SLOPE[n] * along + FEWER_SLOPES[n] * across;
        } else {
          rate += VALUE[n] * along;
          bend += VALUE[n] * across;
          fewer += FEWER_VALUES[n] * across;
        }
        if (whole) {
          place += (sloped ? VALUE_BY_SLOPES[n] : VALUE[n]) * (places_(n, j) - q_[j]);
        }
        fastest = std::max(fastest, std::abs(along) / column_scale_[j]);
        sharpest = std::max(sharpest, std::abs(across) / column_scale_[j]);
      }
      near_[j] = q_[j] + (whole ? place : 0.0);
      rate_[j] = rate / step_;
      bend_[j] = bend / (step_ * step_);
      change_[j] = whole ? place : 0.0;
      other_[j] = fewer - bend;
    }
    sharpest = std::max(sharpest, fastest * fastest * smallest_scale());
    if (!(most(change_) <= BESIDE * fastest && most(other_) <= APART * sharpest)) {
      return false;
    }
    for (Index k = 0; k < nc_; ++k) {
      const Index j = dependent(k);
      other_[j] = step_ * (rate_[j] - qd_[j]);
    }
    if (!(most(other_) <= OTHER_RATE * fastest)) {
      return false;
    }
    return finish_tangents();
  }

  double smallest_scale() const
  {
    double found = column_scale_[0];
    for (double each : column_scale_) {
      found = std::min(found, each);
    }
    return found;
  }

  /// What all coordinates change by with each independent one, at the state.
  bool finish_tangents()
  {
    for (Index k = 0; k < free_; ++k) {
      const Values tangent = tangents_[k];
      if (k == 0 && moving_ == 1) {
        for (Index m = 0; m < nc_; ++m) {
          tangent[dependent(m)] = rate_[dependent(m)] / qd_[independent(0)];
        }
      }
      if (moving_ > 1) {
        for (Index m = 0; m < nc_; ++m) {
          other_[dependent(m)] = tangent[dependent(m)] - tangents_of_fewer_(k, dependent(m));
        }
        if (!(most(other_) <= APART * (most(tangent) + 1.0 / column_scale_[independent(k)]))) {
          return false;
        }
      }
      tangent[independent(k)] = 1.0;
    }
    return true;
  }

  /// Equations of motion along the tangents, then the multipliers.
  bool move_there()
  {
    outward(model_, near_, rate_, work_);
    for (Index i = 0; i < added_.rows; ++i) {
      for (Index n = 0; n < added_.columns; ++n) {
        work_.body(i, work_.first_force() + n) += added_(i, n);
      }
    }
    generalized_inertia_matrix(model_, work_, gim_);
    tree_torque(model_, work_, bend_, other_);
    for (Index i = 0; i < nv_; ++i) {
      other_[i] -= system_.applied[i];
    }
    for (Index k = 0; k < free_; ++k) {
      push_[k] = 0.0;
      for (Index i = 0; i < nv_; ++i) {
        double total = 0.0;
        for (Index j = 0; j < nv_; ++j) {
          total += gim_(i, j) * tangents_(k, j);
        }
        carried_(k, i) = total;
        push_[k] -= tangents_(k, i) * other_[i];
      }
      for (Index m = 0; m <= k; ++m) {
        double total = 0.0;
        for (Index i = 0; i < nv_; ++i) {
          total += tangents_(m, i) * carried_(k, i);
        }
        inertia_(k, m) = total;
      }
    }
    if (!factorize_positive(inertia_)) {
      return false;
    }
    solve_positive(inertia_, push_);
    for (Index i = 0; i < nv_; ++i) {
      for (Index k = 0; k < free_; ++k) {
        bend_[i] += push_[k] * tangents_(k, i);
        other_[i] += push_[k] * carried_(k, i);
      }
    }
    copy(bend_, system_.qdd);
    find_multipliers();
    return true;
  }

  /// The multipliers that give the joint forces in `other_`; where an equation vanishes the least.
  void find_multipliers()
  {
    constraint_jacobian(model_, work_, jac_);
    scales(model_, jac_, row_scale_, column_scale_);
    for (Index i = 0; i < nc_; ++i) {
      for (Index j = 0; j < nv_; ++j) {
        factor_(i, j) = jac_(i, j) * row_scale_[i] * column_scale_[j];
      }
    }
    const Index rank = factorize_fully(factor_, row_, column_, VANISHED);
    work_.health[health::RANK] = static_cast<double>(rank);
    const Values & lam = system_.lam, & share = right_;
    const auto needed = [&](Index k) {return other_[column_[k]] * column_scale_[column_[k]];};
    if (rank == nc_) {
      for (Index k = 0; k < nc_; ++k) {
        share[k] = needed(k);
        for (Index i = 0; i < k; ++i) {
          share[k] -= factor_(i, k) * share[i];
        }
        share[k] /= factor_(k, k);
      }
      for (Index k = nc_ - 1; k >= 0; --k) {
        for (Index i = k + 1; i < nc_; ++i) {
          share[k] -= factor_(i, k) * share[i];
        }
        lam[row_[k]] = share[k] * row_scale_[row_[k]];
      }
      return;
    }
    // Least squares, then the least solution: the factors are of full rank.
    const auto upper = [&](Index k, Index j) {return j >= k ? factor_(k, j) : 0.0;};
    const auto lower = [&](Index i, Index k) {
        return (i == k ? 1.0 : i > k ? factor_(i, k) : 0.0) / row_scale_[row_[i]];
      };
    const Table square{gim_.data, rank, rank};
    for (Index k = 0; k < rank; ++k) {
      share[k] = 0.0;
      for (Index j = k; j < nv_; ++j) {
        share[k] += upper(k, j) * needed(j);
      }
    }
    fill_products(square, upper, nv_);
    factorize_positive(square);
    solve_positive(square, share.part(0, rank));
    fill_products(square, [&](Index k, Index i) {return lower(i, k);}, nc_);
    factorize_positive(square);
    solve_positive(square, share.part(0, rank));
    for (Index i = 0; i < nc_; ++i) {
      double total = 0.0;
      for (Index k = 0; k < rank; ++k) {
        total += lower(i, k) * share[k];
      }
      lam[row_[i]] = total;
    }
  }

  const System & system_;
  const Model & model_;
  const Workspace & work_;
  const Values q_, qd_;
  const Table added_;
  const Index nv_, nc_, free_;
  Scratch<double, NUMBERS> scratch_;
  const Table jac_, factor_;
  const Values row_scale_, column_scale_, right_, change_;
  const Table places_, rates_, bends_, tangents_, tangents_of_fewer_;
  const Values near_, rate_, bend_, other_;
  const Table gim_, carried_, inertia_;
  const Values push_;
  Scratch<Index, COUNTS> counts_;
  // Dependent coordinates, then independent ones, those that an equation knows first.
  const Indices order_, column_, row_;
  double step_ = 0.0, pivot_ = 0.0;
  Index moving_ = 0, count_ = 0;
};
}  // namespace

bool accelerate_by_places(const System & system, Values q, Values qd, Table added)
{
  const double speed = fastest_turn(system.work);
  const bool driven = system.has_effects() && system.effects.motions.rows > 0;
  if (!(speed > 0.0) || driven || system.lam.size >= qd.size) {
    return false;
  }
  return Branch(system, q, qd, added).accelerate(speed);
}

}  // namespace closedloop
