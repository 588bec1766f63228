// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "null_space.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace closedloop
{

namespace
{
// Singular values of the scaled J below this times the largest are rounding: equations that
// repeat others.
constexpr double DEPENDENT = 1e-11;
// The right-hand side of an equation must exceed its estimated error by this factor.
constexpr double DOUBT = 3.0;
// Entries of J against the largest: less is the rounding of a zero, not to be scaled up.
constexpr double NOTHING = 1e-12;
// Inertia of a motion against the largest: less is none.
constexpr double NO_INERTIA = 1e-14;
// Singular values below this times the largest belong to equations that repeat others.
constexpr double REPEATED = 1e-9;

/// Scaled singular vectors of J, and which of them are taken.
struct Decomposition
{
  DenseMatrix left, right;  ///< Columns
  DenseVector singular, wanted;
  std::vector<bool> taken;
};

/// Motion of the equations taken, and in the directions left the one of least constraint; false
/// where one without inertia is pushed.
bool solve_motion(
  const Decomposition & found, const DenseVector & column_scale, const DenseEquations & equations,
  Eigen::Map<DenseVector> out)
{
  const Index nv = equations.gim.rows(), count = found.singular.size();
  DenseVector strong = DenseVector::Zero(nv);
  std::vector<Index> free;
  for (Index k = 0; k < nv; ++k) {
    if (k < count && found.taken[k]) {
      strong += found.right.col(k) * (found.wanted[k] / found.singular[k]);
    } else {
      free.push_back(k);
    }
  }
  strong = strong.cwiseProduct(column_scale);
  out = strong;
  const Index freedoms = static_cast<Index>(free.size());
  if (freedoms == 0) {
    return true;
  }
  DenseMatrix basis(freedoms, nv);
  for (Index k = 0; k < freedoms; ++k) {
    basis.row(k) = found.right.col(free[k]).cwiseProduct(column_scale).transpose();
  }
  DenseMatrix inertia = basis * (equations.gim * basis.transpose());
  DenseVector push = basis * (equations.force - equations.gim * strong);
  DenseVector root = DenseVector::Ones(freedoms);
  for (Index k = 0; k < freedoms; ++k) {
    if (inertia(k, k) > 0.0) {
      root[k] = 1.0 / std::sqrt(inertia(k, k));
    }
  }
  inertia = root.asDiagonal() * inertia * root.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<DenseMatrix> eigen(inertia);
  const auto & values = eigen.eigenvalues();
  push = eigen.eigenvectors().transpose() * push.cwiseProduct(root);
  bool determined = true;
  const double largest_push = push.cwiseAbs().maxCoeff();
  for (Index k = 0; k < freedoms; ++k) {
    if (values[k] > NO_INERTIA * values[freedoms - 1]) {
      push[k] /= values[k];
    } else {
      determined = determined && std::abs(push[k]) <= 1e-9 * largest_push;
      push[k] = 0.0;
    }
  }
  out += basis.transpose() * (eigen.eigenvectors() * push).cwiseProduct(root);
  return determined;
}

/// Whether a weak equation's residual can be told from its estimated error.
bool is_worth_taking(
  Level level, double singular, double residual, double gap, double drift, double gap_along,
  double drift_along, double speed, double size)
{
  if (level == Level::POSITION) {
    return residual <= 0.25 * singular * singular;
  }
  gap_along += ROUNDING;
  const double known = gap + std::min(gap_along / singular, std::sqrt(gap_along));
  double error = speed * known + ROUNDING * (speed + size);
  if (level == Level::ACCELERATION) {
    error = speed * (speed * known + 2.0 * (drift + drift_along / singular)) + ROUNDING * (
      speed * speed + size);
  }
  return residual > DOUBT * error;
}

/// Remove from the multipliers what the equations left out would not notice.
void make_least(const Decomposition & found, const DenseVector & row_scale,
  Eigen::Map<DenseVector> lam)
{
  const Index nc = lam.size(), count = found.singular.size();
  DenseMatrix idle(nc, nc);
  Index columns = 0;
  for (Index k = 0; k < nc; ++k) {
    if (k >= count || !found.taken[k]) {
      idle.col(columns++) = found.left.col(k).cwiseProduct(row_scale);
    }
  }
  const DenseMatrix basis = idle.leftCols(columns);
  lam -= basis * basis.colPivHouseholderQr().solve(DenseVector(lam));
}
/// The rows of a matrix that are kept.
DenseMatrix rows_of(const Eigen::Map<DenseMatrix> & all, Indices kept, Index count)
{
  DenseMatrix rows(count, all.cols());
  Index next = 0;
  for (Index row = 0; row < kept.size; ++row) {
    if (kept[row]) {
      rows.row(next++) = all.row(row);
    }
  }
  return rows;
}

/// The least solution of least squares.
void solve_least(const Eigen::MatrixXd & matrix, const DenseVector & right, Values out)
{
  if (!(matrix.allFinite() && right.allFinite())) {
    out.fill(std::numeric_limits<double>::quiet_NaN());
    return;
  }
  Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd> decomposition;
  decomposition.setThreshold(REPEATED);
  decomposition.compute(matrix);
  dense(out) = decomposition.solve(right);
}
}  // namespace

void scales(
  const Model & model, const DenseMatrix & jac, DenseVector & row_scale,
  DenseVector & column_scale)
{
  const Index nv = jac.cols();
  const Indexes & tree = model.tree, & cut = model.cut;
  DenseVector lever = DenseVector::Zero(nv);
  double longest = 0.0;
  for (Index a = 0; a < cut.rows; ++a) {
    const Index first = cut(a, cut::CUT_ROW), last = first + cut(a, cut::LENGTHS);
    double here = 0.0;
    for (Index body = 1; body < tree.rows; ++body) {
      if (tree(body, tree::TYPE) != tree::PRISMATIC) {
        for (Index i = first; i < last; ++i) {
          here = std::max(here, std::abs(jac(i, tree(body, tree::DOF))));
        }
      }
    }
    longest = std::max(longest, here);
    for (Index i = first; i < last; ++i) {
      for (Index j = 0; j < nv; ++j) {
        if (std::abs(jac(i, j)) > NOTHING * here) {
          lever[j] = std::max(lever[j], here);
        }
      }
    }
  }
  for (Index body = 1; body < tree.rows; ++body) {
    const Index j = tree(body, tree::DOF);
    if (tree(body, tree::TYPE) == tree::PRISMATIC) {
      lever[j] = 1.0;
    } else if (lever[j] == 0.0) {
      lever[j] = longest > 0.0 ? longest : 1.0;
    }
    column_scale[j] = 1.0 / lever[j];
  }
  for (Index a = 0; a < cut.rows; ++a) {
    const Index first = cut(a, cut::CUT_ROW), together = cut(a, cut::LENGTHS);
    const Index ends[3] = {first, first + together, first + cut(a, cut::ROWS)};
    for (int group = 0; group < 2; ++group) {
      double most = 0.0;
      for (Index i = ends[group]; i < ends[group + 1]; ++i) {
        for (Index j = 0; j < nv; ++j) {
          most = std::max(most, std::abs(jac(i, j)) * column_scale[j]);
        }
      }
      for (Index i = ends[group]; i < ends[group + 1]; ++i) {
        row_scale[i] = most > NOTHING ? 1.0 / most : 1.0;
      }
    }
  }
}

Rank solve(
  const Model & model, const DenseEquations & equations, double speed, Level level,
  Values motion_out, Values lam_out)
{
  const Index nc = equations.jac.rows(), nv = equations.jac.cols();
  Eigen::Map<DenseVector> motion = dense(motion_out), lam = dense(lam_out);
  DenseVector row_scale = DenseVector::Ones(nc), column_scale = DenseVector::Ones(nv);
  scales(model, equations.jac, row_scale, column_scale);
  const DenseMatrix scaled = row_scale.asDiagonal() * equations.jac * column_scale.asDiagonal();
  Rank rank;
  if (!(scaled.allFinite() && equations.right.allFinite() && equations.force.allFinite() &&
    equations.gim.allFinite()))
  {
    motion.setConstant(std::numeric_limits<double>::quiet_NaN());
    lam.setConstant(std::numeric_limits<double>::quiet_NaN());
    return rank;
  }
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(scaled, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Decomposition found{svd.matrixU(), svd.matrixV(), svd.singularValues(), {}, {}};
  const Index count = found.singular.size();
  const double strongest = count > 0 ? found.singular[0] : 0.0;
  found.wanted = found.left.transpose() * equations.right.cwiseProduct(row_scale);
  found.taken.resize(count);
  for (Index k = 0; k < count; ++k) {
    found.taken[k] = found.singular[k] > WEAK * strongest;
  }
  bool determined = solve_motion(found, column_scale, equations, motion);
  const DenseVector psi = equations.psi.cwiseProduct(row_scale);
  const DenseVector rate = equations.rate.cwiseProduct(row_scale);
  const double gap = (nc > 0 ? psi.cwiseAbs().maxCoeff() : 0.0) + ROUNDING;
  const double drift = nc > 0 ? rate.cwiseAbs().maxCoeff() : 0.0;
  const DenseVector scaled_motion = motion.cwiseQuotient(column_scale);
  const double size = scaled_motion.cwiseAbs().maxCoeff();
  bool added = false;
  for (Index k = 0; k < count; ++k) {
    const double singular = found.singular[k];
    if (!(singular > DEPENDENT * strongest)) {
      continue;
    }
    rank.weakest = singular;
    ++rank.distinct;
    if (!found.taken[k]) {
      double residual = found.wanted[k];
      if (level != Level::POSITION) {
        residual -= singular * found.right.col(k).dot(scaled_motion);
      }
      if (is_worth_taking(
          level, singular, std::abs(residual), gap, drift, std::abs(found.left.col(k).dot(psi)),
          std::abs(found.left.col(k).dot(rate)), speed, size))
      {
        found.taken[k] = true;
        added = true;
      }
    }
  }
  if (added) {
    determined = solve_motion(found, column_scale, equations, motion);
  }
  if (!determined) {
    motion.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  const DenseVector need =
    (equations.gim * motion - equations.force).cwiseProduct(column_scale);
  lam.setZero();
  for (Index k = 0; k < count; ++k) {
    if (found.taken[k]) {
      ++rank.taken;
      const double share = found.right.col(k).dot(need) / found.singular[k];
      lam += share * found.left.col(k).cwiseProduct(row_scale);
    }
  }
  if (rank.taken < nc && determined) {
    make_least(found, row_scale, lam);
  }
  return rank;
}

void multipliers_of_kept(Table jac, Values lam, Indices kept, Values out)
{
  const auto all = dense(jac);
  solve_least(rows_of(all, kept, out.size).transpose(), all.transpose() * dense(lam), out);
}

}  // namespace closedloop
