// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "null_space.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <limits>

#include "least_squares.hpp"
#include "scratch.hpp"

namespace closedloop
{

namespace
{
// Singular values of the scaled J below this times the largest are rounding, of redundant
// equations.
constexpr double DEPENDENT = 1e-11;
// The right-hand side of an equation must exceed its estimated error by this factor.
constexpr double DOUBT = 3.0;
// Entries of J against the largest: less is the rounding of a zero, not to be scaled up.
constexpr double NOTHING = 1e-12;
// Shortest lever of a cut joint's equations that others are compared with, against the size of its
// loop: all of them are rounding where the equations hold anyway.
constexpr double SHORTEST = 1e-3;
// Inertia of a motion, against the largest, below which it is zero.
constexpr double NO_INERTIA = 1e-14;
// Square roots of pivots above which all motions certainly have inertia.
constexpr double CLEAR = 1e-3;
// Singular values below this times the largest belong to redundant equations.
constexpr double REPEATED = 1e-9;
// Numbers that fit on the stack.
constexpr Index NUMBERS = 64;

/// Components of a solution along the singular vectors of J, and the equations that are used.
template<int Most>
struct Choice
{
  typename Sized<Most>::Vector wanted;
  Eigen::Array<bool, Eigen::Dynamic, 1, Eigen::ColMajor, Most, 1> taken;
};

/// Motion by the equations used and, in the remaining directions, by Gauss's least constraint;
/// false where a force acts on a motion without inertia.
template<int Most>
bool solve_motion(
  const Decomposition<Most> & place, const Choice<Most> & choice,
  const DenseEquations<Most> & equations, Eigen::Map<DenseVector> out)
{
  using Matrix = typename Sized<Most>::Matrix;
  using Vector = typename Sized<Most>::Vector;
  const auto & right = place.singular.matrixV();
  const auto & singular = place.singular.singularValues();
  const Index nv = place.gim.rows(), count = singular.size();
  const Index freedoms = nv - choice.taken.count();
  Vector strong = Vector::Zero(nv);
  Matrix basis(freedoms, nv);
  Index row = 0;
  for (Index k = 0; k < nv; ++k) {
    if (k < count && choice.taken[k]) {
      strong += right.col(k) * (choice.wanted[k] / singular[k]);
    } else {
      basis.row(row++) = right.col(k).cwiseProduct(place.column_scale).transpose();
    }
  }
  strong = strong.cwiseProduct(place.column_scale);
  out = strong;
  if (freedoms == 0) {
    return true;
  }
  const Matrix carried = place.gim * basis.transpose();
  Matrix inertia = basis * carried;
  const Vector left = equations.force - place.gim * strong;
  Vector push = basis * left;
  Vector root = Vector::Ones(freedoms);
  for (Index k = 0; k < freedoms; ++k) {
    if (inertia(k, k) > 0.0) {
      root[k] = 1.0 / std::sqrt(inertia(k, k));
    }
  }
  inertia = root.asDiagonal() * inertia * root.asDiagonal();
  const Eigen::LLT<Matrix> factor(inertia);
  if (factor.info() == Eigen::Success && factor.matrixLLT().diagonal().minCoeff() > CLEAR) {
    push = factor.solve(push.cwiseProduct(root)).cwiseProduct(root).eval();
    out += basis.transpose() * push;
    return true;
  }
  const Eigen::SelfAdjointEigenSolver<Matrix> eigen(inertia);
  const auto & values = eigen.eigenvalues();
  push = (eigen.eigenvectors().transpose() * push.cwiseProduct(root)).eval();
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

/// Whether a weak equation's residual exceeds its estimated error.
bool is_worth_taking(
  Level level, double singular, double residual, double gap, double drift, double gap_along,
  double drift_along, double speed, double size)
{
  if (level == Level::POSITION) {
    return residual <= 0.25 * singular * singular;
  }
  gap_along += ROUNDING;
  const double position_error = gap + std::min(gap_along / singular, std::sqrt(gap_along));
  double error = speed * position_error + ROUNDING * (speed + size);
  if (level == Level::ACCELERATION) {
    error = speed * (speed * position_error + 2.0 * (drift + drift_along / singular)) + ROUNDING * (
      speed * speed + size);
  }
  return residual > DOUBT * error;
}

/// Remove from the multipliers the components along the equations that are not used.
template<int Most>
void make_least(
  const Decomposition<Most> & place, const Choice<Most> & choice, Eigen::Map<DenseVector> lam)
{
  using Matrix = typename Sized<Most>::ByColumn;
  const Index nc = lam.size(), count = choice.taken.size();
  Matrix idle(nc, nc - choice.taken.count());
  Index column = 0;
  for (Index k = 0; k < nc; ++k) {
    if (k >= count || !choice.taken[k]) {
      idle.col(column++) = place.singular.matrixU().col(k).cwiseProduct(place.row_scale);
    }
  }
  typename Sized<Most>::Pivoted factor;
  factor.compute(idle);
  const typename Sized<Most>::Vector share = factor.solve(lam);
  lam -= idle * share;
}

/// Longest distance of two joints on one body of a cut joint's loop; 0 where there is none.
double loop_size(const Model & model, Index a)
{
  const Indexes & cut = model.cut;
  if (!model.parts(a).bodies) {
    return 0.0;
  }
  const Index size = model.gravity.size;
  const bool planar = size == 2;
  const double * point_a = model.cut_point.row(a), * point_b = point_a;
  point_a += planar ? static_cast<Index>(plane::A_X) : static_cast<Index>(space::POINT_A);
  point_b += planar ? static_cast<Index>(plane::B_X) : static_cast<Index>(space::POINT_B);
  Index i = cut(a, cut::BODY_A), k = cut(a, cut::BODY_B);
  double longest = 0.0, square = 0.0;
  // Inwards to the body that carries both; a parent has a smaller number than its children.
  while (i != k) {
    Index & outer = i > k ? i : k;
    const double * & point = i > k ? point_a : point_b;
    square = 0.0;
    for (Index n = 0; n < size; ++n) {
      square += point[n] * point[n];
    }
    longest = std::max(longest, square);
    point = model.body.row(outer) + (
      planar ? static_cast<Index>(plane::JOINT_X) : static_cast<Index>(space::PLACE));
    outer = model.tree(outer, tree::PARENT);
  }
  square = 0.0;
  for (Index n = 0; n < size; ++n) {
    square += (point_a[n] - point_b[n]) * (point_a[n] - point_b[n]);
  }
  return std::sqrt(std::max(longest, square));
}

double largest_loop(const Model & model)
{
  double largest = 0.0;
  for (Index a = 0; a < model.cut.rows; ++a) {
    largest = std::max(largest, loop_size(model, a));
  }
  return largest;
}

/// The same, given that of the largest loop; cut points a rounding error apart are in one place.
double loop_size(const Model & model, Index a, double largest)
{
  const double own = loop_size(model, a);
  return own > NOTHING * largest ? own : largest > 0.0 ? largest : 1.0;
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
  LeastSquares decomposition;
  decomposition.compute(matrix, REPEATED);
  dense(out) = decomposition.solve(right);
}
}  // namespace

void loop_units(const Model & model, Indices places, Table jac, Values rows, Values columns)
{
  const Indexes & tree = model.tree, & cut = model.cut;
  columns.fill(1.0);
  for (Index body = 1; body < tree.rows; ++body) {
    if (tree(body, tree::TYPE) == tree::PRISMATIC) {
      columns[tree(body, tree::DOF)] = 0.0;
    }
  }
  const double largest = largest_loop(model);
  for (Index a = 0; a < cut.rows; ++a) {
    const double size = loop_size(model, a, largest);
    for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_COMMON); ++entry) {
      const Index body = model.path_body[entry];
      if (tree(body, tree::TYPE) == tree::PRISMATIC) {
        double & slide = columns[tree(body, tree::DOF)];
        slide = std::max(slide, size);
      }
    }
    for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
      const Index row = cut(a, cut::CUT_ROW) + k;
      rows[row] = places[row] != 0 ? size : 1.0;
    }
  }
  for (double & column : columns) {
    column = column > 0.0 ? column : largest > 0.0 ? largest : 1.0;
  }
  for (Index a = 0; a < cut.rows; ++a) {
    if (!model.parts(a).joints) {
      continue;
    }
    const Index row = cut(a, cut::CUT_ROW);
    rows[row] = 0.0;
    for (Index j = 0; j < columns.size; ++j) {
      rows[row] = std::max(rows[row], std::abs(jac(row, j)) * columns[j]);
    }
    rows[row] = rows[row] > 0.0 ? rows[row] : 1.0;
  }
}

void scales(const Model & model, Table jac, Values row_scale, Values column_scale)
{
  const Indexes & tree = model.tree, & cut = model.cut;
  // Their inverses in the end.
  const Values & lever = column_scale;
  lever.fill(0.0);
  row_scale.fill(1.0);
  // The largest entries of the coordinates on a cut joint's path in its equations of lengths.
  Scratch<double, NUMBERS> scratch(model.path_body.size);
  const Values largest_on = scratch.take(model.path_body.size);
  const double largest = largest_loop(model);
  double longest = 0.0;
  for (Index a = 0; a < cut.rows; ++a) {
    const Index first = cut(a, cut::CUT_ROW), last = first + cut(a, cut::LENGTHS);
    const Index begin = cut(a, cut::PATH_A), end = cut(a, cut::PATH_END);
    double here = 0.0;
    for (Index entry = begin; entry < end; ++entry) {
      const Index body = model.path_body[entry], j = tree(body, tree::DOF);
      double most = 0.0;
      for (Index i = first; i < last; ++i) {
        most = std::max(most, std::abs(jac(i, j)));
      }
      largest_on[entry] = most;
      here = tree(body, tree::TYPE) == tree::PRISMATIC ? here : std::max(here, most);
    }
    if (!(here > SHORTEST * largest)) {
      // Only then it can be less than that of its own loop.
      here = std::max(here, SHORTEST * loop_size(model, a, largest));
    }
    longest = std::max(longest, here);
    for (Index entry = begin; entry < end; ++entry) {
      if (largest_on[entry] > NOTHING * here) {
        double & each = lever[tree(model.path_body[entry], tree::DOF)];
        each = std::max(each, here);
      }
    }
  }
  for (Index body = 1; body < tree.rows; ++body) {
    double & each = lever[tree(body, tree::DOF)];
    if (tree(body, tree::TYPE) == tree::PRISMATIC) {
      each = 1.0;
    } else if (each == 0.0) {
      each = longest > 0.0 ? longest : 1.0;
    }
    each = 1.0 / each;
  }
  for (Index a = 0; a < cut.rows; ++a) {
    const Index first = cut(a, cut::CUT_ROW), turns = first + cut(a, cut::LENGTHS);
    const Index last = first + cut(a, cut::ROWS);
    double most = 0.0, most_of_turns = 0.0;
    for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
      const Index j = tree(model.path_body[entry], tree::DOF);
      most = std::max(most, largest_on[entry] * column_scale[j]);
      for (Index i = turns; i < last; ++i) {
        most_of_turns = std::max(most_of_turns, std::abs(jac(i, j)) * column_scale[j]);
      }
    }
    const auto scale_rows = [&row_scale](Index begin, Index end, double size) {
        std::fill(row_scale.data + begin, row_scale.data + end, size > NOTHING ? 1.0 / size : 1.0);
      };
    scale_rows(first, turns, most);
    scale_rows(turns, last, most_of_turns);
  }
}

template<int Most>
void Decomposition<Most>::decompose(const Model & model, Table jac, Table inertia)
{
  using ByColumn = typename Sized<Most>::ByColumn;
  row_scale.resize(jac.rows);
  column_scale.resize(jac.columns);
  scales(
    model, jac, {row_scale.data(), row_scale.size()}, {column_scale.data(), column_scale.size()});
  gim = dense(inertia);
  const ByColumn scaled = row_scale.asDiagonal() * dense(jac) * column_scale.asDiagonal();
  largest = jac.rows > 0 ? dense(jac).cwiseAbs().maxCoeff() : 0.0;
  finite = scaled.allFinite() && gim.allFinite();
  if (finite) {
    singular.compute(scaled, Eigen::ComputeFullU | Eigen::ComputeFullV);
  }
}

template<int Most>
Rank solve(
  const Decomposition<Most> & place, const DenseEquations<Most> & equations, Index most,
  double speed, Level level, Values motion_out, Values lam_out)
{
  using Vector = typename Sized<Most>::Vector;
  Eigen::Map<DenseVector> motion = dense(motion_out), lam = dense(lam_out);
  const Vector & row_scale = place.row_scale, & column_scale = place.column_scale;
  const Index nc = row_scale.size();
  Rank rank;
  if (!(place.finite && equations.right.allFinite() && equations.force.allFinite())) {
    motion.setConstant(std::numeric_limits<double>::quiet_NaN());
    lam.setConstant(std::numeric_limits<double>::quiet_NaN());
    return rank;
  }
  const auto & left = place.singular.matrixU();
  const auto & right = place.singular.matrixV();
  const auto & values = place.singular.singularValues();
  const Index count = values.size(), independent = std::min(count, most);
  // Rows that anything moves have entries of 1: where all are less there is rounding alone.
  const double strongest = count > 0 ? std::max(values[0], 1.0) : 0.0;
  const Vector wanted = equations.right.cwiseProduct(row_scale);
  Choice<Most> choice;
  choice.wanted = left.transpose() * wanted;
  choice.taken = values.array() > WEAK * strongest;
  choice.taken.tail(count - independent) = false;
  bool determined = solve_motion(place, choice, equations, motion);
  const Vector psi = equations.psi.cwiseProduct(row_scale);
  const Vector rate = equations.rate.cwiseProduct(row_scale);
  const double gap = (nc > 0 ? psi.cwiseAbs().maxCoeff() : 0.0) + ROUNDING;
  const double drift = nc > 0 ? rate.cwiseAbs().maxCoeff() : 0.0;
  const Vector scaled_motion = motion.cwiseQuotient(column_scale);
  const double size = scaled_motion.cwiseAbs().maxCoeff();
  bool added = false;
  for (Index k = 0; k < independent; ++k) {
    const double singular = values[k];
    if (!(singular > DEPENDENT * strongest)) {
      continue;
    }
    rank.weakest = singular;
    ++rank.distinct;
    if (!choice.taken[k]) {
      double residual = choice.wanted[k];
      if (level != Level::POSITION) {
        residual -= singular * right.col(k).dot(scaled_motion);
      }
      if (is_worth_taking(
          level, singular, std::abs(residual), gap, drift, std::abs(left.col(k).dot(psi)),
          std::abs(left.col(k).dot(rate)), speed, size))
      {
        choice.taken[k] = true;
        added = true;
      }
    }
  }
  if (added) {
    determined = solve_motion(place, choice, equations, motion);
  }
  if (!determined) {
    motion.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  rank.taken = choice.taken.count();
  if (level != Level::ACCELERATION) {
    return rank;
  }
  const Vector missing = place.gim * motion - equations.force;
  const Vector need = missing.cwiseProduct(column_scale);
  lam.setZero();
  for (Index k = 0; k < count; ++k) {
    if (choice.taken[k]) {
      const double share = right.col(k).dot(need) / values[k];
      lam += share * left.col(k).cwiseProduct(row_scale);
    }
  }
  if (rank.taken < nc && determined) {
    make_least(place, choice, lam);
  }
  return rank;
}

template struct Decomposition<FEW>;
template struct Decomposition<Eigen::Dynamic>;
template Rank solve(
  const Decomposition<FEW> &, const DenseEquations<FEW> &, Index, double, Level, Values, Values);
template Rank solve(
  const Decomposition<Eigen::Dynamic> &, const DenseEquations<Eigen::Dynamic> &, Index, double,
  Level, Values, Values);

void multipliers_of_kept(Table jac, Values lam, Indices kept, Values out)
{
  const auto all = dense(jac);
  solve_least(rows_of(all, kept, out.size).transpose(), all.transpose() * dense(lam), out);
}

}  // namespace closedloop
