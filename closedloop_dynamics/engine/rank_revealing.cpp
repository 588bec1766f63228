// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "rank_revealing.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "forward_dynamics.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
// Most corrections onto the branch: from 1e-4 beside it, two reach rounding.
constexpr int MOST_CORRECTIONS = 4;
// Closure error, against the size of J's entries, that counts as on the branch.
constexpr double SETTLED = 1e-10;
// Singular values below this: rounding, divided three times by s, would show in accelerations.
constexpr double CLOSE = 1e-3;
// Positions around a state that are evaluated instead: at -4 to 4 times `aside`, but not at 0. The
// eighth power of that distance is the error of the interpolation, far below the tightest
// tolerance; that of four places, 1e-7, was found by step after step of an error-controlled method.
constexpr int PLACES = 8;
// Smallest singular value at which a position is evaluated. Where many loops become collinear at
// once, singular values grow slowly with the distance. The places are then moved farther away, at
// most FARTHEST times as far, evaluated if singular values there are BETTER times those here, and
// accepted if all but the outermost agree: up to APART of the largest acceleration, or of the
// rounding error, NOISE, of those at the state.
constexpr double ENOUGH = 2.0 * CLOSE, LEAST_ENOUGH = 0.1 * CLOSE;
constexpr double FARTHEST = 8.0, BETTER = 2.0, APART = 1e-6, NOISE = 1e-18;

/// Largest angular velocity of any body [rad/s].
double fastest(const Workspace & work)
{
  double most = 0.0;
  for (Index i = 1; i < work.body.rows; ++i) {
    if (work.planar()) {
      most = std::max(most, std::abs(work.body(i, plane::OMEGA)));
    } else {
      const double * spin = work.body.row(i) + space::SPIN;
      most = std::max(
        most, std::sqrt(spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]));
    }
  }
  return most;
}

/// Where the k-th place around a state is, in units of the distance `aside`.
double place_of(int k)
{
  const int half = PLACES / 2;
  return k < half ? k - half : k - half + 1;
}

/// Weight of a place around a state, of so many places on either side: Lagrange's polynomial,
/// (half!)^2 / ((half - n)! (half + n)!) for the places n and -n, with the sign of (-1)^(n + 1).
double share_of(double place, int half)
{
  double share = -1.0;
  for (int i = 1; i <= static_cast<int>(std::abs(place)); ++i) {
    share *= -(half - i + 1.0) / (half + i);
  }
  return share;
}

/// The equations of one mechanism, decomposed once at each position.
template<int Most>
class Solver
{
public:
  using Matrix = typename Sized<Most>::Matrix;
  using Vector = typename Sized<Most>::Vector;

  Solver(const Model & model, const Workspace & work, Index most)
  : model_(model), work_(work), most_(most), jac_(work.right.size, model.joints()),
    gim_(model.joints(), model.joints())
  {
    const Index nc = jac_.rows(), nv = jac_.cols();
    equations_ = {Vector::Zero(nc), Vector::Zero(nv), Vector::Zero(nc), Vector::Zero(nc)};
  }

  /// As `correct_rank_revealing`.
  void correct(Level level, Values out)
  {
    decompose();
    measure();
    equations_.right = -(level == Level::POSITION ? equations_.psi : equations_.rate);
    equations_.force.setZero();
    solve(place_, equations_, most_, fastest(work_), level, out, {});
  }

  /// As `weakest_equation`.
  double weakest()
  {
    decompose();
    if (!place_.finite) {
      return 0.0;
    }
    const auto & values = place_.singular.singularValues();
    const Index count = std::min<Index>(values.size(), most_);
    return count > 0 ? values[count - 1] : 0.0;
  }

  /// As `accelerate_rank_revealing`.
  void accelerate(
    Values tau, double baumgarte, double aside, const Manifold &, Values q, Values qd, Values qdd,
    Values lam);

private:
  static Values view(Vector & vector) {return {vector.data(), vector.size()};}
  static Table view(Matrix & matrix) {return {matrix.data(), matrix.rows(), matrix.cols()};}

  /// Decompose the equations at the place in the workspace, but for the place before.
  void decompose()
  {
    if (!known_) {
      constraint_jacobian(model_, work_, view(jac_));
      generalized_inertia_matrix(model_, work_, view(gim_));
      place_.decompose(model_, view(jac_), view(gim_));
      known_ = true;
    }
  }

  /// Evaluate errors and rates of all closure equations at the state in the workspace.
  void measure()
  {
    update(model_, work_, Responses::NONE);
    to_user_order(model_, work_.closure, view(equations_.psi));
    to_user_order(model_, work_.closure_rate, view(equations_.rate));
  }

  /// Accelerations and multipliers at the state in the workspace.
  Rank solve_here(Values tau, const Vector & beside, Vector & qdd, Vector & lam)
  {
    qdd.setZero();
    tree_torque(model_, work_, view(qdd), view(equations_.force));
    for (Index i = 0; i < qdd.size(); ++i) {
      equations_.force[i] = tau[i] - equations_.force[i];
    }
    decompose();
    measure();
    work_.right.fill(0.0);
    constraint_right_side(work_, 0.0, work_.right);
    to_user_order(model_, work_.right, view(equations_.right));
    equations_.right += beside;
    return solve(
      place_, equations_, most_, fastest(work_), Level::ACCELERATION, view(qdd), view(lam));
  }

  /// Bring a state onto the branch next to it, in place; return the closure error that is left.
  double return_to_branch(const Manifold & manifold, Values q, Values qd, double size)
  {
    Vector change = Vector::Zero(qd.size);
    double error = std::numeric_limits<double>::infinity();
    for (int count = 0; count <= MOST_CORRECTIONS; ++count) {
      outward(model_, q, qd, work_);
      update(model_, work_, Responses::NONE);
      error = largest(work_.closure);
      const bool positions = error > ROUNDING * size && count < MOST_CORRECTIONS;
      correct(positions ? Level::POSITION : Level::VELOCITY, view(change));
      if (!positions) {
        dense(qd) += change;
        break;
      }
      move(manifold, q, view(change), 1.0);
      known_ = false;
    }
    return error;
  }

  /// Forces of effects on the bodies, beside those of their own motion.
  Matrix forces_on_bodies() const
  {
    Matrix found(work_.body.rows - 1, work_.size());
    for (Index i = 0; i < found.rows(); ++i) {
      for (Index n = 0; n < found.cols(); ++n) {
        found(i, n) = work_.body(i + 1, work_.first_force() + n);
      }
    }
    return found;
  }

  void add_forces(const Matrix & forces)
  {
    for (Index i = 0; i < forces.rows(); ++i) {
      for (Index n = 0; n < forces.cols(); ++n) {
        work_.body(i + 1, work_.first_force() + n) += forces(i, n);
      }
    }
  }

  const Model & model_;
  const Workspace & work_;
  const Index most_;  ///< Independent equations at most
  Matrix jac_, gim_;
  Decomposition<Most> place_;
  DenseEquations<Most> equations_;
  bool known_ = false;
};

template<int Most>
void Solver<Most>::accelerate(
  Values tau, double baumgarte, double aside, const Manifold & manifold, Values q, Values qd,
  Values qdd, Values lam)
{
  const Index nv = qdd.size, nc = lam.size;
  const Values & health = work_.health;
  // A spherical joint has four coordinates and three rates.
  Eigen::Matrix<
    double, Eigen::Dynamic, 1, Eigen::ColMajor, Most == Eigen::Dynamic ? Most : 2 * Most, 1>
  near(q.size);
  Vector near_rate(nv), found(nv), forces(nc);
  Vector beside = Vector::Zero(nc), total = Vector::Zero(nv), inner = Vector::Zero(nv);
  update(model_, work_, Responses::NONE);
  for (Index k = 0; k < nc; ++k) {
    work_.right[k] = -baumgarte * (2.0 * work_.closure_rate[k] + baumgarte * work_.closure[k]);
  }
  to_user_order(model_, work_.right, view(beside));
  Matrix applied = forces_on_bodies();
  health[health::RANK_REVEALING_COUNT] += 1.0;
  const double speed = fastest(work_);
  Rank rank = solve_here(tau, beside, found, forces);
  const double size = place_.largest;
  const Index here = rank.distinct;
  const auto accept = [&]() {
      health[health::RANK] = static_cast<double>(rank.taken);
      copy(view(found), qdd);
      copy(view(forces), lam);
    };
  accept();
  bool close = rank.weakest < WEAK || static_cast<double>(here) < health[health::MOST_DISTINCT];
  if (close) {
    health[health::SINGULAR_COUNT] += 1.0;
  }
  // A regular position but for redundant equations, or a mechanism at rest.
  if (!((close || (here < nc && health[health::LOOKED_BESIDE] == 0.0)) && speed > 0.0)) {
    return;
  }
  outward(model_, q, qd, work_);
  applied -= forces_on_bodies();
  // Solve on the branch, so far ahead of the state; return whether it is on the branch.
  const auto solve_ahead = [&](double ahead) {
      const Values there{near.data(), near.size()};
      near = dense(q);
      near_rate = dense(qd);
      if (ahead != 0.0) {
        move(manifold, there, qd, ahead);
        known_ = false;
      }
      const double error = return_to_branch(manifold, there, view(near_rate), size);
      outward(model_, there, view(near_rate), work_);
      add_forces(applied);
      rank = solve_here(tau, beside, found, forces);
      return error <= SETTLED * size;
    };
  const auto leave_as_found = [&]() {
      outward(model_, q, qd, work_);
      update(model_, work_, Responses::NONE);
      add_forces(applied);
    };
  // First the branch beside the state, then places around it.
  const bool settled_here = solve_ahead(0.0);
  if (close && settled_here && rank.weakest >= CLOSE &&
    static_cast<double>(rank.distinct) >= health[health::MOST_DISTINCT])
  {
    accept();
    leave_as_found();
    return;
  }
  // Baumgarte's terms are divided by s as well: around here by another one.
  beside.setZero();
  double weak = rank.weakest;
  const Index few = rank.distinct;
  bool farther = false;
  for (int k = 0; k < PLACES; ++k) {
    const double place = place_of(k);
    const bool settled = solve_ahead(place * aside / speed);
    // On the branch only: beside it redundant equations seem independent.
    if (settled) {
      health[health::LOOKED_BESIDE] = 1.0;
      health[health::MOST_DISTINCT] =
        std::max(health[health::MOST_DISTINCT], static_cast<double>(rank.distinct));
    }
    // Not on a branch, or with redundant equations there, too, the first result is used.
    if (!close && static_cast<double>(here) < health[health::MOST_DISTINCT]) {
      close = true;
      health[health::SINGULAR_COUNT] += 1.0;
    }
    if (!(close && settled)) {
      break;
    }
    if (rank.distinct > few) {
      // A singular value that is zero at the state.
      weak = 0.0;
    }
    if (rank.weakest < ENOUGH && !farther) {
      // Singular values grow in proportion to the distance.
      const double needed = std::abs(place) * (ENOUGH + weak), gained = rank.weakest - weak;
      aside *= needed > FARTHEST * gained ? FARTHEST : needed / gained;
      farther = true;
      total.setZero();
      inner.setZero();
      k = -1;
      continue;
    }
    if (rank.weakest < ENOUGH && rank.weakest < std::max(LEAST_ENOUGH, BETTER * weak)) {
      break;
    }
    total += share_of(place, PLACES / 2) * found;
    inner += share_of(place, PLACES / 2 - 1) * found;
    if (k == PLACES - 1) {
      const double apart = (total - inner).cwiseAbs().maxCoeff();
      const double most = total.cwiseAbs().maxCoeff();
      // Divided by s twice: the states are on the branch.
      if (!farther || apart * weak * weak <= most * std::max(APART * weak * weak, NOISE)) {
        copy(view(total), qdd);
      }
    }
  }
  leave_as_found();
}

/// Call a function of a solver that is large enough.
template<class Function>
void with_solver(const Model & model, const Workspace & work, Index most, Function && function)
{
  if (std::max(model.joints(), work.right.size) <= FEW) {
    Solver<FEW> solver(model, work, most);
    function(solver);
  } else {
    Solver<Eigen::Dynamic> solver(model, work, most);
    function(solver);
  }
}
}  // namespace

double weakest_equation(const Model & model, const Workspace & work, Index most)
{
  double found = 0.0;
  with_solver(model, work, most, [&](auto & solver) {found = solver.weakest();});
  return found;
}

void correct_rank_revealing(
  const Model & model, const Workspace & work, Index most, Level level, Values out)
{
  with_solver(model, work, most, [&](auto & solver) {solver.correct(level, out);});
}

void accelerate_rank_revealing(
  const Model & model, const Workspace & work, Index most, Values tau, double baumgarte,
  double aside, const Manifold & manifold, Values q, Values qd, Values qdd, Values lam)
{
  with_solver(
    model, work, most, [&](auto & solver) {
      solver.accelerate(tau, baumgarte, aside, manifold, q, qd, qdd, lam);
    });
}

}  // namespace closedloop
