// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

// Pinocchio's constraintDynamics or lcaba on a model that Pinocchio has read and saved, evaluated
// again and again in C++. Called from models.py.

#define PINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION
#include <pinocchio/spatial.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <pinocchio/algorithm/loop-constrained-aba.hpp>
#include <pinocchio/serialization.hpp>

namespace
{

using Matrix = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

struct Machine
{
  pinocchio::Model model;
  pinocchio::Data data;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintModel) constraints;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintData) constraint_data;
  pinocchio::ProximalSettings settings;
  Eigen::VectorXd q, v, tau;
  bool by_bodies;

  void accelerate()
  {
    if (by_bodies) {
      pinocchio::lcaba(model, data, q, v, tau, constraints, constraint_data, settings);
    } else {
      pinocchio::constraintDynamics(model, data, q, v, tau, constraints, constraint_data, settings);
    }
  }
};

pinocchio::SE3 placement(const double * rows)
{
  const Eigen::Map<const Matrix> matrix(rows);
  return pinocchio::SE3(matrix.leftCols<3>(), matrix.col(3));
}

}  // namespace

extern "C" {

// Per loop: two joints, whether orientations are held too, and a frame on each joint as three
// rows of rotation and place.
void * create(
  const char * file, int loops, const int * ends, const int * whole, const double * frames,
  double mu, double accuracy, int iterations, int by_bodies)
{
  Machine * machine = new Machine;
  machine->by_bodies = by_bodies;
  machine->model.loadFromBinary(file);
  for (int k = 0; k < loops; ++k) {
    machine->constraints.emplace_back(
      whole[k] ? pinocchio::CONTACT_6D : pinocchio::CONTACT_3D, machine->model, ends[2 * k],
      placement(frames + 24 * k), ends[2 * k + 1], placement(frames + 24 * k + 12),
      pinocchio::LOCAL);
  }
  for (const auto & constraint : machine->constraints) {
    machine->constraint_data.emplace_back(constraint);
  }
  machine->data = pinocchio::Data(machine->model);
  machine->settings = pinocchio::ProximalSettings(accuracy, mu, iterations);
  if (by_bodies) {
    pinocchio::computeJointMinimalOrdering(machine->model, machine->data, machine->constraints);
  } else {
    pinocchio::initConstraintDynamics(
      machine->model, machine->data, machine->constraints, machine->constraint_data);
  }
  return machine;
}

// One state, evaluated so many times.
void evaluate(
  void * handle, const double * q, const double * v, const double * tau, long count,
  double * acceleration)
{
  Machine & machine = *static_cast<Machine *>(handle);
  machine.q = Eigen::Map<const Eigen::VectorXd>(q, machine.model.nq);
  machine.v = Eigen::Map<const Eigen::VectorXd>(v, machine.model.nv);
  machine.tau = Eigen::Map<const Eigen::VectorXd>(tau, machine.model.nv);
  for (long k = 0; k < count; ++k) {
    machine.accelerate();
  }
  Eigen::Map<Eigen::VectorXd>(acceleration, machine.model.nv) = machine.data.ddq;
}

void destroy(void * handle) { delete static_cast<Machine *>(handle); }

}  // extern "C"
