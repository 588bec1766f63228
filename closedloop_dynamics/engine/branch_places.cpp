// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "branch_places.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "loop_closure.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "recursion.hpp"
#include "routines.hpp"
#include "scratch.hpp"
#include "small_factors.hpp"

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
// Corrections per place; the first place, extrapolated along a line, needs the most.
constexpr Index MOST_CORRECTIONS = 6;
// Closure error, against the size of the mechanism, that counts as on the branch.
constexpr double SETTLED = 1e-11;
// Smallest pivot at the first place, against the largest: below the first value the places are
// moved farther away, by at most the third; below the second the method fails.
constexpr double ENOUGH = 2e-3, LEAST = 1e-4, FARTHEST = 8.0;
// How much smaller a pivot may be at another place: this one is next to a singular position, too.
constexpr double SMALLER = 0.05;
// How far the state may be from the branch, against the distance to the first place; its rates,
// against the largest; and how far both polynomials may disagree, against the largest acceleration.
constexpr double BESIDE = 0.1, OTHER_RATE = 0.01, APART = 1e-6;
// Pivots at the state, against the largest, below which an equation is not worth its multiplier:
// the rounding of positions on the branch is as large.
constexpr double VANISHED = 1e-7;
// Smallest pivot of equations that are evaluated at the state only.
constexpr double REGULAR = 0.02;
// Entries of the scaled J up to this are zero, but for the closure error of a stage.
constexpr double FOREIGN = 1e-6;
// A component is at rest if it needs longer than this to turn by a radian [s].
constexpr double RESTING = 1e6;
// Numbers, counts and components that fit on the stack.
constexpr Index NUMBERS = 2048, COUNTS = 64, MOST_PARTS = 8;

/// Equations that share coordinates, as ranges of the lists of a Branch. The coordinates: first the
/// dependent ones, as many as there are equations, then the independent ones that occur in the
/// equations, then the others.
struct Component
{
  Index row = 0, rows = 0, column = 0, columns = 0;
  Index moving = 0;  ///< Number of independent coordinates in the equations
  bool regular = false;  ///< Whether the equations are independent at the state itself
};

/// The branch through a state. In each component of the mechanism the independent coordinates are
/// linear functions of the parameter, and the closure equations determine the others. The parameter
/// numbers the places.
class Branch
{
public:
  Branch(const System & system, Values q, Values qd, Table added)
  : system_(system), model_(system.model), work_(system.work), q_(q), qd_(qd), added_(added),
    nv_(qd.size), nc_(system.lam.size), free_(nv_ - nc_),
    scratch_(
      2 * nc_ * nv_ + 5 * nc_ + 6 * nv_ + MOST_PLACES * (q.size + 2 * nv_) + 3 * nv_ * nv_ +
      q.size + free_ * (nv_ + free_ + 1)),
    jac_(scratch_.take(nc_, nv_)), factor_(scratch_.take(nc_, nv_)),
    closure_(scratch_.take(nc_)), bias_(scratch_.take(nc_)), row_scale_(scratch_.take(nc_)),
    right_(scratch_.take(nc_)), ordered_(scratch_.take(nc_)),
    column_scale_(scratch_.take(nv_)), change_(scratch_.take(nv_)),
    places_(scratch_.take(MOST_PLACES, q.size)), rates_(scratch_.take(MOST_PLACES, nv_)),
    bends_(scratch_.take(MOST_PLACES, nv_)), tangents_(scratch_.take(nv_, nv_)),
    tangents_of_fewer_(scratch_.take(nv_, nv_)), near_(scratch_.take(q.size)),
    rate_(scratch_.take(nv_)), bend_(scratch_.take(nv_)), other_(scratch_.take(nv_)),
    force_(scratch_.take(nv_)), gim_(scratch_.take(nv_, nv_)),
    carried_(scratch_.take(free_, nv_)), inertia_(scratch_.take(free_, free_)),
    push_(scratch_.take(free_)), counts_(4 * nv_ + 2 * nc_), order_(counts_.take(nv_)),
    root_(counts_.take(nv_)), column_(counts_.take(nv_)), free_column_(counts_.take(nv_)),
    row_(counts_.take(nc_)), pivot_row_(counts_.take(nc_)), parts_(nc_),
    components_(parts_.take(nc_))
  {
    std::copy(system.table.begin(), system.table.end(), table_.begin());
    table_[routine::CLOSURE] = reinterpret_cast<Index>(closure_.data);
    table_[routine::BIAS] = reinterpret_cast<Index>(bias_.data);
    table_[routine::JACOBIAN] = reinterpret_cast<Index>(jac_.data);
  }

  /// As `accelerate_by_places`.
  bool accelerate()
  {
    copy(q_, near_);
    copy(qd_, rate_);
    bend_.fill(0.0);
    tangents_.fill(0.0);
    evaluate_equations(q_, qd_);
    scales(model_, jac_, row_scale_, column_scale_);
    if (!find_components()) {
      return false;
    }
    bool regular = true;
    for (Component & part : components_) {
      // A single component is singular, or this function is not called.
      part.regular = components_.size > 1 && choose(part, REGULAR) > 0.0;
      regular = regular && part.regular;
    }
    for (const Component & part : components_) {
      if (!part.regular && !interpolate(part)) {
        return false;
      }
    }
    return !regular && move_there();
  }

private:
  static Index find(Indices root, Index j)
  {
    while (root[j] != j) {
      j = root[j] = root[root[j]];
    }
    return j;
  }
  double entry(Index i, Index j) const {return jac_(i, j) * row_scale_[i] * column_scale_[j];}
  Index row(const Component & part, Index i) const {return row_[part.row + i];}
  Index column(const Component & part, Index k) const {return order_[part.column + k];}
  Index independent(const Component & part, Index k) const {return column(part, part.rows + k);}

  /// Group equations and coordinates: the equations of a cut joint, and all coordinates in them,
  /// form one group. False where an equation has no coordinate.
  bool find_components()
  {
    const Indexes & cut = model_.cut;
    for (Index j = 0; j < nv_; ++j) {
      root_[j] = j;
    }
    for (Index a = 0; a < cut.rows; ++a) {
      Index group = -1;
      for (Index i = cut(a, cut::CUT_ROW); i < cut(a, cut::CUT_ROW) + cut(a, cut::ROWS); ++i) {
        for (Index j = 0; j < nv_; ++j) {
          if (std::abs(entry(i, j)) > FOREIGN) {
            group = group < 0 ? find(root_, j) : group;
            root_[find(root_, j)] = group;
          }
        }
        pivot_row_[i] = group;
      }
      for (Index i = cut(a, cut::CUT_ROW); i < cut(a, cut::CUT_ROW) + cut(a, cut::ROWS); ++i) {
        if (group < 0) {
          return false;
        }
        pivot_row_[i] = group;
      }
    }
    Index rows = 0, columns = 0, count = 0;
    for (Index first = 0; first < nv_ && rows < nc_; ++first) {
      if (find(root_, first) != first) {
        continue;
      }
      Component part;
      part.row = rows;
      part.column = columns;
      for (Index i = 0; i < nc_; ++i) {
        if (find(root_, pivot_row_[i]) == first) {
          row_[rows++] = i;
        }
      }
      part.rows = rows - part.row;
      if (part.rows == 0) {
        continue;
      }
      for (Index j = 0; j < nv_; ++j) {
        if (find(root_, j) == first) {
          order_[columns++] = j;
        }
      }
      part.columns = columns - part.column;
      components_[count++] = part;
      if (part.columns < part.rows) {
        return false;
      }
    }
    components_.size = count;
    return true;
  }

  /// Evaluate closure errors, J and constraint bias at a place.
  void evaluate_equations(Values q, Values rates)
  {
    if (table_[routine::LOOP_EQUATIONS] != 0) {
      call({table_.data(), routine::TABLE_COLUMNS}, routine::LOOP_EQUATIONS, q, rates);
      return;
    }
    outward(model_, q, rates, work_);
    constraint_jacobian(model_, work_, jac_);
    to_user_order(model_, work_.closure, closure_);
    to_user_order(model_, work_.bias, bias_);
  }

  /// Choose the coordinates that the closure equations decide best at a place; return their
  /// smallest pivot against the largest, 0 where it is less than a share.
  double choose(Component & part, double share)
  {
    const Table matrix{factor_.data, part.rows, part.columns};
    for (Index i = 0; i < part.rows; ++i) {
      for (Index k = 0; k < part.columns; ++k) {
        matrix(i, k) = entry(row(part, i), column(part, k));
      }
    }
    const Indices columns = column_.part(0, part.columns), rows = pivot_row_.part(0, part.rows);
    const Indices order{order_.data + part.column, part.columns};
    const bool enough = factorize_fully(matrix, rows, columns, share) == part.rows;
    for (Index & each : columns) {
      each = order[each];
    }
    std::copy(columns.begin(), columns.end(), order.begin());
    for (Index & each : rows) {
      each = row_[part.row + each];
    }
    std::copy(rows.begin(), rows.end(), row_.data + part.row);
    if (!enough || !keeps_quaternions_whole(part)) {
      return 0.0;
    }
    part.moving = 0;
    for (Index k = 0; k < part.columns - part.rows; ++k) {
      const Index j = independent(part, k);
      double most = 0.0;
      for (Index i = 0; i < part.rows; ++i) {
        most = std::max(most, std::abs(entry(row(part, i), j)));
      }
      if (most > ROUNDING) {
        std::swap(order[part.rows + k], order[part.rows + part.moving]);
        ++part.moving;
      }
    }
    return std::abs(matrix(part.rows - 1, part.rows - 1) / matrix(0, 0));
  }

  /// Whether the rates of each quaternion are all dependent, or all independent.
  bool keeps_quaternions_whole(const Component & part)
  {
    column_.fill(0);
    for (Index k = 0; k < part.rows; ++k) {
      column_[column(part, k)] = 1;
    }
    for (Index i = 1; i < model_.tree.rows; ++i) {
      if (model_.tree(i, tree::TYPE) == tree::BALL) {
        const Index last = model_.tree(i, tree::DOF), first = last - model_.tree(i, tree::AXIS);
        if (column_[first] != column_[last]) {
          return false;
        }
      }
    }
    return true;
  }

  /// Factor the equations' derivatives by the dependent coordinates; return the smallest pivot
  /// against the largest.
  double factor(const Component & part)
  {
    const Table matrix = square(part);
    for (Index i = 0; i < part.rows; ++i) {
      const double * from = jac_.row(row(part, i));
      const double scale = row_scale_[row(part, i)];
      for (Index k = 0; k < part.rows; ++k) {
        matrix(i, k) = from[column(part, k)] * scale * column_scale_[column(part, k)];
      }
    }
    return factorize_in_place(matrix);
  }
  Table square(const Component & part) const {return {factor_.data, part.rows, part.rows};}

  /// Changes of the decided coordinates that change the equations by `right_`, in user order.
  void solve_decided(const Component & part, Values out)
  {
    const Values local = ordered_.part(0, part.rows);
    for (Index i = 0; i < part.rows; ++i) {
      local[i] = right_[row(part, i)] * row_scale_[row(part, i)];
    }
    solve_in_place(square(part), local);
    for (Index k = 0; k < part.rows; ++k) {
      out[column(part, k)] = local[k] * column_scale_[column(part, k)];
    }
  }

  /// Bring a place onto the branch, in place; return whether it is there, with J.
  bool settle(const Component & part, Values q)
  {
    const double size = system_.settings[setting::SIZE];
    double before = 0.0;
    for (Index count = 0; ; ++count) {
      evaluate_equations(q, rate_);
      double error = 0.0;
      for (Index i = 0; i < part.rows; ++i) {
        const double each = closure_[row(part, i)];
        error = std::abs(each) <= error ? error : std::abs(each);
        right_[row(part, i)] = -each;
      }
      const bool shrinks = count == 0 || error < 0.5 * before;
      if (error <= ROUNDING * size || !shrinks || count == MOST_CORRECTIONS) {
        return error <= SETTLED * size;
      }
      before = error;
      factor(part);
      change_.fill(0.0);
      solve_decided(part, change_);
      move(system_.manifold, q, change_, 1.0);
    }
  }

  /// Whether no coordinate of another component occurs in the equations.
  bool is_isolated(const Component & part)
  {
    column_.fill(0);
    for (Index k = 0; k < part.columns; ++k) {
      column_[column(part, k)] = 1;
    }
    for (Index i = 0; i < part.rows; ++i) {
      for (Index j = 0; j < nv_; ++j) {
        if (column_[j] == 0 && std::abs(entry(row(part, i), j)) > FOREIGN) {
          return false;
        }
      }
    }
    return true;
  }

  /// Correct a place; store it with rates and accelerations along the branch, and the tangents.
  bool keep(const Component & part, Index n)
  {
    const Values q = places_[n], rates = rates_[n], bends = bends_[n];
    if (!settle(part, q)) {
      return false;
    }
    const double pivot = factor(part);
    if (n == 0) {
      pivot_ = pivot;
    }
    if (!(pivot >= SMALLER * pivot_) || (n == 0 && !is_isolated(part))) {
      return false;
    }
    rates.fill(0.0);
    bends.fill(0.0);
    for (Index k = 0; k < part.columns - part.rows; ++k) {
      const Index j = independent(part, k);
      rates[j] = step_ * qd_[j];
    }
    for (Index i = 0; i < part.rows; ++i) {
      double & total = right_[row(part, i)];
      total = 0.0;
      for (Index k = 0; k < part.moving; ++k) {
        total -= jac_(row(part, i), independent(part, k)) * rates[independent(part, k)];
      }
    }
    solve_decided(part, rates);
    if (part.moving > 1) {
      add_tangents(part, tangents_, VALUE[n]);
      add_tangents(part, tangents_of_fewer_, FEWER_VALUES[n]);
    }
    evaluate_equations(q, rates);
    negate_bias();
    solve_decided(part, bends);
    return true;
  }

  void negate_bias()
  {
    for (Index i = 0; i < nc_; ++i) {
      right_[i] = -bias_[i];
    }
  }

  /// Add a share of the derivatives of the dependent coordinates by the independent ones.
  void add_tangents(const Component & part, Table out, double share)
  {
    for (Index k = 0; k < part.moving && share != 0.0; ++k) {
      const Index j = independent(part, k);
      for (Index i = 0; i < part.rows; ++i) {
        right_[row(part, i)] = -jac_(row(part, i), j);
      }
      solve_decided(part, change_);
      for (Index m = 0; m < part.rows; ++m) {
        out(j, column(part, m)) += share * change_[column(part, m)];
      }
    }
  }

  /// Interpolate a component's position, rates, accelerations and tangents at the state.
  bool interpolate(Component part)
  {
    return find_first(part) && find_others(part) && interpolate_state(part) &&
           finish_tangents(part);
  }

  /// Put a place where the rates lead to.
  void go_straight(const Component & part, Index n)
  {
    change_.fill(0.0);
    for (Index k = 0; k < part.columns; ++k) {
      change_[column(part, k)] = qd_[column(part, k)];
    }
    copy(q_, places_[n]);
    move(system_.manifold, places_[n], change_, step_);
  }

  /// Find the first place, far enough from the state that the equations are independent there.
  bool find_first(Component & part)
  {
    double fastest = 0.0, longest = 0.0;
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = column(part, k);
      fastest = std::max(fastest, std::abs(qd_[j]) / column_scale_[j]);
      longest = std::max(longest, 1.0 / column_scale_[j]);
    }
    // As if the longest lever turned.
    step_ = system_.settings[setting::ASIDE] * longest / fastest;
    if (!(step_ < RESTING * system_.settings[setting::ASIDE])) {
      return false;
    }
    for (int attempt = 0; ; ++attempt) {
      go_straight(part, 0);
      evaluate_equations(places_[0], qd_);
      const double pivot = choose(part, LEAST);
      if (pivot >= ENOUGH || (pivot > 0.0 && attempt > 0)) {
        break;
      }
      if (attempt > 0) {
        return false;
      }
      step_ *= pivot > 0.0 ? std::min(FARTHEST, 1.5 * ENOUGH / pivot) : FARTHEST;
    }
    if (part.moving == 0 || (part.moving == 1 && qd_[independent(part, 0)] == 0.0)) {
      return false;
    }
    if (part.moving == 1) {
      step_ *= SLOPED_ASIDE;
      go_straight(part, 0);
    } else {
      for (Index k = 0; k < part.moving; ++k) {
        tangents_of_fewer_[independent(part, k)].fill(0.0);
      }
    }
    return keep(part, 0);
  }

  /// Find the other places, each extrapolated from two.
  bool find_others(const Component & part)
  {
    count_ = part.moving == 1 ? SLOPED_PLACES : MOST_PLACES;
    for (Index n = 1; n < count_; ++n) {
      if (n == 1) {
        step_ = -step_;
        go_straight(part, n);
        step_ = -step_;
        for (Index j = 0; j < nv_; ++j) {
          change_[j] = 0.5 * bends_(0, j);
        }
      } else {
        predict(part, n, n < 4 ? 3 - n : n - 4, n - 2);
      }
      move(system_.manifold, places_[n], change_, 1.0);
      if (!keep(part, n)) {
        return false;
      }
    }
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
    change_.fill(0.0);
    for (Index k = 0; k < part.columns; ++k) {
      const Index j = column(part, k);
      change_[j] = width * (
        value * rates_(from, j) + other_value * rates_(other, j) +
        width * (slope * bends_(from, j) + other_slope * bends_(other, j)));
    }
    for (Index k = 0; k < part.columns - part.rows; ++k) {
      const Index j = independent(part, k);
      change_[j] = (PLACES[n] - PLACES[from]) * rates_(from, j);
    }
  }

  /// Largest of the decided coordinates, as lengths.
  double most(const Component & part, Values values) const
  {
    double found = 0.0;
    for (Index k = 0; k < part.rows; ++k) {
      const double size = std::abs(values[column(part, k)]) / column_scale_[column(part, k)];
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
      const Index j = column(part, k);
      double place = 0.0, rate = 0.0, bend = 0.0, fewer = 0.0;
      for (Index n = 0; n < count_; ++n) {
        const double along = rates_(n, j), across = bends_(n, j);
        const double value = sloped ? VALUE_BY_SLOPES[n] : VALUE[n];
        const double slope = sloped ? SLOPE_FOR_VALUE[n] : 0.0;
        place += whole ? value * (places_(n, j) - q_[j]) + slope * along : 0.0;
        rate += value * along + slope * across;
        bend += sloped ? VALUE_FOR_SLOPE[n] * along + SLOPE_BY_VALUES[n] * across : value * across;
        fewer += sloped ? FEWER_FOR_SLOPE[n] * along + FEWER_SLOPES[n] * across :
          FEWER_VALUES[n] * across;
        fastest = std::max(fastest, std::abs(along) / column_scale_[j]);
        sharpest = std::max(sharpest, std::abs(across) / column_scale_[j]);
      }
      longest = std::max(longest, 1.0 / column_scale_[j]);
      near_[j] += place;
      rate_[j] = rate / step_;
      bend_[j] = bend / (step_ * step_);
      change_[j] = place;
      other_[j] = fewer - bend;
      force_[j] = rate - step_ * qd_[j];
    }
    return most(part, change_) <= BESIDE * fastest && most(part, force_) <= OTHER_RATE * fastest &&
           most(part, other_) <= APART * std::max(sharpest, fastest * fastest / longest);
  }

  /// Complete the derivatives of the dependent coordinates by the independent ones, at the state.
  bool finish_tangents(const Component & part)
  {
    if (part.moving == 1) {
      const Index j = independent(part, 0);
      for (Index m = 0; m < part.rows; ++m) {
        tangents_(j, column(part, m)) = rate_[column(part, m)] / qd_[j];
      }
      return true;
    }
    for (Index k = 0; k < part.moving; ++k) {
      const Index j = independent(part, k);
      const Values tangent = tangents_[j], fewer = tangents_of_fewer_[j];
      for (Index m = 0; m < part.rows; ++m) {
        fewer[column(part, m)] -= tangent[column(part, m)];
      }
      if (!(most(part, fewer) <= APART * (most(part, tangent) + 1.0 / column_scale_[j]))) {
        return false;
      }
    }
    return true;
  }

  /// Accelerations and tangents of regular components, the others being on their branches.
  void finish_regular()
  {
    evaluate_equations(near_, rate_);
    for (const Component & part : components_) {
      if (part.regular) {
        factor(part);
        negate_bias();
        solve_decided(part, bend_);
        add_tangents(part, tangents_, 1.0);
      }
    }
  }

  /// Equations of motion along the tangents, then the multipliers.
  bool move_there()
  {
    finish_regular();
    outward(model_, near_, rate_, work_);
    for (Index i = 0; i < added_.rows; ++i) {
      for (Index n = 0; n < added_.columns; ++n) {
        work_.body(i, work_.first_force() + n) += added_(i, n);
      }
    }
    column_.fill(0);
    for (const Component & part : components_) {
      for (Index k = 0; k < part.rows; ++k) {
        column_[column(part, k)] = 1;
      }
    }
    for (Index j = 0, k = 0; j < nv_; ++j) {
      if (column_[j] == 0) {
        tangents_(j, j) = 1.0;
        free_column_[k++] = j;
      }
    }
    generalized_inertia_matrix(model_, work_, gim_);
    tree_torque(model_, work_, bend_, force_);
    for (Index i = 0; i < nv_; ++i) {
      force_[i] -= system_.applied[i];
    }
    for (Index k = 0; k < free_; ++k) {
      const Values tangent = tangents_[free_column_[k]], carried = carried_[k];
      push_[k] = 0.0;
      carried.fill(0.0);
      for (Index i = 0; i < nv_; ++i) {
        if (tangent[i] != 0.0) {
          push_[k] -= tangent[i] * force_[i];
          for (Index j = 0; j < nv_; ++j) {
            carried[j] += tangent[i] * gim_(i, j);
          }
        }
      }
      for (Index m = 0; m <= k; ++m) {
        const Values other = tangents_[free_column_[m]];
        double total = 0.0;
        for (Index i = 0; i < nv_; ++i) {
          total += other[i] * carried[i];
        }
        inertia_(k, m) = total;
      }
    }
    if (!factorize_positive(inertia_)) {
      return false;
    }
    solve_positive(inertia_, push_);
    for (Index k = 0; k < free_; ++k) {
      const Values tangent = tangents_[free_column_[k]];
      for (Index i = 0; i < nv_; ++i) {
        bend_[i] += push_[k] * tangent[i];
        force_[i] += push_[k] * carried_(k, i);
      }
    }
    copy(bend_, system_.qdd);
    Index rank = 0;
    for (const Component & part : components_) {
      rank += find_multipliers(part);
    }
    work_.health[health::RANK] = static_cast<double>(rank);
    return true;
  }

  /// The multipliers that give the joint forces in `force_`; return the rank of the equations.
  Index find_multipliers(const Component & part)
  {
    const Values local = ordered_.part(0, part.rows);
    if (!(factor(part) > VANISHED)) {
      return find_least_multipliers(part);
    }
    for (Index k = 0; k < part.rows; ++k) {
      local[k] = force_[column(part, k)] * column_scale_[column(part, k)];
    }
    solve_transposed(square(part), local);
    for (Index i = 0; i < part.rows; ++i) {
      system_.lam[row(part, i)] = local[i] * row_scale_[row(part, i)];
    }
    return part.rows;
  }

  /// The same where equations vanish: in the least squares, and of all such the least.
  Index find_least_multipliers(const Component & part)
  {
    const Table matrix{factor_.data, part.rows, part.columns};
    for (Index i = 0; i < part.rows; ++i) {
      for (Index k = 0; k < part.columns; ++k) {
        matrix(i, k) = entry(row(part, i), column(part, k));
      }
    }
    const Indices columns = column_.part(0, part.columns);
    const Index rank =
      factorize_fully(matrix, pivot_row_.part(0, part.rows), columns, VANISHED);
    const auto upper = [&](Index k, Index j) {return j >= k ? matrix(k, j) : 0.0;};
    const auto lower = [&](Index k, Index i) {
        return (i == k ? 1.0 : i > k ? matrix(i, k) : 0.0) / row_scale_[row(part, pivot_row_[i])];
      };
    const Table products{gim_.data, rank, rank};
    const Values share = ordered_.part(0, rank);
    for (Index k = 0; k < rank; ++k) {
      share[k] = 0.0;
      for (Index j = k; j < part.columns; ++j) {
        const Index from = column(part, columns[j]);
        share[k] += matrix(k, j) * force_[from] * column_scale_[from];
      }
    }
    fill_products(products, upper, part.columns);
    factorize_positive(products);
    solve_positive(products, share);
    fill_products(products, lower, part.rows);
    factorize_positive(products);
    solve_positive(products, share);
    for (Index i = 0; i < part.rows; ++i) {
      double total = 0.0;
      for (Index k = 0; k < rank; ++k) {
        total += lower(k, i) * share[k];
      }
      system_.lam[row(part, pivot_row_[i])] = total;
    }
    return rank;
  }

  const System & system_;
  const Model & model_;
  const Workspace & work_;
  const Values q_, qd_;
  const Table added_;
  const Index nv_, nc_, free_;
  Scratch<double, NUMBERS> scratch_;
  const Table jac_, factor_;
  const Values closure_, bias_, row_scale_, right_, ordered_, column_scale_, change_;
  const Table places_, rates_, bends_, tangents_, tangents_of_fewer_;
  const Values near_, rate_, bend_, other_, force_;
  const Table gim_, carried_, inertia_;
  const Values push_;
  Scratch<Index, COUNTS> counts_;
  // Coordinates and equations, component by component.
  const Indices order_, root_, column_, free_column_, row_, pivot_row_;
  Scratch<Component, MOST_PARTS> parts_;
  Vector<Component> components_;
  // With the addresses of these arrays.
  std::array<Index, routine::TABLE_COLUMNS> table_;
  double step_ = 0.0, pivot_ = 0.0;
  Index count_ = 0;
};
}  // namespace

bool accelerate_by_places(const System & system, Values q, Values qd, Table added)
{
  const bool driven = system.has_effects() && system.effects.motions.rows > 0;
  return !driven && system.lam.size < qd.size && Branch(system, q, qd, added).accelerate();
}

}  // namespace closedloop
