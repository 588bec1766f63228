// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "requests.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dispatch.hpp"
#include "evaluation.hpp"
#include "forces.hpp"
#include "least_forces.hpp"
#include "loop_closure.hpp"
#include "null_space.hpp"
#include "projection.hpp"
#include "recursion.hpp"
#include "routines.hpp"
#include "stick_slip.hpp"

namespace closedloop
{

namespace
{
// Rounding error of the norm of a unit quaternion.
constexpr double UNIT_NORM = 1e-15;
// Largest acceleration of a closure error, relative to its largest term, that is zero.
constexpr double CLOSED = 1e-6;

template<class Number>
bool spread(Vector<Number> torque, Indices actuated, Values tau)
{
  tau.fill(0.0);
  for (Index n = 0; n < actuated.size; ++n) {
    if (actuated[n] >= 0) {
      tau[actuated[n]] = torque[n];
    } else if (torque[n] != 0.0) {
      return false;
    }
  }
  return all_finite(tau);
}

/// Initialise the effects' own states: friction from the rates.
void begin_effects(const System & system, const Request & request)
{
  const Values own = request.state.part(system.own(), request.own.size);
  copy(request.own, own);
  Values rates = system.qd(request.state);
  if (system.has_cut_coordinates()) {
    load_effect_states(system, request.state);
    rates_with_cuts(system, request.state, system.effects.cuts.qd);
    rates = system.effects.cuts.qd;
  }
  begin_friction(system.effects, rates, own);
}

bool evaluate_checked(const System & system, const Request & request, const System * whole)
{
  const Values q = system.q(request.state), qd = system.qd(request.state);
  if (!(all_finite(qd) && is_position(system.manifold, q))) {
    return false;
  }
  copy(system.tau, request.held);
  const bool acts = spread(request.torque, request.actuated, system.tau);
  bool serves = acts;
  if (acts) {
    if (system.has_effects()) {
      begin_effects(system, request);
    }
    if (system.whole.empty()) {
      evaluate_state(system, request.state);
      copy(system.lam.part(0, request.lam.size), request.lam);
    } else {
      if (request.lam.size == 0) {
        evaluate_state(system, request.state);
        serves = fulfil_left_out(system, q, qd);
      } else {
        evaluate_with_poses(system, request.state);
        serves = find_all_multipliers(system, q, qd, request.lam);
      }
      if (!serves && whole != nullptr) {
        evaluate_state(*whole, request.state);
        copy(whole->lam.part(0, request.lam.size), request.lam);
        serves = closes_loops(*whole, qd);
      }
    }
  }
  copy(request.held, system.tau);
  return serves && closes_loops(system, qd);
}

/// Closure equations of the whole mechanism in a state.
struct WholeEquations
{
  DenseMatrix jac;
  DenseVector bias;

  WholeEquations(const AllEquations & all, Values q, Values qd)
  : jac(all.model.equations(), all.model.joints()), bias(all.model.equations())
  {
    outward(all.model, q, qd, all.own);
    constraint_jacobian(all.model, all.own, view(jac));
    to_user_order(all.model, all.own.bias, view(bias));
  }
};

/// Whether a routine can continue from the results of the latest evaluation.
bool is_left_to(const System & system, Index which)
{
  return system.table[which] != 0 && system.work.health[health::WRITTEN] == 1.0;
}

/// Apply static friction at cut joints as in the latest evaluation.
void hold_as_evaluated(const EffectTable & effects)
{
  const StaticFriction & static_friction = effects.static_friction;
  for (Index index = 1; index <= static_friction.rows[0]; ++index) {
    const Index row = static_friction.rows[index];
    static_friction.hold[row] = effects.output(row, 1);
  }
}
}  // namespace

bool closes_loops(const System & system, Values qd)
{
  const Workspace & work = system.work;
  const double limit = system.settings->closure_limit;
  return largest(work.closure) <= limit &&
         largest(work.closure_rate) <= limit * rate_scale(qd);
}

bool take(const OptionalVector & from, Values to)
{
  if (!from.is_array || from.numbers.size != to.size) {
    return false;
  }
  for (Index i = 0; i < to.size; ++i) {
    to[i] = from.numbers[i];
  }
  return true;
}

bool spread_torques(Indices actuated, Values tau, const OptionalVector & torque)
{
  if (torque.is_none) {
    tau.fill(0.0);
    return true;
  }
  return torque.is_array && torque.numbers.size == actuated.size &&
         spread(torque.numbers, actuated, tau);
}

Comparison compare(Values values, double usual, const OptionalVector & given)
{
  if (!given.is_array || given.numbers.size != values.size) {
    return Comparison::OTHER;
  }
  if (std::equal(values.begin(), values.end(), given.numbers.begin())) {
    return Comparison::EQUAL;
  }
  return std::all_of(
    given.numbers.begin(), given.numbers.end(),
    [&](double number) {return std::abs(number) <= usual;}) ?
         Comparison::USUAL : Comparison::OTHER;
}

double sum_of_sizes(Values values)
{
  double sum = 0.0;
  for (double value : values) {
    sum += std::abs(value);
  }
  return sum;
}

bool is_position(const Manifold & manifold, Values q)
{
  for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
    const double * turn = &q[manifold.balls(ball, 0)];
    const double norm = std::hypot(std::hypot(turn[0], turn[1]), std::hypot(turn[2], turn[3]));
    if (!(std::abs(norm - 1.0) <= UNIT_NORM)) {
      return false;
    }
  }
  return all_finite(q);
}

bool evaluate_given(
  const System & system, const Request & request, const OptionalVector & q,
  const OptionalVector & qd, const OptionalVector & torque)
{
  if (torque.is_none) {
    request.torque.fill(0.0);
  } else if (!take(torque, request.torque)) {
    return false;
  }
  return take(q, system.q(request.state)) && take(qd, system.qd(request.state)) &&
         evaluate_checked(system, request, nullptr);
}

bool evaluate_request(const System & system, const System & whole, const Request & request)
{
  return evaluate_checked(system, request, &whole);
}

bool fulfil(Table jac, Values bias, Values qdd)
{
  double left = 0.0, most = 0.0;
  for (Index i = 0; i < jac.rows; ++i) {
    double sum = bias[i];
    most = std::max(most, std::abs(bias[i]));
    for (Index j = 0; j < jac.columns; ++j) {
      const double part = jac(i, j) * qdd[j];
      sum += part;
      most = std::max(most, std::abs(part));
    }
    if (!(std::abs(sum) <= left)) {
      left = std::abs(sum);
    }
  }
  return left <= CLOSED * most;
}

bool find_all_multipliers(const System & system, Values q, Values qd, Values lam)
{
  const AllEquations & all = system.whole;
  if (is_left_to(system, routine::LEAST_FORCES) &&
    call(system.table, routine::LEAST_FORCES, q, qd))
  {
    copy(all.lam, lam);
    return true;
  }
  const Model & model = all.model;
  const Workspace & work = all.own;
  WholeEquations whole(all, q, qd);
  spread_multipliers(system, lam);
  if (system.has_effects()) {
    hold_as_evaluated(system.effects);
    apply_listed_to(system, work.body, q, qd);
    system.effects.static_friction.hold.fill(0.0);
  }
  bias_forces(work, work.force);
  joint_wrenches(model, work, system.qdd, lam, work.force);
  minimise_joint_wrenches(system, model, work, view(whole.jac), work.force, lam, system.lam.size);
  return fulfil(view(whole.jac), view(whole.bias), system.qdd);
}

bool fulfil_left_out(const System & system, Values q, Values qd)
{
  if (system.table[routine::LEFT_OUT] != 0 && call(system.table, routine::LEFT_OUT, q, qd)) {
    return true;
  }
  WholeEquations whole(system.whole, q, qd);
  return fulfil(view(whole.jac), view(whole.bias), system.qdd);
}

void evaluate_present(const System & system, Values state)
{
  if (!system.latest->is_of(state, system.tau)) {
    evaluate_with_poses(system, state);
    system.latest->keep(state, system.tau);
  }
}

void find_multipliers(const System & system, Values state, Values lam)
{
  evaluate_present(system, state);
  if (system.whole.empty()) {
    copy(system.lam, lam);
  } else {
    find_all_multipliers(system, system.q(state), system.qd(state), lam);
    if (system.has_effects()) {
      // Their readings are those on other bodies now.
      system.latest->forget();
    }
  }
}

void points_in_state(
  const System & system, Values state, Indices row, Table point, Table out)
{
  evaluate_present(system, state);
  place_points(system.work.body, row, point, out);
}

void place_points(Table body, Indices row, Table point, Table out)
{
  for (Index k = 0; k < row.size; ++k) {
    if (point.columns == 2) {
      const Vector2 at = position(body, row[k], vector2(point.row(k)));
      out(k, 0) = at.x;
      out(k, 1) = at.y;
    } else {
      const Vector3 at = position(body, row[k], vector3(point.row(k)));
      out(k, 0) = at.x;
      out(k, 1) = at.y;
      out(k, 2) = at.z;
    }
  }
}

void find_joint_forces(
  const System & system, Values state, Values lam, Indices row, Table point, Table scratch,
  Table out)
{
  find_multipliers(system, state, lam);
  const AllEquations & all = system.whole;
  const Model & model = all.empty() ? system.model : all.model;
  const Workspace & work = all.empty() ? system.work : all.work;
  const Values q = system.q(state), qd = system.qd(state);
  const bool leaves = is_left_to(system, routine::WRENCHES);
  if (leaves) {
    copy(lam, all.empty() ? system.lam : all.lam);
    call(system.table, routine::WRENCHES, q, qd);
  } else {
    system.latest->forget();
    load_effect_states(system, state);
    outward(model, q, qd, work);
    if (system.has_cut_coordinates()) {
      hold_as_evaluated(system.effects);
    }
    apply_listed(system, q, qd);
    system.effects.static_friction.hold.fill(0.0);
    bias_forces(work, scratch);
    joint_wrenches(model, work, system.qdd, lam, scratch);
  }
  const Table wrench = leaves ? static_cast<const Table &>(system.work.force) : scratch;
  for (Index k = 0; k < row.size; ++k) {
    const Index i = row[k];
    if (i == 0) {
      out[k].fill(std::numeric_limits<double>::quiet_NaN());
      continue;
    }
    copy(wrench[i], out[k]);
    // In the plane rows begin where the joints are.
    if (!work.planar()) {
      const Vector3 moment = cross(
        to_world(work.body, i, vector3(point.row(k))), vector3(out.row(k) + 3));
      out(k, 0) -= moment.x;
      out(k, 1) -= moment.y;
      out(k, 2) -= moment.z;
    }
  }
}

}  // namespace closedloop
