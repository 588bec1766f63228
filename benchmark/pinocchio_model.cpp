// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

// A model that Pinocchio has read and saved. Called from model_pinocchio.py.

#include "pinocchio_motion.hpp"

#include <pinocchio/serialization.hpp>

namespace
{

using Matrix = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

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
  machine->model.loadFromBinary(file);
  for (int k = 0; k < loops; ++k) {
    machine->constraints.emplace_back(
      whole[k] ? pinocchio::CONTACT_6D : pinocchio::CONTACT_3D, machine->model, ends[2 * k],
      placement(frames + 24 * k), ends[2 * k + 1], placement(frames + 24 * k + 12),
      pinocchio::LOCAL);
  }
  machine->finish(mu, accuracy, iterations, by_bodies);
  return machine;
}

}  // extern "C"
