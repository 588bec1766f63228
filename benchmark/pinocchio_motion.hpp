// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

// Pinocchio's constraintDynamics and lcaba in loops of C++, without Python between two
// evaluations: evaluations alone, the classical Runge-Kutta method, and the error-controlled
// Runge-Kutta-Fehlberg 7(8) of Boost.Numeric.Odeint. Called from pinocchio_code.py.

#ifndef PINOCCHIO_MOTION_HPP_
#define PINOCCHIO_MOTION_HPP_

#define PINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION
#include <pinocchio/spatial.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <pinocchio/algorithm/constrained-dynamics-derivatives.hpp>
#include <pinocchio/algorithm/loop-constrained-aba.hpp>

#include <boost/numeric/odeint/stepper/generation.hpp>
#include <boost/numeric/odeint/stepper/runge_kutta_fehlberg78.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace odeint = boost::numeric::odeint;
using State = std::vector<double>;

// Steps that a whole motion may take.
constexpr long MOST_STEPS = 5000;

struct Machine
{
  pinocchio::Model model;
  pinocchio::Data data;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintModel) constraints;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintData) constraint_data;
  pinocchio::ProximalSettings settings;
  bool by_bodies;
  Eigen::VectorXd q, v, tau, rates;
  // Steps, rejected ones among them, after which error control has failed: it ends in NaN.
  long left = 0;
  // First coordinate and number of what is normalised.
  std::vector<std::pair<int, int>> turns;

  // When model and constraints are complete.
  void finish(double mu, double accuracy, int iterations, int algorithm)
  {
    for (pinocchio::JointIndex k = 1; k < pinocchio::JointIndex(model.njoints); ++k) {
      if (model.nqs[k] == model.nvs[k]) {
        continue;
      }
      // What floats has a place before its quaternion.
      const int before = model.nqs[k] == 7 ? 3 : 0;
      turns.emplace_back(model.idx_qs[k] + before, model.nqs[k] - before);
    }
    for (const auto & constraint : constraints) {
      constraint_data.emplace_back(constraint);
    }
    data = pinocchio::Data(model);
    settings = pinocchio::ProximalSettings(accuracy, mu, iterations);
    by_bodies = algorithm != 0;
    if (by_bodies) {
      pinocchio::computeJointMinimalOrdering(model, data, constraints);
    } else {
      pinocchio::initConstraintDynamics(model, data, constraints, constraint_data);
    }
    q = rates = Eigen::VectorXd::Zero(model.nq);
    v = tau = Eigen::VectorXd::Zero(model.nv);
  }

  const Eigen::VectorXd & accelerate()
  {
    if (by_bodies) {
      return pinocchio::lcaba(model, data, q, v, tau, constraints, constraint_data, settings);
    }
    return pinocchio::constraintDynamics(
      model, data, q, v, tau, constraints, constraint_data, settings);
  }

  // Keep unit quaternions, and cosines and sines, what they are.
  void normalise()
  {
    for (const auto & turn : turns) {
      q.segment(turn.first, turn.second).normalize();
    }
  }

  // Derivatives of the coordinates: the rates themselves where nothing is normalised.
  const Eigen::VectorXd & coordinate_rates()
  {
    if (turns.empty()) {
      return v;
    }
    for (pinocchio::JointIndex k = 1; k < pinocchio::JointIndex(model.njoints); ++k) {
      int iq = model.idx_qs[k], iv = model.idx_vs[k];
      if (model.nqs[k] == model.nvs[k]) {
        rates.segment(iq, model.nqs[k]) = v.segment(iv, model.nvs[k]);
        continue;
      }
      if (model.nqs[k] == 2) {
        // Cosine and sine of an angle without limits.
        rates[iq] = -q[iq + 1] * v[iv];
        rates[iq + 1] = q[iq] * v[iv];
        continue;
      }
      if (model.nqs[k] == 7) {
        const Eigen::Quaterniond turn(q.segment<4>(iq + 3).data());
        rates.segment<3>(iq) = turn * v.segment<3>(iv).eval();
        iq += 3;
        iv += 3;
      }
      const double x = q[iq], y = q[iq + 1], z = q[iq + 2], w = q[iq + 3];
      const double a = 0.5 * v[iv], b = 0.5 * v[iv + 1], c = 0.5 * v[iv + 2];
      rates[iq] = w * a + y * c - z * b;
      rates[iq + 1] = w * b + z * a - x * c;
      rates[iq + 2] = w * c + x * b - y * a;
      rates[iq + 3] = -(x * a + y * b + z * c);
    }
    return rates;
  }

  void operator()(const State & state, State & rate, double)
  {
    const int nq = model.nq, nv = model.nv;
    q = Eigen::Map<const Eigen::VectorXd>(state.data(), nq);
    v = Eigen::Map<const Eigen::VectorXd>(state.data() + nq, nv);
    normalise();
    Eigen::Map<Eigen::VectorXd>(rate.data(), nq) = coordinate_rates();
    Eigen::Map<Eigen::VectorXd>(rate.data() + nq, nv) = accelerate();
  }
};

extern "C" {

int coordinates(void * handle) { return static_cast<Machine *>(handle)->model.nq; }

int freedoms(void * handle) { return static_cast<Machine *>(handle)->model.nv; }

void set_state(void * handle, const double * q, const double * v, const double * tau)
{
  Machine & machine = *static_cast<Machine *>(handle);
  machine.q = Eigen::Map<const Eigen::VectorXd>(q, machine.model.nq);
  machine.v = Eigen::Map<const Eigen::VectorXd>(v, machine.model.nv);
  machine.tau = Eigen::Map<const Eigen::VectorXd>(tau, machine.model.nv);
  machine.left = MOST_STEPS;
}

void set_torque(void * handle, const double * tau)
{
  Machine & machine = *static_cast<Machine *>(handle);
  machine.tau = Eigen::Map<const Eigen::VectorXd>(tau, machine.model.nv);
}

void get_position(void * handle, double * q)
{
  Machine & machine = *static_cast<Machine *>(handle);
  Eigen::Map<Eigen::VectorXd>(q, machine.model.nq) = machine.q;
}

void evaluate(void * handle, long count, double * acceleration)
{
  Machine & machine = *static_cast<Machine *>(handle);
  for (long k = 0; k < count; ++k) {
    machine.accelerate();
  }
  Eigen::Map<Eigen::VectorXd>(acceleration, machine.model.nv) = machine.data.ddq;
}

// Accelerations, and all their derivatives, again and again; the latter by coordinates, rates and
// torques, column by column.
void differentiate(void * handle, long count, double * derivatives)
{
  Machine & machine = *static_cast<Machine *>(handle);
  for (long k = 0; k < count; ++k) {
    machine.accelerate();
    pinocchio::computeConstraintDynamicsDerivatives(
      machine.model, machine.data, machine.constraints, machine.constraint_data,
      machine.settings);
  }
  const int nv = machine.model.nv;
  Eigen::Map<Eigen::MatrixXd> found(derivatives, nv, 3 * nv);
  found << machine.data.ddq_dq, machine.data.ddq_dv, machine.data.ddq_dtau;
}

void runge_kutta_4(void * handle, double step, long steps)
{
  Machine & machine = *static_cast<Machine *>(handle);
  const int nq = machine.model.nq, nv = machine.model.nv;
  Eigen::VectorXd q0(nq), v0(nv), q_sum(nq), a_sum(nv), slope(nq);
  for (long k = 0; k < steps; ++k) {
    q0 = machine.q;
    v0 = machine.v;
    q_sum.setZero();
    a_sum.setZero();
    for (int stage = 0; stage < 4; ++stage) {
      const double weight = (stage == 0 || stage == 3) ? 1.0 : 2.0;
      const Eigen::VectorXd & a = machine.accelerate();
      slope = machine.coordinate_rates();
      q_sum += weight * slope;
      a_sum += weight * a;
      if (stage < 3) {
        const double part = stage == 2 ? step : 0.5 * step;
        machine.q = q0 + part * slope;
        machine.v = v0 + part * a;
        machine.normalise();
      }
    }
    machine.q = q0 + step / 6.0 * q_sum;
    machine.v = v0 + step / 6.0 * a_sum;
    machine.normalise();
  }
}

void fehlberg_78(void * handle, double duration, double tolerance, double first_step)
{
  Machine & machine = *static_cast<Machine *>(handle);
  const int nq = machine.model.nq, nv = machine.model.nv;
  State state(nq + nv);
  Eigen::Map<Eigen::VectorXd>(state.data(), nq) = machine.q;
  Eigen::Map<Eigen::VectorXd>(state.data() + nq, nv) = machine.v;
  auto stepper = odeint::make_controlled(
    tolerance, tolerance, odeint::runge_kutta_fehlberg78<State>());
  double time = 0.0, step = first_step;
  while (duration - time > 1e-14 * duration) {
    if (--machine.left < 0) {
      std::fill(state.begin(), state.end(), std::nan(""));
      break;
    }
    step = std::min(step, duration - time);
    stepper.try_step(std::ref(machine), state, time, step);
  }
  machine.q = Eigen::Map<Eigen::VectorXd>(state.data(), nq);
  machine.v = Eigen::Map<Eigen::VectorXd>(state.data() + nq, nv);
  machine.normalise();
}

void destroy(void * handle) { delete static_cast<Machine *>(handle); }

}  // extern "C"

#endif  // PINOCCHIO_MOTION_HPP_
