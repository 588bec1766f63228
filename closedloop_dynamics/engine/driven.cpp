// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "driven.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "interrupt.hpp"
#include "loop_closure.hpp"
#include "loop_solver.hpp"
#include "manifold.hpp"

namespace closedloop
{

namespace
{
using Square = Eigen::MatrixXd;

// Between two positions the Jacobian changes by less than this share of itself, measured by its
// inverse: where the share is less than 1 it is regular on all the way, no other branch is met,
// and by Newton and Kantorovich's theorem no second solution is as near.
constexpr double SAME_BRANCH = 0.4;
// Scaled corrections: shorter ones are rounding, longer ones lead elsewhere; where they no longer
// become shorter, these will do.
constexpr double ROUNDING = 1e-15, LONGEST = 0.5, STALLED = 1e-11;
constexpr int MOST_CORRECTIONS = 20;
// Shares of the way between two poses: the shortest that is tried.
constexpr double SHORTEST = 1e-13;
// The same between neighbours of a grid, of which another one may lead on.
constexpr double SHORTEST_TO_NEIGHBOUR = 1e-6, SHORTEST_ACROSS = 1e-2;

/// One position of a branch, and the predictor of the next. Residuals and Jacobians are the loop
/// solver's; corrections are by factors of its own, as their inverse tells, too, whether the branch is
/// still the same.
class Follower
{
public:
  Follower(
    const Model & model, const Workspace & work, const Manifold & manifold, Indices drives,
    Indices kept, Values unit, Table anchors, double open)
  : model_(model), work_(work), manifold_(manifold), drives_(drives), kept_(kept),
    unit_(dense(unit)), open_(open), column_(model.cut_point.columns - cut::MOTION_COLUMNS),
    solver_(model, work, manifold, Loops{{}, kept, {}}), still_(DenseVector::Zero(unit.size)), matrix_(unit.size, unit.size),
    right_(DenseVector::Zero(unit.size)), lu_(unit.size)
  {
    matrix_.bottomRows(anchors.rows) = dense(anchors);
  }

  /// Start from a position that closes the loops; false where it is singular.
  bool begin(const DenseVector & q)
  {
    fill_matrix(solver_.slopes_at(q));
    return invert();
  }

  /// Move from the driven values `from` on to `to`; false, and `q` of no meaning, where that is
  /// too far.
  bool step(const DenseVector & from, const DenseVector & to, DenseVector & q)
  {
    drive(to);
    // The tangent, then corrections by the Jacobian there.
    for (Index row = 0; row < kept_.size; ++row) {
      const Index number = kept_[row] - first_drive();
      right_[row] = number >= 0 ? to[number] - from[number] : 0.0;
    }
    change_.noalias() = inverse_ * right_;
    if (!move_by_change(q)) {
      return false;
    }
    fill_matrix(solver_.slopes_at(q));
    lu_.compute(matrix_);
    return converge(q) && is_on_branch();
  }

  /// Rates and accelerations in the current position, into rows.
  void complete(Table values, const DenseVector & q, Values velocity, Values acceleration)
  {
    dense(velocity).setZero();
    dense(acceleration).setZero();
    bool rests = true;
    for (Index k = 0; k < drives_.size; ++k) {
      rests = rests && values(k, 1) == 0.0 && values(k, 2) == 0.0;
      model_.cut_point(drives_[k], column_ + 1) = values(k, 1);
      model_.cut_point(drives_[k], column_ + 2) = values(k, 2);
    }
    if (!rests) {
      solve(solver_.changes_at(q, still_, Level::VELOCITY), velocity);
      solve(solver_.changes_at(q, dense(velocity), Level::ACCELERATION), acceleration);
    }
  }

  /// Set driven values, at rest.
  void drive(const DenseVector & values)
  {
    for (Index k = 0; k < drives_.size; ++k) {
      model_.cut_point(drives_[k], column_) = values[k];
      model_.cut_point(drives_[k], column_ + 1) = 0.0;
      model_.cut_point(drives_[k], column_ + 2) = 0.0;
    }
  }

  /// Move from driven values `from` on towards `to`, in steps whose share of the way is `share` at
  /// first; returned is the share of the way at which the branch, or patience, ends; 1 where it
  /// does not.
  double advance(
    const DenseVector & from, const DenseVector & to, DenseVector & q, double & share,
    double shortest, Interrupt * interrupt = nullptr)
  {
    way_ = to - from;
    reached_ = from;
    double done = 0.0;
    while (done < 1.0) {
      // A step takes some corrections, each by the factors of a matrix.
      if (interrupt != nullptr && interrupt->after(3 * unit_.size())) {
        break;
      }
      const double ahead = std::min(1.0, done + share);
      aim_ = from + ahead * way_;
      trial_ = q;
      if (step(reached_, aim_, trial_)) {
        q = trial_;
        reached_ = aim_;
        done = ahead;
        share = std::min(1.0, 2.0 * share);
      } else {
        share *= 0.5;
        if (share < shortest) {
          break;
        }
      }
    }
    return done;
  }

  /// Store the predictor at the position accepted last.
  void keep()
  {
    kept_inverse_ = inverse_;
    kept_inverted_ = inverted_;
  }
  void restore()
  {
    inverse_ = kept_inverse_;
    inverted_ = kept_inverted_;
  }

  /// Derivatives of some coordinates by the driven values in the current position, row by row.
  void rates_of(Indices coordinates, Values out) const
  {
    for (Index row = 0; row < kept_.size; ++row) {
      const Index number = kept_[row] - first_drive();
      for (Index k = 0; number >= 0 && k < coordinates.size; ++k) {
        out[k * drives_.size + number] = unit_[coordinates[k]] * inverse_(coordinates[k], row);
      }
    }
  }

private:
  /// The driving equations are the last ones.
  Index first_drive() const {return model_.equations() - drives_.size;}

  void fill_matrix(const DenseMatrix & slopes)
  {
    matrix_.topRows(kept_.size).noalias() = slopes * unit_.asDiagonal();
    right_.head(kept_.size) = solver_.residuals();
  }

  bool invert()
  {
    lu_.compute(matrix_);
    inverse_ = lu_.inverse();
    inverted_ = matrix_;
    return inverse_.allFinite();
  }

  /// Whether the position is on the branch of the last one; makes it the current one if so.
  bool is_on_branch()
  {
    fill_matrix(solver_.slopes());
    // A bound of the change, where that is enough, and the change.
    if (!(inverse_.norm() * (matrix_ - inverted_).norm() < SAME_BRANCH)) {
      next_.noalias() = inverse_ * matrix_;
      next_.diagonal().array() -= 1.0;
      if (!(next_.norm() < SAME_BRANCH)) {
        return false;
      }
    }
    return invert();
  }

  bool move_by_change(DenseVector & q)
  {
    if (!(change_.cwiseAbs().maxCoeff() < LONGEST)) {
      return false;
    }
    change_.array() *= unit_.array();
    move(manifold_, view(q), view(change_), 1.0);
    return true;
  }

  bool converge(DenseVector & q)
  {
    double last = std::numeric_limits<double>::infinity();
    for (int n = 0; n < MOST_CORRECTIONS; ++n) {
      change_ = lu_.solve(-right_);
      const double size = change_.cwiseAbs().maxCoeff();
      const bool stalled = size > 0.5 * last;
      if (!stalled && !move_by_change(q)) {
        return false;
      }
      if (stalled || size <= ROUNDING) {
        return (size <= ROUNDING || size < STALLED) && largest(work_.closure) <= open_;
      }
      right_.head(kept_.size) = solver_.residuals_at(q);
      last = size;
    }
    return false;
  }

  /// Displacements that remove errors of the kept equations.
  void solve(const DenseVector & errors, Values out)
  {
    change_.noalias() = inverse_.leftCols(kept_.size) * errors;
    dense(out) = -unit_.cwiseProduct(change_);
  }

  const Model & model_;
  const Workspace & work_;
  const Manifold & manifold_;
  Indices drives_, kept_;
  DenseVector unit_;
  double open_;
  Index column_;
  LoopSolver solver_;
  DenseVector still_;
  Square matrix_, inverse_, inverted_, next_, kept_inverse_, kept_inverted_;
  DenseVector change_, right_, way_, reached_, aim_, trial_;
  Eigen::PartialPivLU<Square> lu_;
};
}  // namespace

std::pair<double, double> follow_drives(
  const Model & model, const Workspace & work, const Manifold & manifold, Indices drives,
  Indices kept, Values unit, Table anchors, double open, Values begin, Cube<double> values,
  Values q, Table position, Table velocity, Table acceleration, bool (* interrupted)())
{
  Interrupt interrupt(interrupted, unit.size);
  Follower follower(model, work, manifold, drives, kept, unit, anchors, open);
  DenseVector from = dense(begin), to(begin.size), here = dense(q);
  follower.drive(from);
  if (!follower.begin(here)) {
    return {0.0, 0.0};
  }
  double share = 1.0;
  for (Index k = 0; k < values.pages; ++k) {
    for (Index n = 0; n < begin.size; ++n) {
      to[n] = values[k](n, 0);
    }
    const double done = follower.advance(from, to, here, share, SHORTEST, &interrupt);
    dense(q) = here;
    if (done < 1.0) {
      return {static_cast<double>(k), done};
    }
    from = to;
    copy(q, position[k]);
    follower.complete(values[k], here, velocity[k], acceleration[k]);
  }
  return {static_cast<double>(values.pages), 0.0};
}

Index reach_poses(
  const Model & model, const Workspace & work, const Manifold & manifold, Indices drives,
  Indices kept, Values unit, Table anchors, double open, Indexes grid, Indices seeds,
  Table values, Indices actuated, Indices reached, Table position, Table rates)
{
  Follower follower(model, work, manifold, drives, kept, unit, anchors, open);
  const Index axes = grid.columns;
  // The grid's shape, and the part of it that may be written.
  const Indices shape = grid[0], first = grid[1], last = grid[2];
  std::vector<Index> waiting(seeds.begin(), seeds.end()), place(axes), stride(axes, 1);
  for (Index axis = axes - 1; axis > 0; --axis) {
    stride[axis - 1] = stride[axis] * shape[axis];
  }
  Index sides = 1;
  for (Index axis = 0; axis < axes; ++axis) {
    sides *= 3;
  }
  DenseVector from, to, here;
  Index count = 0;
  for (std::size_t next = 0; next < waiting.size(); ++next) {
    const Index cell = waiting[next];
    bool begun = false;
    for (Index axis = 0, left = cell; axis < axes; ++axis) {
      place[axis] = left / stride[axis];
      left %= stride[axis];
    }
    // All neighbours, those across corners too: digits of 0, 1 and 2 for steps of -1, 0 and 1.
    for (Index digits = 0; digits < sides; ++digits) {
      bool inside = true;
      Index neighbour = cell, steps = 0;
      for (Index axis = 0, left = digits; axis < axes; ++axis, left /= 3) {
        const Index step = left % 3 - 1, at = place[axis] + step;
        inside = inside && at >= first[axis] && at < last[axis];
        neighbour += step * stride[axis];
        steps += step != 0;
      }
      if (!inside || reached[neighbour] != 0) {
        continue;
      }
      from = dense(values[cell]);
      to = dense(values[neighbour]);
      here = dense(position[cell]);
      if (!begun) {
        follower.drive(from);
        if (!follower.begin(here)) {
          break;
        }
        follower.keep();
        begun = true;
      }
      follower.restore();
      double share = 1.0;
      const double shortest = steps == 1 ? SHORTEST_TO_NEIGHBOUR : SHORTEST_ACROSS;
      if (follower.advance(from, to, here, share, shortest) < 1.0) {
        continue;
      }
      dense(position[neighbour]) = here;
      follower.rates_of(actuated, rates[neighbour]);
      reached[neighbour] = 1;
      waiting.push_back(neighbour);
      ++count;
    }
  }
  return count;
}

}  // namespace closedloop
