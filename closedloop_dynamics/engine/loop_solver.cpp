// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "loop_solver.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "interrupt.hpp"
#include "loop_closure.hpp"
#include "manifold.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
using Square = Eigen::MatrixXd;
using Place = Eigen::Vector3d;
using Axes = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

// Diagonal entries of R, against the first, above which equations are certainly independent.
constexpr double PLAIN = 1e-3;
// What a joint moves in the loops, in units: less is nothing.
constexpr double NO_LEVER = 1e-12;
constexpr int MOST_CORRECTIONS = 200, MOST_HALVINGS = 30, MOST_APPROACHES = 30;
// Last correction on the way to measured values, against the longest one.
constexpr double ROUNDING_OF_APPROACHES = 4e-13;
// Damping at first, within which bounds it stays, and after how many iterations the metric is taken
// again; corrections that are rounding, and decreases of the squared residual that lead nowhere.
constexpr double FIRST_DAMPING = 1e-2, LEAST_DAMPING = 1e-14, MOST_DAMPING = 1e12;
constexpr Index SAME_METRIC = 10;
constexpr double ROUNDING_STEP = 1e-14, STALLED = 1e-12, WIDE = 1e-6;
// Corrected rates that are rounding, against the fastest one before; how far others may open the
// loops, against what counts as closed.
constexpr double ROUNDING_OF_RATES = 1e-12, RATES_OPEN = 1e3;

/// Largest absolute value of a vector, 0 of an empty one.
double most(const DenseVector & values)
{
  return values.size() > 0 ? values.cwiseAbs().maxCoeff() : 0.0;
}

Place place(const double * from) {return {from[0], from[1], from[2]};}
}  // namespace

void Loops::check(const Manifold & manifold) const
{
  if (!manifold.empty() && !std::all_of(
      measured.begin(), measured.end(),
      [&](Index freedom) {return manifold.place[freedom] >= 0;}))
  {
    throw std::invalid_argument("loops: expected to measure coordinates that are one number each");
  }
}

void Far::check(const Model & model) const
{
  bool good = true;
  for (Index a = 0; good && a < axes.size; ++a) {
    good = axes[model.cut(a, cut::NUMBER)] == axis::NO_AXIS || (
      model.size() == 6 && model.cut(a, cut::TYPE) < cut::COUPLING);
  }
  for (Index k = 0; good && k < limits.rows; ++k) {
    good = limits(k, 0) >= 0.0 && limits(k, 1) >= 0.0 &&
      limits(k, 0) < static_cast<double>(model.coordinates()) &&
      limits(k, 1) < static_cast<double>(model.joints()) && limits(k, 2) <= limits(k, 3);
  }
  if (!good) {
    throw std::invalid_argument(
            "a search: expected axes of cut joints in space, and limits of coordinates");
  }
}

LoopSolver::LoopSolver(
  const Model & model, const Workspace & work, const Manifold & manifold, const Loops & loops,
  const Far & far)
: model_(model), work_(work), manifold_(manifold), loops_(loops), far_(far),
  still_(DenseVector::Zero(model.joints())), all_(model.equations()),
  residuals_(DenseVector::Zero(
      far.empty() ? loops.rows.size : far.unit.size + far.axes.size + far.limits.rows)),
  change_(DenseVector::Zero(model.joints())), ahead_(DenseVector::Zero(loops.free.size)),
  all_slopes_(model.equations(), model.joints())
{
  loops.check(manifold);
  far.check(model);
}

void LoopSolver::move_to(const DenseVector & q, const DenseVector & qd)
{
  here_ = q;
  rates_ = qd;
  outward(model_, view(here_), view(rates_), work_);
}

const DenseVector & LoopSolver::residuals_at(const DenseVector & q)
{
  move_to(q);
  update(model_, work_, Responses::NONE);
  return gather(work_.closure);
}

const DenseVector & LoopSolver::changes_at(
  const DenseVector & q, const DenseVector & qd, Level level)
{
  move_to(q, qd);
  update(model_, work_, Responses::NONE);
  return gather(level == Level::VELOCITY ? work_.closure_rate : work_.bias);
}

/// Numbers of the equations to be met, from those of all in elimination order, and what a search from
/// far away adds.
const DenseVector & LoopSolver::gather(Values ordered)
{
  to_user_order(model_, ordered, view(all_));
  if (far_.empty()) {
    for (Index i = 0; i < loops_.rows.size; ++i) {
      residuals_[i] = all_[loops_.rows[i]];
    }
    return residuals_;
  }
  residuals_.setZero();
  for (Index row : loops_.rows) {
    residuals_[row] = all_[row] / far_.unit[row];
  }
  for (Index a = 0; a < model_.cut.rows; ++a) {
    const Index number = model_.cut(a, cut::NUMBER), axes = far_.axes[number];
    residuals_[far_.unit.size + number] = axes == axis::NO_AXIS ? 0.0 : astray(a, axes);
  }
  for (Index k = 0; k < far_.limits.rows; ++k) {
    const double value = here_[static_cast<Index>(far_.limits(k, 0))];
    const double beyond = value - std::clamp(value, far_.limits(k, 2), far_.limits(k, 3));
    residuals_[far_.unit.size + far_.axes.size + k] =
      beyond / far_.scale[static_cast<Index>(far_.limits(k, 1))];
  }
  if (far_.target.size > 0) {
    residuals_ -= dense(far_.target);
  }
  return residuals_;
}

const DenseMatrix & LoopSolver::slopes()
{
  constraint_jacobian(model_, work_, view(all_slopes_));
  gather(work_.closure);
  slopes_.resize(residuals_.size(), model_.joints());
  if (far_.empty()) {
    for (Index i = 0; i < loops_.rows.size; ++i) {
      copy(view(all_slopes_)[loops_.rows[i]], view(slopes_)[i]);
    }
  } else {
    slopes_.setZero();
    for (Index row : loops_.rows) {
      slopes_.row(row) = all_slopes_.row(row) / far_.unit[row];
    }
    const Indexes & cut = model_.cut;
    for (Index a = 0; a < cut.rows; ++a) {
      const Index number = cut(a, cut::NUMBER);
      if (far_.axes[number] == axis::NO_AXIS) {
        continue;
      }
      astray(a, far_.axes[number]);
      respond(model_, work_, kernel::CARRY, a, 0);
      double * row = slopes_.row(far_.unit.size + number).data();
      for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
        row[model_.tree(model_.path_body[entry], tree::DOF)] = work_.response(entry, 0);
      }
      turn_spherical(model_.tree, work_.body, row, false);
    }
    for (Index k = 0; k < far_.limits.rows; ++k) {
      const Index row = far_.unit.size + far_.axes.size + k;
      const Index freedom = static_cast<Index>(far_.limits(k, 1));
      const double value = here_[static_cast<Index>(far_.limits(k, 0))];
      const bool beyond = value < far_.limits(k, 2) || value > far_.limits(k, 3);
      slopes_(row, freedom) = beyond ? 1.0 / far_.scale[freedom] : 0.0;
    }
  }
  jac_.resize(slopes_.rows(), loops_.free.size);
  for (Index j = 0; j < loops_.free.size; ++j) {
    jac_.col(j) = slopes_.col(loops_.free[j]);
  }
  return slopes_;
}

/// 1 less the cosines of the angles between axes that cut joint `a` keeps parallel, in space; with
/// the wrenches of the derivative, where `respond` finds them.
double LoopSolver::astray(Index a, Index axes)
{
  const double * point = model_.cut_point.row(a);
  const double * one = work_.body.row(model_.cut(a, cut::BODY_A));
  const double * other = work_.body.row(model_.cut(a, cut::BODY_B));
  const Axes frame_a = Eigen::Map<const Axes>(one + space::FRAME);
  const Axes frame_b = Eigen::Map<const Axes>(other + space::FRAME);
  const Axes axes_a = frame_a * Eigen::Map<const Axes>(point + space::TURNED_A);
  const Axes axes_b = frame_b * Eigen::Map<const Axes>(point + space::TURNED_B);
  double found = 0.0;
  Place turn = Place::Zero(), moment_a = turn, moment_b = turn, force = turn;
  const auto add = [&](const Place & axis, const Place & aim) {
      found += 1.0 - axis.dot(aim);
      turn -= axis.cross(aim);
    };
  add(axes_a.col(2), axes_b.col(2));
  if (axes == axis::ALL_AXES) {
    add(axes_a.col(0), axes_b.col(0));
    add(axes_a.col(1), axes_b.col(1));
  } else if (axes == axis::THREAD) {
    const Place x = axes_b.col(0), y = axes_b.col(1), z = axes_b.col(2);
    const Place at_a = frame_a * place(point + space::POINT_A);
    const Place at_b = frame_b * place(point + space::POINT_B);
    const Place gap = place(one + space::ORIGIN) + at_a - place(other + space::ORIGIN) - at_b;
    const double lead = point[space::LENGTH], turned = z.dot(gap) / lead;
    add(axes_a.col(0), std::cos(turned) * x + std::sin(turned) * y);
    // The side of the screw is to turn as it slides.
    force = z * (-axes_a.col(0).dot(std::cos(turned) * y - std::sin(turned) * x) / lead);
    moment_a = at_a.cross(force);
    moment_b = force.cross(at_b + gap);
  }
  Eigen::Map<Eigen::VectorXd> wrenches(work_.equation.data + 3, 12);
  wrenches << turn + moment_a, force, moment_b - turn, -force;
  return found;
}

void LoopSolver::take_metric_at(const DenseVector & q)
{
  metric_place_ = q;
  has_metric_ = false;
}

/// The change of free coordinates, or rates, that leads to the values of the measured ones.
void LoopSolver::aim_from(const DenseVector & present, bool rates)
{
  for (Index k = 0; k < loops_.free.size; ++k) {
    for (Index n = 0; n < loops_.measured.size; ++n) {
      const Index freedom = loops_.measured[n];
      if (loops_.free[k] == freedom) {
        const Index place = rates || manifold_.empty() ? freedom : manifold_.place[freedom];
        ahead_[k] = loops_.values[n] - present[place];
      }
    }
  }
}

bool LoopSolver::find_metric()
{
  if (has_metric_) {
    return true;
  }
  if (loops_.weight.size > 0) {
    root_ = Square::Zero(loops_.free.size, loops_.free.size);
    for (Index i = 0; i < loops_.free.size; ++i) {
      root_(i, i) = std::sqrt(loops_.weight[loops_.free[i]]);
    }
    return has_metric_ = true;
  }
  parts_ |= part::MASSES;
  const DenseVector present = here_;
  move_to(metric_place_);
  DenseMatrix all(model_.joints(), model_.joints());
  generalized_inertia_matrix(model_, work_, view(all));
  move_to(present);
  const Index count = loops_.free.size;
  DenseVector scale = DenseVector::Ones(count);
  for (Index i = 0; i < count && !far_.empty(); ++i) {
    scale[i] = far_.scale[loops_.free[i]];
  }
  Square inertia(count, count);
  for (Index i = 0; i < count; ++i) {
    for (Index j = 0; j < count; ++j) {
      inertia(i, j) = all(loops_.free[i], loops_.free[j]) * scale[i] * scale[j];
    }
  }
  const double largest = count > 0 ? inertia.diagonal().maxCoeff() : 0.0;
  inertia /= largest > 0.0 ? largest : 1.0;
  inertia.diagonal().array() += loops_.least;
  const Eigen::LLT<Square> factor(inertia);
  root_ = scale.cwiseInverse().asDiagonal() * Square(factor.matrixL());
  has_metric_ = factor.info() == Eigen::Success && root_.allFinite();
  if (!has_metric_) {
    parts_ |= part::NO_METRIC;
  }
  return has_metric_;
}

/// Add to `x` what makes it shortest in the metric, or -x nearest to the change ahead, along the
/// columns of `open`.
bool LoopSolver::shorten(const Square & open, DenseVector & x)
{
  if (!find_metric()) {
    return false;
  }
  PivotedQr weighed;
  weighed.compute(root_.transpose() * open);
  x -= open * weighed.solve(root_.transpose() * (x + ahead_));
  return true;
}

bool LoopSolver::least_change(const DenseVector & error, DenseVector & x)
{
  const Index rows = jac_.rows(), columns = jac_.cols();
  x = DenseVector::Zero(columns);
  if (rows == 0 || columns == 0) {
    parts_ |= rows > 0 ? static_cast<Index>(part::DEPENDENT) : 0;
    return !is_aimed() || shorten(Square::Identity(columns, columns), x);
  }
  if (!jac_.allFinite() || !error.allFinite()) {
    return false;
  }
  // Which equations depend on others is decided on levers alone: in the mass metric those that move
  // a light body all look alike. What they leave open is decided by the masses.
  DenseVector all_rows(all_slopes_.rows()), all_columns(all_slopes_.cols());
  loop_units(model_, loops_.places, view(all_slopes_), view(all_rows), view(all_columns));
  DenseVector unit(rows), length(columns);
  for (Index i = 0; i < rows; ++i) {
    unit[i] = all_rows[loops_.rows[i]];
  }
  for (Index j = 0; j < columns; ++j) {
    length[j] = all_columns[loops_.free[j]];
  }
  Square scaled = unit.cwiseInverse().asDiagonal() * jac_ * length.asDiagonal();
  DenseVector lever = scaled.cwiseAbs().colwise().maxCoeff();
  lever = (lever.array() > NO_LEVER).select(lever, 1.0).eval();
  scaled *= lever.cwiseInverse().asDiagonal();
  length = length.cwiseQuotient(lever);
  const DenseVector right = error.cwiseQuotient(unit);
  if (rows <= columns && lever.minCoeff() > PLAIN) {
    PivotedQr factor;
    factor.compute(scaled.transpose());
    const Square & packed = factor.packed();
    if (std::abs(packed(rows - 1, rows - 1)) > PLAIN * std::max(std::abs(packed(0, 0)), 1.0)) {
      x.head(rows) = packed.topRows(rows).triangularView<Eigen::Upper>().transpose().solve(
        factor.order().transpose() * right);
      factor.turn(x);
      x = x.cwiseProduct(length);
      if (columns == rows) {
        sign_ = factor.order().determinant();
        for (Index k = 0; k < rows; ++k) {
          sign_ = packed(k, k) < 0.0 ? -sign_ : sign_;
        }
        return x.allFinite();
      }
      // Inertia in the null space of the equations.
      Square open = Square::Zero(columns, columns - rows);
      open.bottomRows(columns - rows).setIdentity();
      factor.turn(open);
      return shorten(length.asDiagonal() * open, x) && x.allFinite();
    }
  }
  parts_ |= part::DEPENDENT;
  LargeSingular found;
  found.compute(scaled, Eigen::ComputeThinU | Eigen::ComputeFullV);
  const DenseVector & singular = found.singularValues();
  const Index rank = (singular.array() > loops_.tolerance * std::max(singular[0], 1.0)).count();
  x = length.asDiagonal() * (found.matrixV().leftCols(rank) * (
      found.matrixU().leftCols(rank).transpose() * right).cwiseQuotient(singular.head(rank)));
  return rank == columns ||
         shorten(length.asDiagonal() * found.matrixV().rightCols(columns - rank), x);
}

DenseVector LoopSolver::moved(const DenseVector & q, const DenseVector & x)
{
  for (Index j = 0; j < loops_.free.size; ++j) {
    change_[loops_.free[j]] = x[j];
  }
  DenseVector found = q;
  move(manifold_, view(found), view(change_), 1.0);
  return found;
}

bool LoopSolver::correct_rates(DenseVector & rates, const DenseVector & wanted)
{
  const double rounding = ROUNDING_OF_RATES * most(rates);
  if (loops_.free.size < rates.size()) {
    for (Index j : loops_.free) {
      rates[j] = 0.0;
    }
  }
  DenseVector x;
  aim_from(rates, true);
  if (!least_change(slopes_ * rates - wanted, x)) {
    return false;
  }
  for (Index k = 0; k < loops_.free.size; ++k) {
    double & rate = rates[loops_.free[k]];
    rate -= x[k];
    // Rounding of rates that are not possible is no motion.
    rate = std::abs(rate) <= rounding ? 0.0 : rate;
  }
  return true;
}

void LoopSolver::correct(DenseVector & q, double goal)
{
  DenseVector error = residuals_at(q), x, trial;
  for (int n = 0; n < MOST_CORRECTIONS && most(error) > goal; ++n) {
    slopes_at(q);
    if (!least_change(error, x)) {
      return;
    }
    x *= -std::min(1.0, loops_.limit / std::max(most(x), loops_.limit));
    bool better = false;
    for (int halving = 0; halving < MOST_HALVINGS && !better; ++halving) {
      trial = moved(q, x);
      better = residuals_at(trial).norm() < error.norm();
      x *= 0.5;
    }
    if (!better) {
      return;
    }
    q = trial;
    error = residuals_;
  }
}

void LoopSolver::approach(DenseVector & q)
{
  DenseVector x;
  double last = 0.0;
  for (int n = 0; n < MOST_APPROACHES; ++n) {
    slopes_at(q);
    aim_from(q, false);
    if (!least_change(residuals_, x) || !x.allFinite()) {
      return;
    }
    const double longest = most(x);
    x *= -std::min(1.0, loops_.limit / std::max(longest, loops_.limit));
    q = moved(q, x);
    // The next one will be as much shorter as this one is.
    const double shorter = longest < last ? longest / last : 1.0;
    if (longest * shorter <= ROUNDING_OF_APPROACHES * loops_.limit) {
      return;
    }
    last = longest;
  }
}

void LoopSolver::search(DenseVector & q, double goal, Index most_iterations)
{
  double damping = FIRST_DAMPING, growth = 2.0;
  const Index count = loops_.free.size;
  if (count == 0) {
    // Nothing may move.
    return;
  }
  DenseVector scale = DenseVector::Ones(count);
  for (Index j = 0; j < count && !far_.empty(); ++j) {
    scale[j] = far_.scale[loops_.free[j]];
  }
  slopes_at(q);
  DenseVector residuals = residuals_;
  PivotedQr damped;
  for (Index n = 0; n < most_iterations && most(residuals) > goal; ++n) {
    if (n % SAME_METRIC == 0) {
      take_metric_at(q);
      if (!find_metric()) {
        return;
      }
    }
    Square stacked(jac_.rows() + count, count);
    stacked << jac_, std::sqrt(damping) * root_.transpose();
    DenseVector right = DenseVector::Zero(stacked.rows());
    right.head(jac_.rows()) = -residuals;
    damped.compute(stacked);
    DenseVector x = damped.solve(right);
    const double longest = most(x.cwiseQuotient(scale));
    if (!(longest > ROUNDING_STEP) || !x.allFinite()) {
      return;
    }
    x *= std::min(1.0, loops_.limit / longest);
    const DenseVector trial = moved(q, x);
    const double before = residuals.squaredNorm(), after = residuals_at(trial).squaredNorm();
    const double expected = before - (residuals + jac_ * x).squaredNorm();
    const double gain = expected > 0.0 ? (before - after) / expected : -1.0;
    if (gain > 0.0) {
      q = trial;
      slopes_at(q);
      residuals = residuals_;
      damping = std::max(
        LEAST_DAMPING, damping * std::max(0.1, 1.0 - std::pow(2.0 * gain - 1.0, 3)));
      growth = 2.0;
      if (before - after < STALLED * before && before > WIDE) {
        return;
      }
    } else {
      damping *= growth;
      growth *= 2.0;
      if (damping > MOST_DAMPING) {
        return;
      }
    }
  }
}

Index close_loops(
  const Model & model, const Workspace & work, const Manifold & manifold, Values q,
  const Loops & loops, double closed, double enough)
{
  LoopSolver solver(model, work, manifold, loops);
  const DenseVector start = dense(q);
  solver.begin(start);
  if (loops.measured.size > 0) {
    DenseVector found = start;
    solver.approach(found);
    dense(q) = found;
    return solver.parts();
  }
  if (most(solver.residuals_at(start)) <= closed) {
    return 0;
  }
  DenseVector found = start;
  solver.correct(found, 0.01 * closed);
  const DenseVector & left = solver.residuals_at(found);
  if (left.allFinite() && most(left) > enough && (solver.parts() & part::NO_METRIC) == 0) {
    found = start;
    solver.search(found, 0.01 * closed, MOST_CORRECTIONS);
  }
  dense(q) = found;
  return solver.parts();
}

Index close_rates(
  const Model & model, const Workspace & work, const Manifold & manifold, Values q, Values qd,
  const Loops & loops, Values wanted)
{
  LoopSolver solver(model, work, manifold, loops);
  const DenseVector here = dense(q);
  solver.begin(here);
  solver.slopes_at(here);
  DenseVector rates = dense(qd);
  const bool good = solver.correct_rates(rates, dense(wanted));
  dense(qd) = rates;
  return good ? solver.parts() : solver.parts() | part::NO_METRIC;
}

Index search_loops(
  const Model & model, const Workspace & work, const Manifold & manifold, Values q,
  const Loops & loops, const Far & far, double goal, Index most)
{
  LoopSolver solver(model, work, manifold, loops, far);
  DenseVector found = dense(q);
  solver.search(found, goal, most);
  dense(q) = found;
  return solver.parts();
}

void loop_residuals(
  const Model & model, const Workspace & work, const Manifold & manifold, Values q,
  const Loops & loops, const Far & far, Values residuals, Table slopes)
{
  LoopSolver solver(model, work, manifold, loops, far);
  dense(slopes) = solver.slopes_at(dense(q));
  dense(residuals) = solver.residuals_at(dense(q));
}

bool close_states(
  const Model & model, const Workspace & work, const Manifold & manifold, Table q, Table qd,
  const Loops & loops, double closed, Indices status, bool (* interrupted)())
{
  Interrupt interrupt(interrupted, model.joints());
  LoopSolver solver(model, work, manifold, loops);
  DenseVector rates, x;
  for (Index k = 0; k < q.rows; ++k) {
    // Its evaluations cost less than its factors.
    if (interrupt.after(20)) {
      return false;
    }
    status[k] = closing::BY_ITSELF;
    DenseVector found = dense(q[k]);
    solver.begin(found);
    solver.slopes_at(found);
    if (!solver.least_change(solver.residuals_at(found), x) || solver.is_dependent()) {
      continue;
    }
    const double before = solver.sign();
    if (most(solver.residuals_at(found)) > closed) {
      solver.correct(found, 0.01 * closed);
    }
    const DenseMatrix & slopes = solver.slopes_at(found);
    if (!solver.least_change(solver.residuals_at(found), x) || solver.is_dependent() ||
      !(most(solver.residuals_at(found)) <= closed))
    {
      continue;
    }
    const double after = solver.sign();
    rates = dense(qd[k]);
    const double fastest = most(rates);
    if (fastest > 0.0) {
      solver.take_metric_at(found);
      if (most(slopes * rates) > closed * fastest && !(
          solver.correct_rates(rates, DenseVector::Zero(slopes.rows())) &&
          !solver.is_dependent() && most(slopes * rates) <= RATES_OPEN * closed * most(rates)))
      {
        continue;
      }
    }
    dense(q[k]) = found;
    dense(qd[k]) = rates;
    status[k] = before * after > 0.0 ? closing::PLAIN : closing::TURNED;
  }
  return true;
}

Index first_open(
  const Model & model, const Workspace & work, const Manifold &, Table q, Table qd, double limit)
{
  for (Index k = 0; k < q.rows; ++k) {
    outward(model, q[k], qd[k], work);
    update(model, work, Responses::NONE);
    if (!(largest(work.closure) <= limit &&
      largest(work.closure_rate) <= limit * rate_scale(qd[k])))
    {
      return k;
    }
  }
  return q.rows;
}

}  // namespace closedloop
