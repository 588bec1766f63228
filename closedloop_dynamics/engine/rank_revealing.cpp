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
// Corrections that bring a stage onto its branch: beside it by 1e-4, two leave rounding.
constexpr int MOST_CORRECTIONS = 4;
// Closure error, against the size of J's entries, that counts as on the branch.
constexpr double SETTLED = 1e-10;
// Singular values below this: rounding, divided three times by s, would show in accelerations.
constexpr double CLOSE = 1e-3;
// Places around a state where the branch is asked instead: at -4 to 4 times `aside`, but not at 0.
// The eighth power of that distance is the error of the interpolation, which is nothing beside the
// tightest tolerance; that of four places, 1e-7, was found by step after step of an
// error-controlled method.
constexpr int PLACES = 8;
// Smallest singular value at which a place is asked. Where many loops come to lie in one line at
// once, singular values grow slowly with the distance. The places are then taken farther away, at
// most FARTHEST times as far, asked if singular values there are BETTER times those here, and
// believed if all but the outermost agree: up to APART of the largest acceleration, or what
// rounding, NOISE, makes of the state's own.
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

/// Dense equations with the closure errors of the state in `work`; right-hand sides are zero.
DenseEquations dense_equations(const Model & model, const Workspace & work)
{
  const Index nv = model.joints(), nc = work.right.size;
  DenseEquations found{
    DenseMatrix::Zero(nc, nv), DenseMatrix::Zero(nv, nv), DenseVector::Zero(nc),
    DenseVector::Zero(nv), DenseVector::Zero(nc), DenseVector::Zero(nc)};
  constraint_jacobian(model, work, view(found.jac));
  update(model, work, Responses::NONE);
  to_user_order(model, work.closure, view(found.psi));
  to_user_order(model, work.closure_rate, view(found.rate));
  return found;
}

/// Accelerations and multipliers at the state in `work`; `size` is the largest entry of J.
Rank solve_here(
  const Model & model, const Workspace & work, Values tau, const DenseVector & beside, Values qdd,
  Values lam, double & size)
{
  DenseEquations equations = dense_equations(model, work);
  work.right.fill(0.0);
  constraint_right_side(work, 0.0, work.right);
  to_user_order(model, work.right, view(equations.right));
  equations.right += beside;
  size = equations.jac.size() > 0 ? equations.jac.cwiseAbs().maxCoeff() : 0.0;
  qdd.fill(0.0);
  tree_torque(model, work, qdd, view(equations.force));
  for (Index i = 0; i < qdd.size; ++i) {
    equations.force[i] = tau[i] - equations.force[i];
  }
  generalized_inertia_matrix(model, work, view(equations.gim));
  return solve(model, equations, fastest(work), Level::ACCELERATION, qdd, lam);
}

/// Bring a state onto the branch next to it, in place; return the closure error that is left.
double return_to_branch(
  const Model & model, const Workspace & work, const Manifold & manifold, Values q, Values qd,
  double size)
{
  DenseVector change = DenseVector::Zero(qd.size);
  double error = std::numeric_limits<double>::infinity();
  for (int count = 0; count <= MOST_CORRECTIONS; ++count) {
    outward(model, q, qd, work);
    update(model, work, Responses::NONE);
    error = largest(work.closure);
    const bool positions = error > ROUNDING * size && count < MOST_CORRECTIONS;
    correct_rank_revealing(
      model, work, positions ? Level::POSITION : Level::VELOCITY, view(change));
    if (!positions) {
      dense(qd) += change;
      break;
    }
    move(manifold, q, view(change), 1.0);
  }
  return error;
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

/// Forces of effects on the bodies, beside those of their own motion.
DenseMatrix forces_on_bodies(const Workspace & work)
{
  DenseMatrix found(work.body.rows, work.size());
  for (Index i = 0; i < work.body.rows; ++i) {
    for (Index n = 0; n < work.size(); ++n) {
      found(i, n) = work.body(i, work.first_force() + n);
    }
  }
  return found;
}

void add_forces(const Workspace & work, const DenseMatrix & forces)
{
  for (Index i = 0; i < work.body.rows; ++i) {
    for (Index n = 0; n < work.size(); ++n) {
      work.body(i, work.first_force() + n) += forces(i, n);
    }
  }
}
}  // namespace

void correct_rank_revealing(const Model & model, const Workspace & work, Level level, Values out)
{
  DenseEquations equations = dense_equations(model, work);
  equations.right = -(level == Level::POSITION ? equations.psi : equations.rate);
  generalized_inertia_matrix(model, work, view(equations.gim));
  DenseVector lam(work.right.size);
  solve(model, equations, fastest(work), level, out, view(lam));
}

void accelerate_rank_revealing(
  const Model & model, const Workspace & work, Values tau, double baumgarte, double aside,
  const Manifold & manifold, Values q, Values qd, Values qdd, Values lam)
{
  const Index nv = qdd.size, nc = lam.size;
  const Values & health = work.health;
  DenseVector beside = DenseVector::Zero(nc), near(q.size), near_rate(nv);
  DenseVector total = DenseVector::Zero(nv), inner = DenseVector::Zero(nv);
  DenseVector found(nv), forces(nc);
  update(model, work, Responses::NONE);
  for (Index k = 0; k < nc; ++k) {
    work.right[k] = -baumgarte * (2.0 * work.closure_rate[k] + baumgarte * work.closure[k]);
  }
  to_user_order(model, work.right, view(beside));
  DenseMatrix applied = forces_on_bodies(work);
  health[health::RANK_REVEALING_COUNT] += 1.0;
  const double speed = fastest(work);
  double size = 0.0, levers = 0.0;
  Rank rank = solve_here(model, work, tau, beside, view(found), view(forces), size);
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
  // An ordinary place, repeated equations aside, or nothing moves.
  if (!((close || (here < nc && health[health::LOOKED_BESIDE] == 0.0)) && speed > 0.0)) {
    return;
  }
  outward(model, q, qd, work);
  applied -= forces_on_bodies(work);
  // Solve on the branch, so far ahead of the state; return whether it is on the branch.
  const auto solve_ahead = [&](double ahead) {
      near = dense(q);
      near_rate = dense(qd);
      move(manifold, view(near), qd, ahead);
      const double error = return_to_branch(
        model, work, manifold, view(near), view(near_rate), size);
      outward(model, view(near), view(near_rate), work);
      add_forces(work, applied);
      rank = solve_here(model, work, tau, beside, view(found), view(forces), levers);
      return error <= SETTLED * size;
    };
  const auto leave_as_found = [&]() {
      outward(model, q, qd, work);
      update(model, work, Responses::NONE);
      add_forces(work, applied);
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
    // On the branch only: beside it equations that repeat one another seem not to.
    if (settled) {
      health[health::LOOKED_BESIDE] = 1.0;
      health[health::MOST_DISTINCT] =
        std::max(health[health::MOST_DISTINCT], static_cast<double>(rank.distinct));
    }
    // No branch there, or none that leads out of here, or equations that are repeated there, too:
    // what was found first must do.
    if (!close && static_cast<double>(here) < health[health::MOST_DISTINCT]) {
      close = true;
      health[health::SINGULAR_COUNT] += 1.0;
    }
    if (!(close && settled)) {
      break;
    }
    if (rank.distinct > few) {
      // What vanished at the state.
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

}  // namespace closedloop
