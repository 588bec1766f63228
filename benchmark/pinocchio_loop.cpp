// Copyright 2026 The closedloop_dynamics authors
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// Pinocchio's constraintDynamics in loops of C++, without Python between two evaluations:
// evaluations alone, the classical Runge-Kutta method, and the error-controlled
// Runge-Kutta-Fehlberg 7(8) of Boost.Numeric.Odeint. Called from peer_pinocchio.py.

#define PINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION
#include <pinocchio/spatial.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/constrained-dynamics.hpp>

#include <boost/numeric/odeint/integrate/integrate_adaptive.hpp>
#include <boost/numeric/odeint/stepper/generation.hpp>
#include <boost/numeric/odeint/stepper/runge_kutta_fehlberg78.hpp>

#include <cmath>
#include <string>
#include <vector>

namespace odeint = boost::numeric::odeint;
using State = std::vector<double>;

namespace
{

pinocchio::SE3 placement(double x, double y, double angle)
{
  const Eigen::AngleAxisd turn(angle, Eigen::Vector3d::UnitZ());
  return pinocchio::SE3(turn.toRotationMatrix(), Eigen::Vector3d(x, y, 0.0));
}

struct Loop
{
  pinocchio::Model model;
  pinocchio::Data data;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintModel) constraints;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintData) constraint_data;
  pinocchio::ProximalSettings settings;
  Eigen::VectorXd q, v, tau;
  long evaluations = 0;

  const Eigen::VectorXd & accelerate()
  {
    ++evaluations;
    return pinocchio::constraintDynamics(
      model, data, q, v, tau, constraints, constraint_data, settings);
  }

  void operator()(const State & state, State & rate, double)
  {
    const int n = model.nv;
    q = Eigen::Map<const Eigen::VectorXd>(state.data(), n);
    v = Eigen::Map<const Eigen::VectorXd>(state.data() + n, n);
    const Eigen::VectorXd & a = accelerate();
    for (int i = 0; i < n; ++i) {
      rate[i] = v[i];
      rate[n + i] = a[i];
    }
  }
};

}  // namespace

extern "C" {

// Per joint: parent (0 is the ground, joints count from 1), place and angle in the parent's
// frame, mass, centre of mass, inertia about it. Per cut joint: two joints, two points.
// All joints are revolute.
void * create(
  int joints, const int * parent, const double * place, const double * body, int cuts,
  const int * ends, const double * points, const double * gravity, double mu, double accuracy,
  int iterations)
{
  using pinocchio::Model;
  Loop * loop = new Loop;
  Model & model = loop->model;
  for (int k = 0; k < joints; ++k) {
    const Model::JointIndex id = model.addJoint(
      parent[k], pinocchio::JointModelRZ(),
      placement(place[3 * k], place[3 * k + 1], place[3 * k + 2]), "joint_" + std::to_string(k));
    const double * b = body + 4 * k;
    model.appendBodyToJoint(
      id, pinocchio::Inertia(
        b[0], Eigen::Vector3d(b[1], b[2], 0.0), Eigen::Matrix3d(b[3] * Eigen::Matrix3d::Identity())));
  }
  model.gravity.linear() << gravity[0], gravity[1], 0.0;
  for (int k = 0; k < cuts; ++k) {
    loop->constraints.emplace_back(
      pinocchio::CONTACT_3D, model, ends[2 * k], placement(points[4 * k], points[4 * k + 1], 0.0),
      ends[2 * k + 1], placement(points[4 * k + 2], points[4 * k + 3], 0.0), pinocchio::LOCAL);
  }
  for (const auto & constraint : loop->constraints) {
    loop->constraint_data.emplace_back(constraint);
  }
  loop->data = pinocchio::Data(model);
  loop->settings = pinocchio::ProximalSettings(accuracy, mu, iterations);
  pinocchio::initConstraintDynamics(model, loop->data, loop->constraints, loop->constraint_data);
  loop->q = loop->v = loop->tau = Eigen::VectorXd::Zero(model.nv);
  return loop;
}

void set_state(void * handle, const double * q, const double * v, const double * tau)
{
  Loop & loop = *static_cast<Loop *>(handle);
  const int n = loop.model.nv;
  loop.q = Eigen::Map<const Eigen::VectorXd>(q, n);
  loop.v = Eigen::Map<const Eigen::VectorXd>(v, n);
  loop.tau = Eigen::Map<const Eigen::VectorXd>(tau, n);
  loop.evaluations = 0;
}

void get_state(void * handle, double * q, double * v)
{
  Loop & loop = *static_cast<Loop *>(handle);
  Eigen::Map<Eigen::VectorXd>(q, loop.model.nv) = loop.q;
  Eigen::Map<Eigen::VectorXd>(v, loop.model.nv) = loop.v;
}

long evaluations(void * handle) { return static_cast<Loop *>(handle)->evaluations; }

void evaluate(void * handle, long count, double * acceleration)
{
  Loop & loop = *static_cast<Loop *>(handle);
  for (long k = 0; k < count; ++k) {
    loop.accelerate();
  }
  Eigen::Map<Eigen::VectorXd>(acceleration, loop.model.nv) = loop.data.ddq;
}

void runge_kutta_4(void * handle, double step, long steps)
{
  Loop & loop = *static_cast<Loop *>(handle);
  const int n = loop.model.nv;
  Eigen::VectorXd q0(n), v0(n), v_sum(n), a_sum(n);
  for (long k = 0; k < steps; ++k) {
    q0 = loop.q;
    v0 = loop.v;
    v_sum.setZero();
    a_sum.setZero();
    for (int stage = 0; stage < 4; ++stage) {
      const double weight = (stage == 0 || stage == 3) ? 1.0 : 2.0;
      const Eigen::VectorXd & a = loop.accelerate();
      v_sum += weight * loop.v;
      a_sum += weight * a;
      if (stage < 3) {
        const double part = stage == 2 ? step : 0.5 * step;
        loop.q = q0 + part * loop.v;
        loop.v = v0 + part * a;
      }
    }
    loop.q = q0 + step / 6.0 * v_sum;
    loop.v = v0 + step / 6.0 * a_sum;
  }
}

void fehlberg_78(void * handle, double duration, double tolerance, double first_step)
{
  Loop & loop = *static_cast<Loop *>(handle);
  const int n = loop.model.nv;
  State state(2 * n);
  Eigen::Map<Eigen::VectorXd>(state.data(), n) = loop.q;
  Eigen::Map<Eigen::VectorXd>(state.data() + n, n) = loop.v;
  odeint::integrate_adaptive(
    odeint::make_controlled(
      tolerance, tolerance, odeint::runge_kutta_fehlberg78<State>()),
    std::ref(loop), state, 0.0, duration, first_step);
  loop.q = Eigen::Map<Eigen::VectorXd>(state.data(), n);
  loop.v = Eigen::Map<Eigen::VectorXd>(state.data() + n, n);
}

void destroy(void * handle) { delete static_cast<Loop *>(handle); }

}  // extern "C"
