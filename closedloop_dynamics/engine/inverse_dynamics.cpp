// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "inverse_dynamics.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <memory>

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
#include "scratch.hpp"
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

/// Memory of one solution, on the stack for most mechanisms.
using Room = Scratch<double, 3 * FEW * FEW + 10 * FEW>;

Index room_for(const System & system, Index nc, Index passive)
{
  return system.nq() + 4 * system.nv() + system.tau.size + nc * (system.nv() + passive + 1) +
         passive;
}

/// Whether accelerations open the first `loops` equations at a state whose bodies were moved, or
/// the derivatives of any equation are not finite.
bool opens(const System & system, Table jac, Values bias, Index loops, Values qdd)
{
  const bool planar = system.work.planar();
  const Index first = planar ?
    static_cast<Index>(plane::AX) : static_cast<Index>(space::ACCELERATION);
  double part = 0.0, all = 0.0;
  for (Index i = 0; i < jac.rows; ++i) {
    double sum = bias[i];
    const double * row = jac.row(i);
    for (Index j = 0; j < jac.columns; ++j) {
      sum += row[j] * qdd[j];
    }
    part = i < loops ? std::max(part, std::abs(sum)) : part;
    all += sum;
  }
  if (!std::isfinite(all)) {
    return true;
  }
  double acceleration = 0.0;
  for (Index i = 0; i < system.work.body.rows; ++i) {
    acceleration = std::max(
      acceleration, largest({&system.work.body(i, first), planar ? 2 : 3}));
  }
  if (part <= NOISE * acceleration) {
    return false;
  }
  double most = largest(bias.part(0, loops));
  for (Index i = 0; i < jac.rows; ++i) {
    for (Index j = 0; j < jac.columns; ++j) {
      most = std::max(most, std::abs(jac(i, j) * qdd[j]));
    }
  }
  return !(part <= NOISE * acceleration + OPENS * most);
}

/// Required sum of torques and constraint forces at the joints; `moved`: the bodies have been moved
/// there, and no effect has acted yet. `no_torques`: zeros.
void find_need(
  const System & system, Values q, Values qd, Values qdd, bool moved, Values no_torques,
  Values need)
{
  const EffectTable & table = system.effects;
  if (!moved) {
    outward(system.model, q, qd, system.work);
  }
  if (system.has_effects()) {
    // Friction is that of a steady motion; the drives are the unknowns.
    begin_friction(table, qd, table.states);
    Scratch<Index, FEW> room(table.count());
    const Indices enabled = room.copy_of(table.enabled);
    for (Index row = 0; row < table.count(); ++row) {
      if (table.role[row] == effect::DRIVE) {
        table.enabled[row] = 0;
      } else if (table.role[row] == effect::INERTIA) {
        table.static_friction.hold[row] = -table.values(row, 0) * along(table, row, qdd);
      }
    }
    Values positions = q;
    if (!system.manifold.empty()) {
      fill_numbers(system.manifold, q);
      positions = system.manifold.number;
    }
    apply_effects(table, system.work.body, positions, qd, no_torques);
    copy(enabled, table.enabled);
    table.static_friction.hold.fill(0.0);
    bias_forces(system.work, table.reaction);
  }
  tree_torque(system.model, system.work, qdd, need);
  if (system.has_effects()) {
    for (Index i = 0; i < need.size; ++i) {
      need[i] -= table.applied[i];
    }
  }
}

/// The least torques, and of equal ones the least multipliers, where many have the required sum.
class LeastTorques
{
public:
  LeastTorques(Table jac, Indices actuated)
  : count_(actuated.size)
  {
    Eigen::MatrixXd unknowns = Eigen::MatrixXd::Zero(jac.columns, count_ + jac.rows);
    for (Index n = 0; n < count_; ++n) {
      unknowns(actuated[n], n) = 1.0;
    }
    unknowns.rightCols(jac.rows) = dense(jac).transpose();
    all_.compute(unknowns, REPEATS);
    // Null space: torques and multipliers whose sum is zero.
    if (unknowns.cols() > all_.rank() && count_ > 0) {
      nothing_ = all_.null_space();
      of_nothing_.compute(nothing_.topRows(count_), Eigen::ComputeThinU | Eigen::ComputeThinV);
    }
  }

  void solve(Values need, Values out) const
  {
    Eigen::Map<DenseVector> solution = dense(out);
    solution = all_.solve(dense(need));
    for (Index n = 0; n < std::min(count_, nothing_.cols()); ++n) {
      const double part = of_nothing_.singularValues()[n];
      if (part > CLEAR) {
        const double share = of_nothing_.matrixU().col(n).dot(solution.head(count_)) / part;
        solution -= nothing_ * (share * of_nothing_.matrixV().col(n));
      }
    }
  }

private:
  Index count_;
  LeastSquares all_;
  Eigen::MatrixXd nothing_;
  LargeSingular of_nothing_;
};

/// Torques and multipliers of a mechanism in one position.
class Balance
{
public:
  Balance(Table jac, Indices actuated, Indices passive, Room & room)
  : jac_(jac), actuated_(actuated), passive_(passive), left_(room.take(jac.columns)),
    levers_(room.take(passive.size, jac.rows)), right_(room.take(passive.size)),
    of_pivots_(jac.rows), pivots_(of_pivots_.take(jac.rows))
  {
    for (Index i = 0; i < passive.size; ++i) {
      for (Index k = 0; k < jac.rows; ++k) {
        levers_(i, k) = jac(k, passive[i]);
      }
    }
    if (jac.rows <= passive.size) {
      // Most mechanisms: no more drives than degrees of freedom.
      unique_ = factorize(levers_, pivots_) > SOUND;
    } else if (passive.size > 0 && jac.rows <= FEW) {
      // Some multipliers are not unique.
      repeats_ = has_unique_torques();
    }
    if (!unique_ && !repeats_) {
      least_ = std::make_unique<LeastTorques>(jac, actuated);
    }
  }

  /// Whether torques and multipliers, written to `out`, have the required sum.
  bool solve(Values need, Values out)
  {
    const Values lam = out.from(actuated_.size);
    if (least_ != nullptr) {
      least_->solve(need, out);
    } else {
      for (Index i = 0; i < passive_.size; ++i) {
        right_[i] = need[passive_[i]];
      }
      if (repeats_) {
        dense(lam) = least_multipliers();
      } else {
        closedloop::solve(levers_, pivots_, right_);
        copy(right_, lam);
      }
    }
    dense(left_).noalias() = dense(need) - dense(jac_).transpose() * dense(lam);
    double missing = 0.0;
    for (Index i : passive_) {
      if (!(std::abs(left_[i]) <= missing)) {
        missing = std::abs(left_[i]);
      }
    }
    if (least_ == nullptr) {
      for (Index n = 0; n < actuated_.size; ++n) {
        out[n] = left_[actuated_[n]];
      }
    }
    return missing <= MISSING * std::max(largest(need), 1e-30);
  }

private:
  /// Factor the passive joints' levers by rows; return whether multipliers without force at these
  /// joints have none at the actuated joints, either.
  bool has_unique_torques()
  {
    const Index count = passive_.size, idle = jac_.rows - count;
    of_few_.setThreshold(CLEAR);
    of_few_.compute(dense(levers_).transpose());
    if (of_few_.rank() < count) {
      return false;
    }
    for (Index joint : actuated_) {
      const Sized<FEW>::Vector lever = of_few_.householderQ().adjoint() * dense(jac_).col(joint);
      if (!(lever.tail(idle).norm() <= REPEATS * lever.norm())) {
        return false;
      }
    }
    return true;
  }

  /// The least multipliers that give the required forces at the passive joints.
  Sized<FEW>::Vector least_multipliers() const
  {
    const Index count = passive_.size;
    Sized<FEW>::Vector found = Sized<FEW>::Vector::Zero(jac_.rows);
    found.head(count) = of_few_.colsPermutation().transpose() * dense(right_);
    of_few_.matrixQR().topLeftCorner(count, count).triangularView<Eigen::Upper>()
    .transpose().solveInPlace(found.head(count));
    found.applyOnTheLeft(of_few_.householderQ());
    return found;
  }

  Table jac_;
  Indices actuated_, passive_;
  /// Forces that torques have to give.
  Values left_;
  /// Levers of the passive joints; where multipliers are unique their LU factors, with the pivots.
  Table levers_;
  Values right_;
  Scratch<Index, FEW> of_pivots_;
  Indices pivots_;
  bool unique_ = false;
  // Whether torques are unique, and multipliers are not: factors of the levers, transposed.
  bool repeats_ = false;
  Eigen::ColPivHouseholderQR<Sized<FEW>::ByColumn> of_few_;
  std::unique_ptr<LeastTorques> least_;
};
}  // namespace

bool find_torques(
  const System & system, Indices actuated, Indices passive, Index loops, Values own, Values out,
  const OptionalVector & given_q, const OptionalVector & given_qd,
  const OptionalVector & given_qdd)
{
  const Model & model = system.whole.empty() ? system.model : system.whole.model;
  const Workspace & work = system.whole.empty() ? system.work : system.whole.work;
  const Index nv = system.nv(), nc = model.equations();
  if (system.has_cut_coordinates() || nv == 0) {
    return false;
  }
  Room room(room_for(system, nc, passive.size));
  const Values q = room.take(system.nq()), qd = room.take(nv), qdd = room.take(nv);
  const Values need = room.take(nv), no_torques = room.take(system.tau.size);
  if (!(take(given_q, q) && take(given_qd, qd) && take(given_qdd, qdd) &&
    is_position(system.manifold, q) && all_finite(qd) && all_finite(qdd)))
  {
    return false;
  }
  if (system.has_effects()) {
    copy(own, system.effects.states);
  }
  no_torques.fill(0.0);
  const Table jac = room.take(nc, nv);
  const Values bias = room.take(nc);
  outward(model, q, qd, work);
  constraint_jacobian(model, work, jac);
  to_user_order(model, work.bias, bias);
  if (opens(system, jac, bias, loops, qdd)) {
    return false;
  }
  // Not of prescribed motions: the given one may be another.
  const auto within = [&](Values errors, double limit) {
      to_user_order(model, errors, bias);
      return largest(bias.part(0, loops)) <= limit;
    };
  const double limit = system.settings->closure_limit;
  if (!within(work.closure, limit) || !within(work.closure_rate, limit * rate_scale(qd))) {
    return false;
  }
  Balance balance(jac, actuated, passive, room);
  // Where more are needed, Python continues, which can be interrupted.
  for (int round = 0; round < MOST_ROUNDS; ++round) {
    need.fill(0.0);
    find_need(system, q, qd, qdd, round == 0, no_torques, need);
    if (!balance.solve(need, out)) {
      return false;
    }
    if (!system.has_effects() || system.effects.loaded[0] == 0) {
      return true;
    }
    // Friction driven by reactions depends on the result: a fixed point, fast because friction is
    // the smaller part.
    load_joints(system, model, work, qd, qdd, out.from(actuated.size));
    if (feel_loads(system, system.effects.states, SETTLED)) {
      return true;
    }
  }
  return false;
}

}  // namespace closedloop
