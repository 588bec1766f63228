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
#include "manifold.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using DenseMatrix = Eigen::MatrixXd;
using DenseVector = Eigen::VectorXd;

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

/// One position of a branch, and the predictor of the next.
class Follower
{
public:
  Follower(
    const Model & model, const Workspace & work, const Manifold & manifold, Indices drives,
    Indices kept, Values unit, Table anchors, double open)
  : model_(model), work_(work), manifold_(manifold), drives_(drives), kept_(kept), unit_(unit),
    open_(open), column_(model.cut_point.columns - cut::MOTION_COLUMNS),
    jac_(model.equations(), unit.size), matrix_(unit.size, unit.size),
    inverse_(unit.size, unit.size), next_(unit.size, unit.size), change_(unit.size),
    right_(unit.size), closure_(model.equations()), still_(DenseVector::Zero(unit.size)),
    lu_(unit.size)
  {
    matrix_.bottomRows(anchors.rows) =
      Eigen::Map<RowMatrix>(anchors.data, anchors.rows, anchors.columns);
  }

  /// Start from a position that closes the loops; false where it is singular.
  bool begin(Values q)
  {
    outward(model_, q, view(still_), work_);
    fill_matrix();
    return invert();
  }

  /// Move from the driven values `from` on to `to`; false, and `q` of no meaning, where that is
  /// too far.
  bool step(const DenseVector & from, const DenseVector & to, Values q)
  {
    drive(to);
    // The tangent, then corrections by the Jacobian there.
    right_.setZero();
    for (Index row = 0; row < kept_.size; ++row) {
      const Index number = kept_[row] - first_drive();
      right_[row] = number >= 0 ? to[number] - from[number] : 0.0;
    }
    change_.noalias() = inverse_ * right_;
    if (!move_by_change(q)) {
      return false;
    }
    outward(model_, q, view(still_), work_);
    fill_matrix();
    lu_.compute(matrix_);
    return converge(q) && is_on_branch();
  }

  /// Rates and accelerations in the current position, into rows.
  void complete(Table values, Values q, Values velocity, Values acceleration)
  {
    bool rests = true;
    for (Index k = 0; k < drives_.size; ++k) {
      rests = rests && values(k, 1) == 0.0 && values(k, 2) == 0.0;
    }
    if (rests) {
      std::fill(velocity.begin(), velocity.end(), 0.0);
      std::fill(acceleration.begin(), acceleration.end(), 0.0);
      return;
    }
    for (Index k = 0; k < drives_.size; ++k) {
      model_.cut_point(drives_[k], column_ + 1) = values(k, 1);
      model_.cut_point(drives_[k], column_ + 2) = values(k, 2);
    }
    outward(model_, q, view(still_), work_);
    update(model_, work_, Responses::NONE);
    solve(work_.closure_rate, velocity);
    outward(model_, q, velocity, work_);
    update(model_, work_, Responses::NONE);
    solve(work_.bias, acceleration);
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
    const DenseVector & from, const DenseVector & to, Values q, Values trial, double & share,
    double shortest, Interrupt * interrupt = nullptr)
  {
    way_ = to - from;
    reached_ = from;
    double done = 0.0;
    while (done < 1.0) {
      // A step takes some corrections, each by the factors of a matrix.
      if (interrupt != nullptr && interrupt->after(3 * unit_.size)) {
        break;
      }
      const double ahead = std::min(1.0, done + share);
      aim_ = from + ahead * way_;
      copy(q, trial);
      if (step(reached_, aim_, trial)) {
        copy(trial, q);
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
  static Values view(DenseVector & from) {return {from.data(), from.size()};}

  /// The driving equations are the last ones.
  Index first_drive() const {return model_.equations() - drives_.size;}

  void fill_matrix()
  {
    constraint_jacobian(model_, work_, {jac_.data(), jac_.rows(), jac_.cols()});
    for (Index row = 0; row < kept_.size; ++row) {
      for (Index k = 0; k < unit_.size; ++k) {
        matrix_(row, k) = jac_(kept_[row], k) * unit_[k];
      }
    }
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
    fill_matrix();
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

  bool move_by_change(Values q)
  {
    if (!(change_.cwiseAbs().maxCoeff() < LONGEST)) {
      return false;
    }
    for (Index k = 0; k < unit_.size; ++k) {
      change_[k] *= unit_[k];
    }
    move(manifold_, q, view(change_), 1.0);
    return true;
  }

  bool converge(Values q)
  {
    double last = std::numeric_limits<double>::infinity();
    for (int n = 0; n < MOST_CORRECTIONS; ++n) {
      update(model_, work_, Responses::NONE);
      collect(work_.closure);
      change_ = lu_.solve(-right_);
      const double size = change_.cwiseAbs().maxCoeff();
      const bool stalled = size > 0.5 * last;
      if (!stalled && !move_by_change(q)) {
        return false;
      }
      if (stalled || size <= ROUNDING) {
        return (size <= ROUNDING || size < STALLED) && largest(work_.closure) <= open_;
      }
      outward(model_, q, view(still_), work_);
      last = size;
    }
    return false;
  }

  /// The numbers of the kept equations among those of all, in elimination order, into `right_`.
  void collect(Values ordered)
  {
    to_user_order(model_, ordered, view(closure_));
    right_.setZero();
    for (Index row = 0; row < kept_.size; ++row) {
      right_[row] = closure_[kept_[row]];
    }
  }

  /// Displacements that remove the errors of the kept equations.
  void solve(Values ordered, Values out)
  {
    collect(ordered);
    change_.noalias() = inverse_ * right_;
    for (Index k = 0; k < unit_.size; ++k) {
      out[k] = -unit_[k] * change_[k];
    }
  }

  const Model & model_;
  const Workspace & work_;
  const Manifold & manifold_;
  Indices drives_, kept_;
  Values unit_;
  double open_;
  Index column_;
  RowMatrix jac_;
  DenseMatrix matrix_, inverse_, inverted_, next_, kept_inverse_, kept_inverted_;
  DenseVector change_, right_, closure_, still_, way_, reached_, aim_;
  Eigen::PartialPivLU<DenseMatrix> lu_;
};
}  // namespace

std::pair<double, double> follow_drives(
  const Model & model, const Workspace & work, const Manifold & manifold, Indices drives,
  Indices kept, Values unit, Table anchors, double open, Values begin, Cube<double> values,
  Values q, Table position, Table velocity, Table acceleration, bool (* interrupted)())
{
  Interrupt interrupt(interrupted, unit.size);
  Follower follower(model, work, manifold, drives, kept, unit, anchors, open);
  DenseVector from = Eigen::Map<DenseVector>(begin.data, begin.size), to(begin.size);
  DenseVector tried(q.size);
  const Values trial{tried.data(), tried.size()};
  follower.drive(from);
  if (!follower.begin(q)) {
    return {0.0, 0.0};
  }
  double share = 1.0;
  for (Index k = 0; k < values.pages; ++k) {
    for (Index n = 0; n < begin.size; ++n) {
      to[n] = values[k](n, 0);
    }
    const double done = follower.advance(from, to, q, trial, share, SHORTEST, &interrupt);
    if (done < 1.0) {
      return {static_cast<double>(k), done};
    }
    from = to;
    copy(q, position[k]);
    follower.complete(values[k], q, velocity[k], acceleration[k]);
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
  DenseVector from(values.columns), to(values.columns), start(position.columns);
  DenseVector tried(position.columns);
  const Values here{start.data(), start.size()}, trial{tried.data(), tried.size()};
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
      from = Eigen::Map<DenseVector>(values.row(cell), values.columns);
      to = Eigen::Map<DenseVector>(values.row(neighbour), values.columns);
      copy(position[cell], here);
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
      if (follower.advance(from, to, here, trial, share, shortest) < 1.0) {
        continue;
      }
      copy(here, position[neighbour]);
      follower.rates_of(actuated, rates[neighbour]);
      reached[neighbour] = 1;
      waiting.push_back(neighbour);
      ++count;
    }
  }
  return count;
}

}  // namespace closedloop
