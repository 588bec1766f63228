// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "inverse_dynamics.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <vector>

#include "arms.hpp"
#include "dispatch.hpp"
#include "evaluation.hpp"
#include "joint_reaction.hpp"
#include "least_squares.hpp"
#include "loop_closure.hpp"
#include "lu.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "projection.hpp"
#include "recursion.hpp"
#include "requests.hpp"
#include "stick_slip.hpp"

// tau + tau_effects + J^T lambda = I qdd + c, tau zero at the joints that are not actuated.

namespace closedloop
{

namespace
{
// Accelerations of the cut joints beyond this share of their parts open the loops; less than the
// second one, of the bodies' accelerations, is rounding.
constexpr double OPENS = 1e-8, NOISE = 1e-12;
// Forces missing at joints that are not actuated, of the largest needed.
constexpr double MISSING = 1e-8;
// Pivots above this times the largest decide the rank; singular values below the second are those
// of redundant equations.
constexpr double CLEAR = 1e-9, REPEATS = 1e-12;
// Smallest pivot of LU factors, of the largest, at which multipliers are accurate enough.
constexpr double SOUND = 1e-5;
// Change of reactions, of the largest, at which friction that depends on them is found.
constexpr double SETTLED = 1e-12;
constexpr int MOST_ROUNDS = 1000;

/// All equations at a state whose bodies were moved.
struct Loops
{
  DenseMatrix jac;
  DenseVector bias;
};

bool opens(const System & system, const Loops & all, Index loops, const DenseVector & qdd)
{
  const bool planar = system.work.planar();
  const Index first = planar ?
    static_cast<Index>(plane::AX) : static_cast<Index>(space::ACCELERATION);
  double largest_acceleration = 0.0, most = 0.0, part = 0.0;
  for (Index i = 0; i < system.work.body.rows; ++i) {
    for (Index n = first; n < first + (planar ? 2 : 3); ++n) {
      largest_acceleration = std::max(largest_acceleration, std::abs(system.work.body(i, n)));
    }
  }
  for (Index i = 0; i < all.jac.rows(); ++i) {
    double sum = i < loops ? all.bias[i] : 0.0;
    most = std::max(most, std::abs(sum));
    for (Index j = 0; j < all.jac.cols(); ++j) {
      const double product = all.jac(i, j) * qdd[j];
      most = std::max(most, std::abs(product));
      sum += product;
    }
    if (i < loops) {
      part = std::max(part, std::abs(sum));
    }
  }
  return !(part <= NOISE * largest_acceleration + OPENS * most);
}

/// Required sum of torques and constraint forces at the joints; `moved`: the bodies have been moved
/// there, and no effect has acted yet.
void find_need(const System & system, Values q, Values qd, Values qdd, bool moved, Values need)
{
  const EffectTable & table = system.effects;
  if (!moved) {
    outward(system.model, q, qd, system.work);
  }
  if (system.has_effects()) {
    // Friction is that of a steady motion; the drives are the unknowns.
    begin_friction(table, qd, table.states);
    std::vector<Index> enabled(table.enabled.begin(), table.enabled.end());
    for (Index row = 0; row < table.count(); ++row) {
      if (table.kind[row] == effect::ACTUATOR) {
        table.enabled[row] = 0;
      } else if (table.kind[row] == effect::REFLECTED_INERTIA) {
        table.sticking.hold[row] = -table.values(row, 0) * along(table, row, qdd);
      }
    }
    Values positions = q;
    if (!system.manifold.empty()) {
      fill_numbers(system.manifold, q);
      positions = system.manifold.number;
    }
    DenseVector none = DenseVector::Zero(system.tau.size);
    apply_effects(table, system.work.body, positions, qd, view(none));
    std::copy(enabled.begin(), enabled.end(), table.enabled.begin());
    table.sticking.hold.fill(0.0);
    bias_forces(system.work, table.reaction);
  }
  tree_torque(system.model, system.work, qdd, need);
  if (system.has_effects()) {
    for (Index i = 0; i < need.size; ++i) {
      need[i] -= table.applied[i];
    }
  }
}

/// Least torques and multipliers of a mechanism in one position.
class Balance
{
public:
  Balance(const DenseMatrix & jac, Indices actuated)
  : jac_(jac), actuated_(actuated)
  {
    const Index nv = jac.cols();
    passive_.reserve(nv);
    for (Index i = 0; i < nv; ++i) {
      if (std::find(actuated.begin(), actuated.end(), i) == actuated.end()) {
        passive_.push_back(i);
      }
    }
    const Index count = static_cast<Index>(passive_.size());
    DenseMatrix levers(count, jac.rows());
    for (Index i = 0; i < count; ++i) {
      levers.row(i) = jac.col(passive_[i]).transpose();
    }
    if (levers.size() > 0 && count == jac.rows()) {
      // Most mechanisms: as many drives as degrees of freedom.
      square_ = levers;
      pivots_.resize(count);
      unique_ = factorize(view(square_), {pivots_.data(), count}) > SOUND;
      if (unique_) {
        return;
      }
      pivots_.clear();
    }
    is_small_ = std::max(levers.rows(), levers.cols()) <= FEW;
    if (levers.size() > 0 && count < jac.rows()) {
      // Fewer than the equations: some multipliers are not unique.
      repeats_ = is_small_ && has_unique_torques(levers);
      if (repeats_) {
        return;
      }
    } else if (levers.size() > 0) {
      if (is_small_) {
        of_few_.setThreshold(CLEAR);
        of_few_.compute(levers);
      } else {
        of_passive_.compute(levers, CLEAR);
      }
    }
    unique_ = jac.rows() == 0 || (levers.size() > 0 && count >= jac.rows() && jac.rows() == (
        is_small_ ? of_few_.rank() : of_passive_.rank()));
    if (!unique_) {
      Eigen::MatrixXd unknowns = Eigen::MatrixXd::Zero(nv, actuated.size + jac.rows());
      for (Index n = 0; n < actuated.size; ++n) {
        unknowns(actuated[n], n) = 1.0;
      }
      unknowns.rightCols(jac.rows()) = jac.transpose();
      of_all_.compute(unknowns, REPEATS);
      // Null space: torques and multipliers whose sum is zero.
      const Index left = unknowns.cols() - of_all_.rank();
      if (left > 0 && actuated.size > 0) {
        nothing_ = of_all_.null_space();
        of_nothing_.compute(
          nothing_.topRows(actuated.size), Eigen::ComputeThinU | Eigen::ComputeThinV);
      }
    }
  }

  /// Whether torques and multipliers, written to `out`, have the required sum.
  bool solve(const DenseVector & need, Values out)
  {
    const Index count = actuated_.size;
    Eigen::Map<DenseVector> solution = dense(out), lam = dense(out.from(count));
    if (unique_ || repeats_) {
      if (lam.size() > 0) {
        DenseVector at_passive(passive_.size());
        for (std::size_t i = 0; i < passive_.size(); ++i) {
          at_passive[i] = need[passive_[i]];
        }
        if (repeats_) {
          lam = least_multipliers(at_passive);
        } else if (pivots_.empty() && is_small_) {
          lam = of_few_.solve(at_passive);
        } else if (pivots_.empty()) {
          lam = of_passive_.solve(at_passive);
        } else {
          lam = at_passive;
          closedloop::solve(view(square_), {pivots_.data(), lam.size()}, out.from(count));
        }
      }
    } else {
      solution = of_all_.solve(need);
      // The least torques; of equal ones the least multipliers.
      for (Index n = 0; n < std::min(count, nothing_.cols()); ++n) {
        const double part = of_nothing_.singularValues()[n];
        if (part > CLEAR) {
          const double share = of_nothing_.matrixU().col(n).dot(solution.head(count)) / part;
          solution -= nothing_ * (share * of_nothing_.matrixV().col(n));
        }
      }
    }
    const DenseVector left = need - jac_.transpose() * lam;
    double missing = 0.0;
    for (Index i : passive_) {
      if (!(std::abs(left[i]) <= missing)) {
        missing = std::abs(left[i]);
      }
    }
    if (unique_ || repeats_) {
      for (Index n = 0; n < count; ++n) {
        out[n] = left[actuated_[n]];
      }
    }
    return missing <= MISSING * std::max(need.cwiseAbs().maxCoeff(), 1e-30);
  }

private:
  /// Factor the passive joints' levers by rows; return whether multipliers without force at these
  /// joints have none at the actuated joints, either.
  bool has_unique_torques(const DenseMatrix & levers)
  {
    const Index count = levers.rows(), idle = levers.cols() - count;
    of_few_.setThreshold(CLEAR);
    of_few_.compute(levers.transpose());
    if (of_few_.rank() < count) {
      return false;
    }
    for (Index joint : actuated_) {
      const Sized<FEW>::Vector lever = of_few_.householderQ().adjoint() * jac_.col(joint);
      if (!(lever.tail(idle).norm() <= REPEATS * lever.norm())) {
        return false;
      }
    }
    return true;
  }

  /// The least multipliers that give the required forces at the passive joints.
  Sized<FEW>::Vector least_multipliers(const DenseVector & at_passive) const
  {
    const Index count = at_passive.size();
    Sized<FEW>::Vector found = Sized<FEW>::Vector::Zero(jac_.rows());
    found.head(count) = of_few_.colsPermutation().transpose() * at_passive;
    of_few_.matrixQR().topLeftCorner(count, count).triangularView<Eigen::Upper>()
    .transpose().solveInPlace(found.head(count));
    found.applyOnTheLeft(of_few_.householderQ());
    return found;
  }

  const DenseMatrix & jac_;
  Indices actuated_;
  std::vector<Index> passive_;
  bool unique_ = false;
  // Whether torques are unique, and multipliers are not.
  bool repeats_ = false;
  // LU factors of the passive joints' levers, with their pivots; empty if not square.
  DenseMatrix square_;
  std::vector<Index> pivots_;
  // Of the passive joints' levers otherwise, transposed where these are fewer than the equations;
  // on the stack where they are few; of all unknowns.
  bool is_small_ = false;
  Eigen::ColPivHouseholderQR<Sized<FEW>::ByColumn> of_few_;
  LeastSquares of_passive_, of_all_;
  Eigen::MatrixXd nothing_;
  LargeSingular of_nothing_;
};

/// Update the joint loads of friction; return whether they are as before.
bool settle(const EffectTable & table)
{
  double change = 0.0, most = 0.0;
  for (Index row = 0; row < table.count(); ++row) {
    if (table.index(row, effect::LOADED) != 0) {
      double & felt = table.states[table.index(row, effect::STATE) + 1];
      const double load = table.output(row, 2);
      change = std::max(change, std::abs(felt - load));
      most = std::max(most, load);
      felt = load;
    }
  }
  return !(change > SETTLED * most);
}
}  // namespace

bool find_torques(
  const System & system, Indices actuated, Index loops, Values out, const Given & given_q,
  const Given & given_qd, const Given & given_qdd)
{
  const Model & model = system.whole.empty() ? system.model : system.whole.model;
  const Workspace & work = system.whole.empty() ? system.work : system.whole.work;
  const Index nv = system.nv(), nc = model.equations();
  if (system.has_cut_coordinates() || nv == 0 || out.size != actuated.size + nc) {
    return false;
  }
  DenseVector q(system.nq()), qd(nv), qdd(nv), need(nv);
  if (!(take(given_q, view(q)) && take(given_qd, view(qd)) && take(given_qdd, view(qdd)) &&
    is_position(system.manifold, view(q)) && qd.allFinite() && qdd.allFinite()))
  {
    return false;
  }
  outward(model, view(q), view(qd), work);
  update(model, work, Responses::NONE);
  Loops all{DenseMatrix(nc, nv), DenseVector(nc)};
  to_user_order(model, work.bias, view(all.bias));
  constraint_jacobian(model, work, view(all.jac));
  if (!all.jac.allFinite() || opens(system, all, loops, qdd)) {
    return false;
  }
  Balance balance(all.jac, actuated);
  // Where more are needed, Python continues, which can be interrupted.
  for (int round = 0; round < MOST_ROUNDS; ++round) {
    const bool moved = round == 0 && system.whole.empty();
    need.setZero();
    find_need(system, view(q), view(qd), view(qdd), moved, view(need));
    if (!balance.solve(need, out)) {
      return false;
    }
    if (!system.has_effects() || system.effects.loaded[0] == 0) {
      return true;
    }
    // Friction driven by reactions depends on the result: a fixed point, fast because friction is
    // the smaller part.
    load_joints(system, model, work, view(qd), view(qdd), out.from(actuated.size));
    if (settle(system.effects)) {
      return true;
    }
  }
  return false;
}

}  // namespace closedloop
