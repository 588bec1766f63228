// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

// Pinocchio's constraintDynamics and lcaba in loops of C++, without Python between two
// evaluations: evaluations alone, the classical Runge-Kutta method, and the error-controlled
// Runge-Kutta-Fehlberg 7(8), both of Boost.Numeric.Odeint. Called from peer_pinocchio.py, which
// saves the model.

#define PINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION
#include <pinocchio/spatial.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <pinocchio/algorithm/constrained-dynamics-derivatives.hpp>
#include <pinocchio/algorithm/loop-constrained-aba.hpp>
#include <pinocchio/serialization.hpp>

#include <boost/numeric/odeint/stepper/generation.hpp>
#include <boost/numeric/odeint/stepper/runge_kutta4.hpp>
#include <boost/numeric/odeint/stepper/runge_kutta_fehlberg78.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <vector>

namespace
{

namespace odeint = boost::numeric::odeint;
using State = std::vector<double>;
using Vector = Eigen::Map<const Eigen::VectorXd>;

// Steps that a whole motion may take, rejected ones among them: then error control has failed.
constexpr long MOST_STEPS = 5000;

struct Machine
{
  pinocchio::Model model;
  pinocchio::Data data;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintModel) constraints;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintData) constraint_data;
  pinocchio::ProximalSettings settings;
  bool by_bodies;
  Eigen::VectorXd q, v, tau;
  long left = 0;

  const Eigen::VectorXd & accelerate()
  {
    if (by_bodies) {
      return pinocchio::lcaba(model, data, q, v, tau, constraints, constraint_data, settings);
    }
    return pinocchio::constraintDynamics(
      model, data, q, v, tau, constraints, constraint_data, settings);
  }

  // Take over coordinates, those of balls as unit quaternions, and rates.
  void set(const double * state)
  {
    q = Vector(state, model.nq);
    v = Vector(state + model.nq, model.nv);
    for (pinocchio::JointIndex k = 1; k < pinocchio::JointIndex(model.njoints); ++k) {
      if (model.nqs[k] == 4) {
        q.segment<4>(model.idx_qs[k]).normalize();
      }
    }
  }

  // Derivatives of coordinates and rates.
  void operator()(const State & state, State & rate, double)
  {
    set(state.data());
    for (pinocchio::JointIndex k = 1; k < pinocchio::JointIndex(model.njoints); ++k) {
      const int iq = model.idx_qs[k], iv = model.idx_vs[k];
      if (model.nqs[k] == 4) {
        const Eigen::Quaterniond turn(q.segment<4>(iq).data());
        const Eigen::Quaterniond spin(0.0, 0.5 * v[iv], 0.5 * v[iv + 1], 0.5 * v[iv + 2]);
        Eigen::Map<Eigen::Vector4d>(rate.data() + iq) = (turn * spin).coeffs();
      } else {
        std::copy_n(v.data() + iv, model.nvs[k], rate.data() + iq);
      }
    }
    Eigen::Map<Eigen::VectorXd>(rate.data() + model.nq, model.nv) = accelerate();
  }

  // Let a method advance the state.
  template<typename Method>
  void advance(Method method)
  {
    State state(model.nq + model.nv);
    std::copy_n(q.data(), model.nq, state.data());
    std::copy_n(v.data(), model.nv, state.data() + model.nq);
    method(state);
    set(state.data());
  }
};

pinocchio::SE3 placement(const double * rows)
{
  const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> matrix(rows);
  return pinocchio::SE3(matrix.leftCols<3>(), matrix.col(3));
}

}  // namespace

extern "C" {

// Per loop: two joints, whether orientations are held too, and a frame on each joint as three
// rows of rotation and place.
Machine * create(
  const char * file, int loops, const int * ends, const int * whole, const double * frames,
  double mu, double accuracy, int iterations, int by_bodies)
{
  Machine * machine = new Machine;
  machine->model.loadFromBinary(file);
  for (int k = 0; k < loops; ++k) {
    machine->constraints.emplace_back(
      whole[k] ? pinocchio::CONTACT_6D : pinocchio::CONTACT_3D, machine->model, ends[2 * k],
      placement(frames + 24 * k), ends[2 * k + 1], placement(frames + 24 * k + 12),
      pinocchio::LOCAL);
    machine->constraint_data.emplace_back(machine->constraints.back());
  }
  machine->data = pinocchio::Data(machine->model);
  machine->settings = pinocchio::ProximalSettings(accuracy, mu, iterations);
  machine->by_bodies = by_bodies != 0;
  if (machine->by_bodies) {
    pinocchio::computeJointMinimalOrdering(machine->model, machine->data, machine->constraints);
  } else {
    pinocchio::initConstraintDynamics(
      machine->model, machine->data, machine->constraints, machine->constraint_data);
  }
  return machine;
}

// Coordinates, then rates.
void set_state(Machine * machine, const double * state)
{
  machine->set(state);
  machine->left = MOST_STEPS;
}

void set_torque(Machine * machine, const double * tau)
{
  machine->tau = Vector(tau, machine->model.nv);
}

void get_position(Machine * machine, double * q)
{
  std::copy_n(machine->q.data(), machine->model.nq, q);
}

void evaluate(Machine * machine, long count, double * acceleration)
{
  for (long k = 0; k < count; ++k) {
    machine->accelerate();
  }
  std::copy_n(machine->data.ddq.data(), machine->model.nv, acceleration);
}

// Accelerations, and all their derivatives, again and again.
void differentiate(Machine * machine, long count)
{
  for (long k = 0; k < count; ++k) {
    machine->accelerate();
    pinocchio::computeConstraintDynamicsDerivatives(
      machine->model, machine->data, machine->constraints, machine->constraint_data,
      machine->settings);
  }
}

void runge_kutta_4(Machine * machine, double step, long steps)
{
  machine->advance([&](State & state) {
    odeint::runge_kutta4<State> stepper;
    for (long k = 0; k < steps; ++k) {
      stepper.do_step(std::ref(*machine), state, 0.0, step);
    }
  });
}

void fehlberg_78(Machine * machine, double duration, double tolerance, double first_step)
{
  machine->advance([&](State & state) {
    auto stepper = odeint::make_controlled(
      tolerance, tolerance, odeint::runge_kutta_fehlberg78<State>());
    double time = 0.0, step = first_step;
    while (duration - time > 1e-14 * duration) {
      if (--machine->left < 0) {
        std::fill(state.begin(), state.end(), std::numeric_limits<double>::quiet_NaN());
        break;
      }
      step = std::min(step, duration - time);
      stepper.try_step(std::ref(*machine), state, time, step);
    }
  });
}

}  // extern "C"
