// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "assembly.hpp"

#include <Eigen/Dense>

#include <algorithm>

#include "least_squares.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
using Square = Eigen::MatrixXd;
// Diagonal entries of R, against the first, above which equations are certainly independent.
constexpr double PLAIN = 1e-3;
// Smallest velocity ratio of a joint in the loops, against the largest, that is not rounding.
constexpr double NO_LEVER = 1e-12;
constexpr int MOST_CORRECTIONS = 50, MOST_HALVINGS = 30;

/// Columns of the free coordinates; with `rows`, their rows only.
Square of_free(Table from, Indices free, bool rows)
{
  Square found(rows ? free.size : from.rows, free.size);
  for (Index i = 0; i < found.rows(); ++i) {
    for (Index j = 0; j < free.size; ++j) {
      found(i, j) = from(rows ? free[i] : i, free[j]);
    }
  }
  return found;
}

/// The x with J x = psi that is least in the metric L L^T; false where equations may depend on one
/// another.
bool least_change(const Square & jac, const DenseVector & psi, const Square & root, DenseVector & x)
{
  const Index rows = jac.rows(), columns = jac.cols();
  DenseVector lever = jac.cwiseAbs().colwise().maxCoeff();
  const double longest = lever.maxCoeff();
  lever = (lever.array() > NO_LEVER * longest).select(lever, 1.0).eval();
  PivotedQr factor;
  factor.compute((jac * lever.cwiseInverse().asDiagonal()).transpose());
  const Square & packed = factor.packed();
  if (!(std::abs(packed(rows - 1, rows - 1)) > PLAIN * std::abs(packed(0, 0)))) {
    return false;
  }
  DenseVector share = DenseVector::Zero(columns);
  share.head(rows) = packed.topRows(rows).triangularView<Eigen::Upper>().transpose().solve(
    factor.order().transpose() * psi);
  factor.turn(share);
  x = share.cwiseQuotient(lever);
  if (columns > rows) {
    // Inertia in the null space of the equations.
    Square open = Square::Zero(columns, columns - rows);
    open.bottomRows(columns - rows).setIdentity();
    factor.turn(open);
    open = lever.cwiseInverse().asDiagonal() * open;
    PivotedQr weighed;
    weighed.compute(root.transpose() * open);
    x -= open * weighed.solve(root.transpose() * x);
  }
  return x.allFinite();
}
}  // namespace

bool close_loops(
  const Model & model, const Workspace & work, const Manifold & manifold, Table jac, Table gim,
  Values q, Indices free, double closed, double limit)
{
  const Index nc = jac.rows, nv = jac.columns;
  if (nc == 0 || nc > free.size) {
    return false;
  }
  DenseVector present = dense(q), rates = DenseVector::Zero(nv), psi(nc), error(nc), x;
  DenseVector change = DenseVector::Zero(nv);
  const auto place = [&](const DenseVector & from, DenseVector & found) {
      dense(q) = from;
      outward(model, q, view(rates), work);
      update(model, work, Responses::NONE);
      to_user_order(model, work.closure, view(found));
    };
  place(present, psi);
  Square root;
  if (nc < free.size) {
    generalized_inertia_matrix(model, work, gim);
    const Eigen::LLT<Square> metric(of_free(gim, free, true));
    if (metric.info() != Eigen::Success) {
      return false;
    }
    root = metric.matrixL();
  }
  for (int n = 0; n < MOST_CORRECTIONS; ++n) {
    if (psi.cwiseAbs().maxCoeff() <= 0.01 * closed) {
      break;
    }
    // The metric has used up the bodies' inertias, and trials have moved them.
    place(present, psi);
    constraint_jacobian(model, work, jac);
    if (!least_change(of_free(jac, free, false), psi, root, x)) {
      return false;
    }
    const double largest = x.cwiseAbs().maxCoeff();
    x *= largest > limit ? limit / largest : 1.0;
    bool better = false;
    DenseVector trial;
    for (int halving = 0; halving < MOST_HALVINGS && !better; ++halving) {
      for (Index i = 0; i < free.size; ++i) {
        change[free[i]] = -x[i];
      }
      dense(q) = present;
      move(manifold, q, view(change), 1.0);
      trial = dense(q);
      place(trial, error);
      better = error.norm() < psi.norm();
      x *= 0.5;
    }
    if (!better) {
      break;
    }
    present = trial;
    psi = error;
  }
  dense(q) = present;
  return psi.cwiseAbs().maxCoeff() <= closed;
}

}  // namespace closedloop
